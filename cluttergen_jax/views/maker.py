"""Views of scenes: colour, depth, labels and masks from cameras that are named, fixed or drawn."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import Variation
from cluttergen_jax.rendering.config import QUALITIES, Quality
from cluttergen_jax.rendering.scene_renderer import (
    PictureConfig,
    RenderStyle,
    SceneRenderer,
    scene_renderer,
)
from cluttergen_jax.views.images import depth_png, png_of
from cluttergen_jax.rendering.variation import TEXTURES_OF, Appearance, draw_light
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, CameraPlan, Instance, InstanceSensor

# Metres beside the region, and above and below the top: what light and shadows are made for.
_AROUND = 0.2
_HIGH = 0.4


@dataclass(frozen=True)
class ViewConfig:
    """How scenes are seen.

    Attributes:
      cameras: that look at each scene.
      seed: of cameras that are drawn, and of all that varies.
      vary: what is drawn anew for each view (`config.Variation`).
      quality: of colours.
      colour: draw colours, which needs OpenGL; all else needs none.
    """

    cameras: tuple[CameraPlan, ...]
    seed: int = 0
    vary: tuple[Variation, ...] = ()
    quality: Quality = "draft"
    colour: bool = True


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees of a scene. H rows, W columns, N objects.

    Attributes:
      scene: its number in its bank; camera: the plan's name; seen_from: where it was.
      names, labels: of the objects, as in the bank and as people call them.
      poses: f64[N, 7], T_world_object, metres, wxyz.
      rgb: u8[H, W, 3]; None where no colours were drawn.
      depth: f32[H, W], metres along the optical axis; inf where nothing is.
      label: i32[H, W], 0 floor or nothing, 1 the support, 2 + k object k.
      instances: of each object, masks and boxes.
    """

    scene: int
    camera: str
    seen_from: Camera
    names: tuple[str, ...]
    labels: tuple[str, ...]
    poses: np.ndarray
    rgb: np.ndarray | None
    depth: np.ndarray
    label: np.ndarray
    instances: tuple[Instance, ...]

    def row(self) -> dict[str, Any]:
        """The view as a row of a file: images as PNG files, numbers as lists."""
        camera = self.seen_from
        kind = np.uint8 if self.label.max() < 256 else np.uint16
        return {
            "scene": self.scene,
            "camera": self.camera,
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.ravel().tolist(),
            "T_world_camera": camera.T_world_camera.ravel().tolist(),
            "names": list(self.names),
            "labels": list(self.labels),
            "poses": self.poses.tolist(),
            "visible": [each.visible_share for each in self.instances],
            "box_visible": [_box_of(each.visible) for each in self.instances],
            "box_amodal": [_amodal_box(each) for each in self.instances],
            "rgb": None if self.rgb is None else png_of(Image.fromarray(self.rgb)),
            "depth": depth_png(self.depth),
            "label": png_of(Image.fromarray(self.label.astype(kind))),
            "amodal": [_mask_png(each.mask) for each in self.instances],
        }


def _box_of(mask: np.ndarray) -> list[int]:
    """First column and row, width and height, pixels; zeros where nothing is."""
    rows = np.flatnonzero(mask.any(1))
    columns = np.flatnonzero(mask.any(0))
    if not len(rows):
        return [0, 0, 0, 0]
    return [int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]


def _amodal_box(each: Instance) -> list[int]:
    if each.box is None:
        return [0, 0, 0, 0]
    left, right, upper, lower = each.box
    return [left, upper, right - left + 1, lower - upper + 1]


def _mask_png(mask: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(mask).save(buffer, format="PNG")
    return buffer.getvalue()


@dataclass(eq=False)
class ViewMaker:
    """Makes the views of some scenes on one support; all their objects are uploaded once.

    A view depends on its scene, its camera, the bank's place and the seed alone.

    Args:
      scenes: with their numbers in the bank; `place`: of the bank among those of the dataset.
      split_of: of a scene, for table textures that no other split has.
    """

    scenes: Sequence[Scene]
    config: ViewConfig
    place: int
    split_of: dict[int, str]
    _objects: list[ObjectAsset] = field(default_factory=list)
    _slots: list[list[int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        index: dict[tuple[str, int], int] = {}
        for scene in self.scenes:
            seen: dict[str, int] = {}
            own = []
            for asset in scene.objects:
                key = asset.name, seen.get(asset.name, 0)
                seen[asset.name] = key[1] + 1
                if key not in index:
                    index[key] = len(self._objects)
                    self._objects.append(asset)
                own.append(index[key])
            self._slots.append(own)

    def views(self) -> Iterator[View]:
        """Every scene from every camera, in order."""
        support = self.scenes[0].support
        quality = QUALITIES[self.config.quality]
        width, height = np.max([plan.size for plan in self.config.cameras], axis=0).tolist()
        picture = PictureConfig(width, height, quality.samples, smoothing=quality.smoothing)
        with ExitStack() as stack:
            renderer = look = None
            if self.config.colour:
                # Alike for all scenes: shadows are the coarser the more they are made for.
                middle = np.array([*support.region.center, support.top])
                half = np.append(np.array(support.region.half_extents) + _AROUND, _HIGH)
                points = np.stack([middle - half, middle + half])
                materials = bool(self.config.vary)
                opened = scene_renderer(self._objects, support, points, picture, materials)
                renderer = stack.enter_context(opened)
                model = renderer.model_renderer.model
                is_object = np.isin(model.geom_bodyid, model.jnt_bodyid)
                look = Appearance(model, is_object) if self.config.vary else None
            for scene, slots in zip(self.scenes, self._slots, strict=True):
                sensor = InstanceSensor(scene.objects, support)
                poses = np.asarray(scene.poses, np.float64)
                for number, plan in enumerate(self.config.cameras):
                    rng = np.random.default_rng(
                        [self.config.seed, self.place, scene.origin.index, number]
                    )
                    camera = plan.draw(support, rng)
                    image, instances = sensor.sense(poses, camera)
                    rgb = None
                    if renderer is not None:
                        rgb = self._colours(renderer, look, scene, slots, camera, rng)
                    yield View(
                        scene=scene.origin.index,
                        camera=plan.name,
                        seen_from=camera,
                        names=tuple(scene.names),
                        labels=tuple(asset.label for asset in scene.objects),
                        poses=poses,
                        rgb=rgb,
                        depth=image.depth,
                        label=image.label,
                        instances=instances,
                    )

    def _colours(
        self,
        renderer: SceneRenderer,
        look: Appearance | None,
        scene: Scene,
        slots: list[int],
        camera: Camera,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """u8[H, W, 3]."""
        yaw = 0.0
        if look is not None:
            # Always all draws, so that what varies does not decide how.
            texture = int(rng.choice(TEXTURES_OF[self.split_of[scene.origin.index]]))
            light = draw_light(rng)
            colours = look.draw_colours(rng)
            if "texture" in self.config.vary:
                look.set_texture(texture)
            if "light" in self.config.vary:
                look.set_light(light)
                yaw = light.yaw
            if "colour" in self.config.vary:
                renderer.colours = colours
        styles: list[RenderStyle | None] = [None] * len(self._objects)
        for slot, pose in zip(slots, scene.poses, strict=True):
            styles[slot] = RenderStyle(pose)
        renderer.camera = camera
        return renderer.picture(styles, light_yaw=yaw)
