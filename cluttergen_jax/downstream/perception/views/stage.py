"""The stage of views: a pool's objects, a table and the arm before one GL context, posed and lit anew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.downstream.perception.classes import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.perception.views.appearance import Light, add_table_materials
from cluttergen_jax.downstream.perception.views.cameras import SIZE
from cluttergen_jax.downstream.robot.model import Panda, home_pose, with_panda
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.lighting import FLOOR, KEY_LIGHT, SKY_LIGHT, add_lighting
from cluttergen_jax.rendering.renderer import HIDDEN_GROUP, Renderer, open_renderer, set_range
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing.camera import Camera

_PARKED = 60.0
"""Metres from the table; what is not in a scene is there."""
_REACH = 1.5
_LOW = 0.25
"""Metres over the table that the tool stays, so that the arm meets no object."""
_ARM_SPREAD = 0.25
_ARM_TRIES = 20
_SHADOWS = 1024
"""Pixels of a lamp's shadows; the usual 2,048 take most of a small picture's time."""


@dataclass(frozen=True, eq=False)
class View:
    """What one camera saw. H rows, W columns.

    Attributes:
      rgb: u8[H, W, 3]. depth: f32[H, W], metres along the optical axis, inf where nothing is.
      label: u8[H, W], see `classes`. camera: where it was seen from.
    """

    rgb: np.ndarray
    depth: np.ndarray
    label: np.ndarray
    camera: Camera


class Stage:
    """See `open_stage`. `model` may be told of colours and materials between pictures."""

    def __init__(
        self, model: mujoco.MjModel, renderer: Renderer, names: Sequence[str], has_arm: bool
    ) -> None:
        self.model, self._renderer = model, renderer
        self._data = mujoco.MjData(model)
        self._qpos = [int(model.joint(name).qposadr[0]) for name in names]
        self._arm = Panda.of(model) if has_arm else None
        self._rgba = model.geom_rgba.copy()
        self._label = self._labels(names)
        body = model.geom_bodyid
        is_seen = model.geom_group == VISUAL_GROUP
        self._arm_geoms = is_seen & self._arm.is_arm[body] if self._arm else np.zeros(model.ngeom, bool)
        self._table = np.flatnonzero(is_seen & (body == model.body("support").id))
        self.object_geoms = np.flatnonzero(is_seen & (self._label >= FIRST_OBJECT))
        self.floor = model.geom(FLOOR).id
        self._lamps = {name: model.light(name).diffuse.copy() for name in (KEY_LIGHT, SKY_LIGHT)}

    def _labels(self, names: Sequence[str]) -> np.ndarray:
        label = np.full(self.model.nbody, BACKGROUND, np.uint8)
        label[[self.model.body(name).id for name in names]] = FIRST_OBJECT + np.arange(len(names))
        if self._arm is not None:
            label[self._arm.is_arm] = ARM
        return label[self.model.geom_bodyid]

    @property
    def rgba(self) -> np.ndarray:
        """f32[ngeom, 4]: the colours that all had at first."""
        return self._rgba.copy()

    def place(self, poses: np.ndarray, is_placed: np.ndarray) -> None:
        """Puts the objects where they stand.

        Args:
          poses: f[K, 7], T_world_object; is_placed: bool[K], the others are far away.
        """
        for index, first in enumerate(self._qpos):
            away = np.array([_PARKED + index, _PARKED, 1.0, 1.0, 0.0, 0.0, 0.0])
            self._data.qpos[first : first + 7] = poses[index] if is_placed[index] else away

    def move_arm(self, top: float, rng: np.random.Generator | None) -> np.ndarray | None:
        """Shows the arm, somewhere about its home and well over the table; T_world_tool f64[4, 4].

        Args:
          top: the height of the table. rng: None hides the arm, and there is no tool.
        """
        is_hidden = rng is None
        self.model.geom_group[self._arm_geoms] = HIDDEN_GROUP if is_hidden else VISUAL_GROUP
        self.model.site_group[:] = HIDDEN_GROUP if is_hidden else 0
        if self._arm is None or rng is None:
            mujoco.mj_kinematics(self.model, self._data)
            return None
        home = home_pose()
        for _ in range(_ARM_TRIES):
            joints = np.clip(home + rng.normal(0, _ARM_SPREAD, len(home)), self._arm.low, self._arm.high)
            self._data.qpos[self._arm.qpos] = joints
            self._data.qpos[self._arm.fingers] = rng.uniform(0.0, 0.04)
            mujoco.mj_kinematics(self.model, self._data)
            if self._arm.tool(self._data)[2, 3] > top + _LOW:
                break
        return self._arm.tool(self._data)

    def dress(self, rgba: np.ndarray, material: int, light: Light) -> None:
        """Colours f[ngeom, 4], the number of the table's material, and light."""
        model = self.model
        model.geom_rgba[:] = rgba
        model.geom_matid[self._table] = material
        headlight = model.vis.headlight
        headlight.ambient[:], headlight.diffuse[:] = light.ambient, light.diffuse
        for name, diffuse in self._lamps.items():
            model.light(name).diffuse[:] = light.lamps * diffuse
            model.light(name).active[:] = light.lamps > 0

    def material(self, name: str) -> int:
        """The number of a material."""
        return int(self.model.material(name).id)

    def picture(self, camera: Camera, light_yaw: float = 0.0) -> View:
        """What a camera of `cameras.SIZE` sees now."""
        rgb = self._renderer.average(self._data, camera, 1, _REACH, light_yaw=light_yaw)
        depth, geom = self._renderer.measure(self._data, camera)
        label = np.where(geom >= 0, self._label[geom], BACKGROUND).astype(np.uint8)
        return View(rgb, depth, label, camera)


@contextmanager
def open_stage(
    objects: Sequence[ObjectAsset], support: SupportAsset, has_arm: bool
) -> Iterator[tuple[Stage, tuple[str, ...]]]:
    """A stage, and the names of its table materials.

    Args:
      has_arm: the arm can be shown.

    Raises:
      MissingExtraError: the arm is wanted and the extra `robot` is not installed.
      RendererError: nothing here can draw.
    """
    names = tuple(asset.name for asset in objects)
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(names), 1))
    poses[:, 0] = _PARKED + np.arange(len(names))
    scene = Scene(names, tuple(objects), poses, support)
    spec = with_panda(scene) if has_arm else scene.to_mjspec()
    materials = add_table_materials(spec)
    add_lighting(spec).visual.quality.shadowsize = _SHADOWS
    model = spec.compile()
    set_range(model, _REACH * np.array([[-1, -1, 0], [1, 1, 1]]), CameraView(), *SIZE)
    with open_renderer(model, *SIZE) as renderer:
        yield Stage(model, renderer, names, has_arm), materials
