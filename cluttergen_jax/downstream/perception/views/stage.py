"""The stage of views: objects, a table and the arm before one GL context; cameras of views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import Variation
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, above, wrist_camera
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.model import Robot, with_robot
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.rendering.lighting import add_lighting
from cluttergen_jax.rendering.renderer import HIDDEN_GROUP
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, free
from cluttergen_jax.views.maker import ViewMaker
from cluttergen_jax.views.view import View


def expose(rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """u8[H, W, 3]: a picture u8[H, W, 3] as a camera of another exposure and with noise takes it."""
    gain, gamma, sigma = rng.uniform([0.7, 0.8, 0.0], [1.35, 1.25, 0.015])
    balance = rng.normal(1.0, 0.03, 3)
    light = gain * balance * (rgb / 255.0) ** gamma + sigma * rng.standard_normal(rgb.shape)
    return np.round(255 * np.clip(light, 0, 1)).astype(np.uint8)


Kind = Literal["free", "overhead", "wrist"]
"""Of cameras."""
_TILT = np.radians(4.0)
_SHIFT = 0.03


def draw_camera(
    kind: Kind, support: SupportAsset, tool: np.ndarray | None, rng: np.random.Generator
) -> Camera:
    """A camera for a view: around the table, nearly overhead, or as the one on the hand.

    Args:
      tool: f64[4, 4], T_world_tool, where the arm is in the view; None if there is none.
    """
    if kind == "free":
        return free(support, rng, *SIZE, FOCAL)
    if kind == "overhead":
        return _shake(above(support), rng)
    return wrist_camera(_draw_tool(support, rng) if tool is None else tool)


def _shake(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera moved and turned by a little."""
    T = camera.T_world_camera.copy()
    T[:3, 3] += rng.uniform(-_SHIFT, _SHIFT, 3)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0, _TILT, 3)).as_matrix() @ T[:3, :3]
    return replace(camera, T_world_camera=T)


def _draw_tool(support: SupportAsset, rng: np.random.Generator) -> np.ndarray:
    """f64[4, 4]: a hand that looks down on the region from 30 to 60 cm, tilted by up to a few degrees."""
    half = 0.6 * np.asarray(support.region.half_extents)
    place = np.array([*support.region.center, support.top])
    place += [*rng.uniform(-half, half), rng.uniform(0.3, 0.6)]
    turn = Rotation.from_euler("zx", [rng.uniform(0, 2 * np.pi), np.pi])
    tilt = Rotation.from_rotvec(rng.normal(0, np.radians(6.0), 3))
    return rigid((tilt * turn).as_matrix(), place)


_PARKED = 60.0
"""Metres from the table, where objects are before they are placed."""
_REACH = 1.5
_LOW = 0.25
"""Metres over the table that the tool stays, so that the arm meets no object."""
_ARM_SPREAD = 0.25
_ARM_TRIES = 20
_SHADOWS = 1024
"""Pixels of a lamp's shadows; the usual 2,048 take most of a small picture's time."""


class Stage:
    """See `open_stage`."""

    def __init__(
        self,
        maker: ViewMaker,
        objects: Sequence[ObjectAsset],
        support: SupportAsset,
        has_arm: bool,
    ) -> None:
        self._maker = maker
        self._objects = tuple(objects)
        self._support = support
        self.place(np.zeros((len(objects), 7)), np.zeros(len(objects), bool))
        renderer = maker.renderer
        renderer.reach = _REACH
        self._data = renderer.data
        self._model = renderer.model_renderer.model
        self._arm = Robot.of(self._model) if has_arm else None
        is_arm = np.zeros(self._model.ngeom, bool)
        if self._arm is not None:
            is_arm = self._arm.is_arm[self._model.geom_bodyid]
        self._arm_geoms = is_arm & (self._model.geom_group == VISUAL_GROUP)
        is_object = renderer.labels >= FIRST_OBJECT
        renderer.labels = np.where(is_arm, ARM, np.where(is_object, renderer.labels, BACKGROUND))

    def place(self, poses: np.ndarray, is_placed: np.ndarray) -> None:
        """Puts the objects where they stand.

        Args:
          poses: f[K, 7], T_world_object; is_placed: bool[K], the others are not there.
        """
        self._maker.place(self._objects, poses, self._support, is_placed)

    def dress(self, rng: np.random.Generator, textures: Sequence[int]) -> int:
        """See `ViewMaker.dress`."""
        return self._maker.dress(rng, textures)

    def move_arm(self, top: float, rng: np.random.Generator | None) -> np.ndarray | None:
        """Shows the arm, somewhere about its home and well over the table; T_world_tool f64[4, 4].

        Args:
          top: the height of the table. rng: None hides the arm, and there is no tool.
        """
        is_hidden = rng is None
        self._model.geom_group[self._arm_geoms] = HIDDEN_GROUP if is_hidden else VISUAL_GROUP
        self._model.site_group[:] = HIDDEN_GROUP if is_hidden else 0
        if self._arm is None or rng is None:
            return None
        home = np.array(find_robot().arm.home)
        for _ in range(_ARM_TRIES):
            joints = np.clip(
                home + rng.normal(0, _ARM_SPREAD, len(home)), self._arm.low, self._arm.high
            )
            self._data.qpos[self._arm.qpos] = joints
            self._data.qpos[self._arm.fingers] = rng.uniform(0.0, 0.04)
            mujoco.mj_kinematics(self._model, self._data)
            if self._arm.tool(self._data)[2, 3] > top + _LOW:
                break
        return self._arm.tool(self._data)

    def picture(self, camera: Camera) -> View:
        """What a camera of `cameras.SIZE` sees now; labels u8[H, W], see `types`."""
        view = self._maker.see(camera)
        return replace(view, label=view.label.astype(np.uint8))


@contextmanager
def open_stage(
    objects: Sequence[ObjectAsset], support: SupportAsset, has_arm: bool
) -> Iterator[Stage]:
    """A stage.

    Args:
      has_arm: the arm can be shown.

    Raises:
      MissingExtraError: the arm is wanted and the extra `robot` is not installed.
      RendererError: nothing here can draw.
    """
    with ViewMaker(
        PictureConfig(*SIZE, samples=1),
        vary=get_args(Variation),
        around=_REACH * np.array([[-1, -1, 0], [1, 1, 1]]),
        spec_of=partial(_stage_spec, has_arm),
        is_measured_by_gl=True,
    ) as maker:
        yield Stage(maker, objects, support, has_arm)


def _stage_spec(
    has_arm: bool, objects: Sequence[ObjectAsset], support: SupportAsset
) -> mujoco.MjSpec:
    names = tuple(asset.name for asset in objects)
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(names), 1))
    poses[:, 0] = _PARKED + np.arange(len(names))
    scene = Scene(names, tuple(objects), poses, support)
    spec = with_robot(scene) if has_arm else scene.to_mjspec()
    add_lighting(spec).visual.quality.shadowsize = _SHADOWS
    return spec
