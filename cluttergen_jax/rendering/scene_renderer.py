"""Renderer of a scene: each picture says where each object stands, how opaque it is, and in which tint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.assets import scene_spec
from cluttergen_jax.rendering.camera import corners, drawn_points, fit_camera
from cluttergen_jax.rendering.config import CameraView
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
      view: from which side.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
    """

    width: int = 640
    height: int = 480
    samples: int = 32
    view: CameraView = DEFAULT_VIEW
    whole: bool = False
    hulls: bool = False

    def __post_init__(self) -> None:
        check_size(self.width, self.height, self.samples)


class SceneRenderer:
    """See `scene_renderer`. `content` f64[P, 3] is all that the whole view shows; `camera` may be any of the
    pictures' size."""

    def __init__(
        self,
        model_renderer: Renderer,
        data: mujoco.MjData,
        picture: PictureConfig,
        reach: float,
        content: np.ndarray,
        camera: Camera,
    ) -> None:
        self.model_renderer, self.data, self.config, self.reach = model_renderer, data, picture, reach
        self.content = content
        self.camera = camera
        model = model_renderer.model
        self._colours = model.geom_rgba.copy()
        self._label = labels_of(model)
        self._joint_body = model.jnt_bodyid.copy()
        self._home = model.qpos0.reshape(-1, 7).copy()

    def aim(self, points: np.ndarray, view: CameraView) -> None:
        """Puts the camera as near as `points` f64[P, 3] allow."""
        self.camera = fit_camera(points, view, self.config.width, self.config.height)

    def picture(
        self, styles: Sequence[RenderStyle | None], trails: Sequence[Trail] = (), light_yaw: float = 0.0
    ) -> np.ndarray:
        """uint8[height, width, 3]: one style per object; None leaves it out.

        Args:
          light_yaw: radians by which the lights are turned about the vertical.

        Raises:
          ConfigError: not one style per object.
        """
        alpha = self._apply(styles)
        return self.model_renderer.average(
            self.data, self.camera, self.config.samples, self.reach, alpha, tuple(trails), light_yaw
        )

    def measure(self, styles: Sequence[RenderStyle | None]) -> DepthImage:
        """Depth and labels as OpenGL draws them: see `Renderer.measure`."""
        alpha = self._apply(styles)
        model = self.model_renderer.model
        groups = model.geom_group.copy()
        model.geom_group[:] = np.where(alpha[model.geom_bodyid] > 0, groups, HIDDEN_GROUP)
        depth, geom = self.model_renderer.measure(self.data, self.camera)
        model.geom_group[:] = groups
        return DepthImage(depth, geom, np.where(geom >= 0, self._label[geom], FLOOR).astype(np.int32))

    def _apply(self, styles: Sequence[RenderStyle | None]) -> np.ndarray:
        """Poses and colours for one picture; f64[nbody], the opacity of each body."""
        model, bodies = self.model_renderer.model, self._joint_body
        if len(styles) != len(bodies):
            raise ConfigError(f"{len(styles)} styles for {len(bodies)} objects", f"{len(bodies)}")
        alpha = np.ones(model.nbody)
        qpos, colours = self._home.copy(), self._colours.copy()
        for body, row, style in zip(bodies, qpos, styles, strict=True):
            alpha[body] = 0.0 if style is None else style.alpha
            if style is not None:
                row[:] = style.pose
                mine = model.geom_bodyid == body
                colours[mine, :3] += style.strength * (np.array(style.tint) - colours[mine, :3])
                # Glass that is tinted is seen as what failed, not through.
                colours[mine, 3] += style.strength * (1 - colours[mine, 3])
        model.geom_rgba[:] = colours
        self.data.qpos[:] = qpos.ravel()
        mujoco.mj_kinematics(model, self.data)
        return alpha


@contextmanager
def scene_renderer(
    objects: Sequence[ObjectAsset], support: SupportAsset | None, points: np.ndarray, picture: PictureConfig
) -> Iterator[SceneRenderer]:
    """A renderer of a scene, for as many pictures as are wanted.

    Args:
      objects: the same asset may come several times.
      points: f64[P, 3], all places that something will be drawn at; the camera is aimed at them.

    Raises:
      RendererError: nothing here can draw.
    """
    model, data, content = _make_scene_model(objects, support, points, picture)
    width, height = picture.width, picture.height
    reach = set_range(model, content, picture.view, width, height)
    with open_renderer(model, width, height) as model_renderer:
        camera = _fit_camera(content, points, picture)
        yield SceneRenderer(model_renderer, data, picture, reach, content, camera)


def scene_camera(
    objects: Sequence[ObjectAsset], support: SupportAsset | None, points: np.ndarray, picture: PictureConfig
) -> Camera:
    """The camera that `scene_renderer` of these begins with; needs no OpenGL."""
    return _fit_camera(_make_scene_model(objects, support, points, picture)[2], points, picture)


def _make_scene_model(
    objects: Sequence[ObjectAsset], support: SupportAsset | None, points: np.ndarray, picture: PictureConfig
) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """The model with its objects at the origin, its data, and f64[P, 3], all that the whole view shows."""
    home = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(objects), 1))
    spec, _ = scene_spec(objects, home, support)
    model, is_drawn = prepare_model(spec.compile(), picture.hulls, None)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_fixed = is_drawn & (model.body_weldid[model.geom_bodyid] == 0)
    return model, data, np.concatenate([drawn_points(model, data, is_fixed), points])


def _fit_camera(content: np.ndarray, points: np.ndarray, picture: PictureConfig) -> Camera:
    shown = content if picture.whole else points
    return fit_camera(shown, picture.view, picture.width, picture.height)


def turntable_points(points: np.ndarray, num_turns: int = 36) -> np.ndarray:
    """f64[P', 3]: a box that holds `points` at every turn about the vertical axis through their middle."""
    center = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points[:, :2] - center[:2], axis=1).max()
    turn = 2 * np.pi * np.arange(num_turns) / num_turns
    ring = center[:2] + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    heights = corners(points.min(0), points.max(0))[:, 2]
    return np.concatenate([np.column_stack([ring, np.full(num_turns, z)]) for z in np.unique(heights)])
