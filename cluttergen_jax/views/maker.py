"""The maker of views: a scene before cameras, and what they see: colours, depth, labels, silhouettes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.config import Variation
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.furnish import furnish
from cluttergen_jax.rendering.look import Look
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import (
    PictureConfig,
    RenderStyle,
    SceneRenderer,
    lit_spec,
    open_scene_renderer,
    scene_camera,
)
from cluttergen_jax.rendering.variation import Appearance, add_table_materials, draw_light
from cluttergen_jax.sensing import FIRST_OBJECT, Camera, InstanceSensor, View

MOST_TOGETHER = 300
"""Objects of one model, unless it is said otherwise."""


@dataclass(frozen=True, eq=False)
class SeenScene:
    """A scene before cameras, of N objects.

    Attributes:
      number: in its bank. names: unique ones, of the objects.
      objects: the same asset may come several times. poses: f64[N, 7], T_world_object, metres, wxyz.
      support: what carries them. region: that the scene was made in, about which cameras stand.
    """

    number: int
    names: Sequence[str]
    objects: Sequence[ObjectAsset]
    poses: np.ndarray
    support: SupportAsset
    region: Rectangle

    @property
    def camera_support(self) -> SupportAsset:
        """The support as cameras are placed by it."""
        return replace(self.support, region=self.region)


class ViewMaker:
    """Makes views of scenes on one support; what several of them have is uploaded once. A context manager.

    `place` a scene, `dress` it if it is to vary, and `see` it from as many cameras as are wanted. Depth and
    labels come from rays, which need no OpenGL, unless it is to measure them.

    Args:
      picture: of colours; its size is the largest that is seen, its view where no camera is given.
      is_drawn: draw colours, which needs OpenGL.
      vary: what `dress` draws anew.
      around: f64[P, 3], what light and shadows are made for in all scenes; each scene by itself if None.
      most_together: objects of one model, at most, if one scene has no more.
      spec_of: makes the lit specification of objects on the support; `lit_spec`, if not given.
      is_measured_by_gl: depth and labels are OpenGL's, of all that the specification has.
    """

    def __init__(
        self,
        picture: PictureConfig,
        *,
        is_drawn: bool = True,
        vary: Sequence[Variation] = (),
        around: np.ndarray | None = None,
        most_together: int = MOST_TOGETHER,
        spec_of: Callable[[Sequence[ObjectAsset], SupportAsset], mujoco.MjSpec] | None = None,
        is_measured_by_gl: bool = False,
    ) -> None:
        self._picture = picture
        self._is_drawn = is_drawn
        self._vary = frozenset(vary)
        self._around = around
        self._most_together = most_together
        self._spec_of = spec_of
        self._is_measured_by_gl = is_measured_by_gl
        self._stack = ExitStack()
        self._renderer: SceneRenderer | None = None
        self._appearance: Appearance | None = None
        self._light_yaw = 0.0
        self._slots: dict[tuple[int, int], int] = {}

    def __enter__(self) -> ViewMaker:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def is_photo(self) -> bool:
        """Whether pictures are photos."""
        return self._picture.photo is not None

    @property
    def renderer(self) -> SceneRenderer:
        """What draws; there once a scene is placed."""
        assert self._renderer is not None, "nothing is drawn, or no scene is placed"
        return self._renderer

    def place(
        self,
        objects: Sequence[ObjectAsset],
        poses: np.ndarray,
        support: SupportAsset,
        is_placed: np.ndarray | None = None,
        coming: Callable[[], Sequence[Sequence[ObjectAsset]]] = tuple,
        look: Look | None = None,
    ) -> None:
        """Puts a scene before the cameras.

        Args:
          objects: N of them. poses: f[N, 7], T_world_object, metres, wxyz.
          is_placed: bool[N], which are there, for colours and what OpenGL measures; all if None.
          coming: gives the objects of scenes that come next; asked where something is uploaded.
          look: how it is furnished and lit, if not as the picture says.

        Raises:
          RendererError: colours are wanted, and nothing here can draw.
        """
        if look is not None and look != self._picture.look:
            self._picture = replace(self._picture, look=look)
            self._renderer = None
        self._objects = tuple(objects)
        self._poses = np.asarray(poses, np.float64).reshape(-1, 7)
        self._support = furnish(support, self._picture.look)
        self._sensor: InstanceSensor | None = None
        self._is_placed = np.ones(len(self._objects), bool) if is_placed is None else is_placed
        if not self._is_drawn:
            return
        keys = _keys_of(self._objects)
        if self._renderer is None or not self._slots.keys() >= set(keys):
            self._open([self._objects, *coming()])
        if self._around is None:
            self.renderer.fit(self._points())
        self._places = [self._slots[key] for key in keys]

    def dress(self, rng: np.random.Generator, textures: Sequence[int]) -> int:
        """Draws the table's texture, light and colours for the next views; the texture's number.

        All of it is drawn whatever varies, so that what varies does not decide how.
        """
        appearance = self._appearance
        assert appearance is not None, "nothing varies"
        texture = int(rng.choice(textures))
        light = draw_light(rng)
        colours = appearance.draw_colours(rng)
        if "texture" in self._vary:
            appearance.set_texture(texture)
        if "light" in self._vary:
            appearance.set_light(light)
            self._light_yaw = light.yaw
        if "colour" in self._vary:
            self.renderer.colours = colours
        return texture

    def picture(self, camera: Camera | None = None, trails: Sequence[Trail] = ()) -> np.ndarray:
        """u8[H, W, 3]: the colours alone; None sees the scene from the picture's view.

        Args:
          trails: lines to draw as well.
        """
        if camera is not None:
            self.renderer.camera = camera
        return self.renderer.picture(self._styles(), trails, light_yaw=self._light_yaw)

    def see(self, camera: Camera | None = None, has_instances: bool = False) -> View:
        """What a camera sees, of the picture's size at most; None sees it from the picture's view.

        Args:
          has_instances: masks and boxes of each object as well, which rays alone give.
        """
        camera = camera or self._own_camera()
        rgb = self.picture(camera) if self._is_drawn else None
        if self._is_measured_by_gl:
            image = self.renderer.measure(self._styles())
            return View(image.depth, self._labels(image.label), camera, rgb)
        if self._sensor is None:
            surfaces = not self._picture.hulls
            self._sensor = InstanceSensor(self._objects, self._support, surfaces)
        if not has_instances:
            image = self._sensor.sense_scene(self._poses, camera)
            return View(image.depth, image.label, camera, rgb)
        image, instances = self._sensor.sense(self._poses, camera)
        return View(image.depth, image.label, camera, rgb, instances)

    def _points(self) -> np.ndarray:
        return close_points(self._objects, self._poses, self._support)

    def _own_camera(self) -> Camera:
        if self._is_drawn:
            return self.renderer.camera
        return scene_camera(self._objects, self._support, self._points(), self._picture)

    def _styles(self) -> list[RenderStyle | None]:
        styles: list[RenderStyle | None] = [None] * len(self._slots)
        for place, pose, is_there in zip(self._places, self._poses, self._is_placed, strict=True):
            styles[place] = RenderStyle(pose) if is_there else None
        return styles

    def _labels(self, seen: np.ndarray) -> np.ndarray:
        """Labels by the model's objects as labels by the scene's."""
        label_of = np.arange(FIRST_OBJECT + len(self._slots), dtype=np.int32)
        label_of[FIRST_OBJECT + np.array(self._places, int)] = FIRST_OBJECT + np.arange(
            len(self._places)
        )
        return label_of[seen]

    def _open(self, scenes: Sequence[Sequence[ObjectAsset]]) -> None:
        """A model of the first scene, and of those after it for as many objects as there is room for."""
        self._stack.close()
        together: dict[tuple[int, int], ObjectAsset] = {}
        for objects in scenes:
            more = dict(zip(_keys_of(objects), objects, strict=True))
            if together and len(together | more) > self._most_together:
                break
            together |= more
        self._slots = {key: place for place, key in enumerate(together)}
        objects = tuple(together.values())
        make_spec = self._spec_of or partial(lit_spec, look=self._picture.look)
        spec = make_spec(objects, self._support)
        if self._vary:
            add_table_materials(spec)
        points = self._points() if self._around is None else self._around
        opened = open_scene_renderer(objects, self._support, points, self._picture, spec)
        self._renderer = self._stack.enter_context(opened)
        if self._vary:
            model = self._renderer.model_renderer.model
            is_object = np.isin(model.geom_bodyid, self._renderer.bodies)
            if self._is_measured_by_gl:
                # Views for perception have always drawn colours of surfaces alone, others of hulls, too.
                is_object &= model.geom_group == VISUAL_GROUP
            self._appearance = Appearance(model, is_object)


def _keys_of(objects: Sequence[ObjectAsset]) -> list[tuple[int, int]]:
    """Which asset each object is, and how many of it come before."""
    seen: Counter[int] = Counter()
    keys = []
    for asset in objects:
        keys.append((id(asset), seen[id(asset)]))
        seen[id(asset)] += 1
    return keys
