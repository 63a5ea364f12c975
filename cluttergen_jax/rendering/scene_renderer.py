"""Renderer of a scene: each picture says where each object stands, how opaque it is, and in which tint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_map import rim_height
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.assets import scene_spec
from cluttergen_jax.rendering.camera import corners, drawn_points, fit_camera
from cluttergen_jax.rendering.config import CameraView, PhotoConfig
from cluttergen_jax.rendering.furnish import furnish
from cluttergen_jax.rendering.look import Look
from cluttergen_jax.rendering.picture import DEFAULT_VIEW, prepare_model
from cluttergen_jax.rendering.renderer import (
    HIDDEN_GROUP,
    Renderer,
    Trail,
    check_size,
    open_renderer,
    set_range,
)
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FLOOR, DepthImage, labels_of

if TYPE_CHECKING:
    from cluttergen_jax.rendering.photo import PhotoRenderer

RED = (0.86, 0.10, 0.12)
"""Of what failed."""


@dataclass(frozen=True, eq=False)
class RenderStyle:
    """How an object is drawn in one picture.

    Attributes:
      pose: f[7], metres and wxyz, world frame.
      alpha: 1 is opaque, 0 unseen.
      tint: the colour that it is mixed with; strength: how much of it, in [0, 1].
    """

    pose: np.ndarray
    alpha: float = 1.0
    tint: tuple[float, float, float] = RED
    strength: float = 0.0


@dataclass(frozen=True)
class PictureConfig:
    """How pictures are taken.

    Attributes:
      width, height: pixels.
      samples: pictures averaged into one; time is proportional to it.
      view: from which side; by default from farther above where the support is a deep container.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
      smoothing: edges are drawn from so many places of each pixel, 0 for one; colours alone, no depth and
        labels, can be drawn so.
      look: how the scene is furnished and lit; None draws the support in its own colours, on a grey floor.
      photo: path tracing, with `samples` paths for each pixel; None draws by OpenGL.
    """

    width: int = 640
    height: int = 480
    samples: int = 32
    view: CameraView = DEFAULT_VIEW
    whole: bool = False
    hulls: bool = False
    smoothing: int = 0
    look: Look | None = None
    photo: PhotoConfig | None = None

    def __post_init__(self) -> None:
        check_size(self.width, self.height, self.samples)


# Metres; degrees of elevation.
_HIGH_RIM = 0.05
_INTO = -55.0
_NUM_TURNS = 36


class SceneRenderer:
    """See `open_scene_renderer`.

    Attributes:
      content: f64[P, 3], all that the whole view shows.
      camera: of the next picture, no larger than the first one's.
      colours: f32[ngeom, 4], of all surfaces where no style tints them; they may be changed.
      bodies: i[N], the model's number of each object.
      labels: i32[ngeom], of what `measure` sees, see `sensing.rays.labels_of`; they may be changed.
    """

    def __init__(
        self,
        model_renderer: Renderer | PhotoRenderer,
        data: mujoco.MjData,
        picture: PictureConfig,
        reach: float,
        content: np.ndarray,
        camera: Camera,
    ) -> None:
        self.model_renderer = model_renderer
        self.data = data
        self.config = picture
        self.reach = reach
        self.content = content
        self.camera = camera
        model = model_renderer.model
        self.colours = model.geom_rgba.copy()
        self.labels = labels_of(model)
        is_free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
        self.bodies = model.jnt_bodyid[is_free]
        is_fixed = (model.geom_group == VISUAL_GROUP) & (model.body_weldid[model.geom_bodyid] == 0)
        self._fixed = drawn_points(model, data, is_fixed)
        self._places = model.jnt_qposadr[is_free][:, None] + np.arange(7)
        self._home = model.qpos0[self._places]

    def fit(self, points: np.ndarray) -> None:
        """Fits light, shadows and camera to another scene, of which f64[P, 3] are all places of things."""
        model = self.model_renderer.model
        config = self.config
        self.content = np.concatenate([self._fixed, points])
        self.reach = set_range(model, self.content, config.view, config.width, config.height)
        self.camera = _fit_camera(self.content, points, config)

    def aim(self, points: np.ndarray, view: CameraView) -> None:
        """Puts the camera as near as `points` f64[P, 3] allow."""
        self.camera = fit_camera(points, view, self.config.width, self.config.height)

    def picture(
        self,
        styles: Sequence[RenderStyle | None],
        trails: Sequence[Trail] = (),
        light_yaw: float = 0.0,
    ) -> np.ndarray:
        """uint8[height, width, 3]: one style per object; None leaves it out.

        Args:
          light_yaw: radians by which the lights are turned about the vertical.

        Raises:
          ConfigError: not one style per object.
        """
        alpha = self._apply(styles)
        if self.config.samples == 1:
            # A single picture shows what is seen through by blending, in the order that OpenGL draws.
            model = self.model_renderer.model
            model.geom_rgba[:, 3] *= alpha[model.geom_bodyid]
            alpha = np.where(alpha > 0, 1.0, 0.0)
        self.model_renderer.set_size(self.camera.width, self.camera.height)
        return self.model_renderer.average(
            self.data, self.camera, self.config.samples, self.reach, alpha, tuple(trails), light_yaw
        )

    def measure(self, styles: Sequence[RenderStyle | None]) -> DepthImage:
        """Depth and labels as OpenGL draws them: see `Renderer.measure`."""
        assert not self.config.smoothing, "smooth edges mix the numbers of what is on either side"
        renderer = self.model_renderer
        assert isinstance(renderer, Renderer), "photos measure nothing"
        alpha = self._apply(styles)
        renderer.set_size(self.camera.width, self.camera.height)
        model = renderer.model
        groups = model.geom_group.copy()
        model.geom_group[:] = np.where(alpha[model.geom_bodyid] > 0, groups, HIDDEN_GROUP)
        depth, geom = renderer.measure(self.data, self.camera)
        model.geom_group[:] = groups
        return DepthImage(
            depth, geom, np.where(geom >= 0, self.labels[geom], FLOOR).astype(np.int32)
        )

    def _apply(self, styles: Sequence[RenderStyle | None]) -> np.ndarray:
        """Poses and colours for one picture; f64[nbody], the opacity of each body."""
        model = self.model_renderer.model
        bodies = self.bodies
        if len(styles) != len(bodies):
            raise ConfigError(f"{len(styles)} styles for {len(bodies)} objects", f"{len(bodies)}")
        alpha = np.ones(model.nbody)
        qpos = self._home.copy()
        colours = self.colours.copy()
        for body, row, style in zip(bodies, qpos, styles, strict=True):
            alpha[body] = 0.0 if style is None else style.alpha
            if style is not None:
                row[:] = style.pose
                mine = model.geom_bodyid == body
                colours[mine, :3] += style.strength * (np.array(style.tint) - colours[mine, :3])
                # Glass that is tinted is seen as what failed, not through.
                colours[mine, 3] += style.strength * (1 - colours[mine, 3])
        model.geom_rgba[:] = colours
        self.data.qpos[self._places] = qpos
        mujoco.mj_kinematics(model, self.data)
        return alpha


@contextmanager
def open_scene_renderer(
    objects: Sequence[ObjectAsset],
    support: SupportAsset | None,
    points: np.ndarray,
    picture: PictureConfig,
    spec: mujoco.MjSpec | None = None,
) -> Iterator[SceneRenderer]:
    """A renderer of a scene, for as many pictures as are wanted.

    Args:
      objects: the same asset may come several times; of many scenes, all that any of them has.
      points: f64[P, 3], all places that something will be drawn at; the camera is aimed at them.
      spec: a lit specification whose free joints are the objects', in this order; see `lit_spec`, if None.

    Raises:
      RendererError: nothing here can draw.
    """
    picture = _look_over_rim(picture, support)
    spec = spec or lit_spec(objects, support, picture.look)
    model, data, content = _make_scene_model(spec, points, picture)
    model.vis.quality.offsamples = picture.smoothing
    width = picture.width
    height = picture.height
    reach = set_range(model, content, picture.view, width, height)
    with _open_renderer(model, picture) as model_renderer:
        camera = _fit_camera(content, points, picture)
        yield SceneRenderer(model_renderer, data, picture, reach, content, camera)


def _open_renderer(
    model: mujoco.MjModel, picture: PictureConfig
) -> AbstractContextManager[Renderer | PhotoRenderer]:
    if picture.photo is None:
        return open_renderer(model, picture.width, picture.height)
    # Meshes of primitives are made by a library that takes a while to load.
    from cluttergen_jax.rendering.photo import open_photo_renderer

    return open_photo_renderer(model, picture.look, picture.photo)


def scene_camera(
    objects: Sequence[ObjectAsset],
    support: SupportAsset | None,
    points: np.ndarray,
    picture: PictureConfig,
) -> Camera:
    """The camera that `open_scene_renderer` of these begins with; needs no OpenGL."""
    picture = _look_over_rim(picture, support)
    content = _make_scene_model(lit_spec(objects, support, picture.look), points, picture)[2]
    return _fit_camera(content, points, picture)


def lit_spec(
    objects: Sequence[ObjectAsset], support: SupportAsset | None, look: Look | None = None
) -> mujoco.MjSpec:
    """Light, floor and the support as the look furnishes it, and the objects at the origin."""
    home = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(objects), 1))
    return scene_spec(objects, home, None if support is None else furnish(support, look), look)[0]


def _make_scene_model(
    spec: mujoco.MjSpec, points: np.ndarray, picture: PictureConfig
) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """The model, its data, and f64[P, 3], all that the whole view shows."""
    model, is_drawn = prepare_model(spec.compile(), picture.hulls, None)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_fixed = is_drawn & (model.body_weldid[model.geom_bodyid] == 0)
    return model, data, np.concatenate([drawn_points(model, data, is_fixed), points])


def _look_over_rim(picture: PictureConfig, support: SupportAsset | None) -> PictureConfig:
    """Into what has a high rim the usual view looks from farther above."""
    if (
        support is None
        or picture.view != DEFAULT_VIEW
        or rim_height(support.region, support) < _HIGH_RIM
    ):
        return picture
    return replace(picture, view=replace(picture.view, elevation=_INTO))


def _fit_camera(content: np.ndarray, points: np.ndarray, picture: PictureConfig) -> Camera:
    shown = content if picture.whole else points
    return fit_camera(shown, picture.view, picture.width, picture.height)


def turntable_points(points: np.ndarray) -> np.ndarray:
    """f64[P', 3]: a box that holds `points` at every turn about the vertical axis through their middle."""
    center = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points[:, :2] - center[:2], axis=1).max()
    turn = 2 * np.pi * np.arange(_NUM_TURNS) / _NUM_TURNS
    ring = center[:2] + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    heights = corners(points.min(0), points.max(0))[:, 2]
    return np.concatenate(
        [np.column_stack([ring, np.full(_NUM_TURNS, z)]) for z in np.unique(heights)]
    )
