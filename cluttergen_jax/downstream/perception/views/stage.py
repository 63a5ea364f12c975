"""The stage of views: objects, a table and the arm before one GL context; what is drawn for each view."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, above, wrist_camera
from cluttergen_jax.downstream.robot.model import Panda, home_pose, with_panda
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.lighting import FLOOR, KEY_LIGHT, SKY_LIGHT, add_lighting
from cluttergen_jax.rendering.renderer import HIDDEN_GROUP, Renderer, open_renderer, set_range
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, free

NUM_TEXTURES = 20
TEXTURES_OF = {"train": range(16), "val": range(16, 18), "test": range(18, NUM_TEXTURES)}
"""By split: what is chosen on the split `val` is judged on textures that are in no other."""
_SIDE = 128
_DARKEST, _BRIGHTEST = 0.15, 0.9


def table_texture(number: int) -> np.ndarray:
    """u8[128, 128, 3]: a table's texture, the same for the same number.

    In turns: plain with specks, boards along one side, marble, checks, and cloth.
    """
    rng = np.random.default_rng((number, 17))
    base, other = rng.uniform(_DARKEST, _BRIGHTEST, (2, 3))
    other = base + rng.uniform(0.15, 0.6) * (other - base)
    x, y = np.meshgrid(np.arange(_SIDE), np.arange(_SIDE))
    noise = rng.normal(size=(_SIDE, _SIDE))
    soft = gaussian_filter(noise, 6, mode="wrap")
    soft /= soft.std()
    patterns = (
        lambda: (gaussian_filter(noise, 0.7, mode="wrap") > 0.9) * 1.0,
        lambda: 0.5 + 0.5 * np.sin(x / 3.0 + 2 * gaussian_filter(noise, (20, 2), mode="wrap") / 0.06),
        lambda: np.abs(np.sin(2.5 * soft)),
        lambda: ((x // 16 + y // 16) % 2) * 1.0,
        lambda: 0.5 + 0.25 * (np.sin(x * np.pi / 2) + np.sin(y * np.pi / 2)),
    )
    share = np.clip(patterns[number % len(patterns)](), 0, 1)[..., None]
    return np.round(255 * np.clip(base + share * (other - base), 0, 1)).astype(np.uint8)


def add_table_materials(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Adds a material for each table texture; their names."""
    names = []
    for number in range(NUM_TEXTURES):
        name, pixels = f"table-{number:02d}", table_texture(number)
        image = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
        image.width, image.height, image.nchannel = _SIDE, _SIDE, 3
        image.data = pixels.tobytes()
        material = spec.add_material(name=name, specular=0.1, shininess=0.2, texrepeat=(2, 2))
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        names.append(name)
    return tuple(names)


@dataclass(frozen=True, eq=False)
class Light:
    """How a view is lit.

    Attributes:
      ambient, diffuse: of the camera's own light, each in [0, 1].
      lamps: factor of the lamps; 0 puts them out, as they are in episodes of the robot.
      yaw: radians by which the lamps are turned about the vertical.
    """

    ambient: float
    diffuse: float
    lamps: float
    yaw: float


def draw_light(rng: np.random.Generator) -> Light:
    """In a third of the draws there is the camera's own light alone."""
    ambient, diffuse, lamps = rng.uniform([0.1, 0.1, 0.4], [0.35, 0.5, 1.2])
    is_off = rng.uniform() < 1 / 3
    diffuse = rng.uniform(0.35, 0.9) if is_off else diffuse
    return Light(float(ambient), float(diffuse), 0.0 if is_off else float(lamps), rng.uniform(0, 2 * np.pi))


def jitter_colours(rgba: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """f[N, 4]: colours f[N, 4] of surfaces, each a little brighter or darker, paler, of another tint."""
    number = len(rgba)
    grey = rgba[:, :3].mean(1, keepdims=True)
    strength, gain = rng.uniform(0.7, 1.2, (number, 1)), rng.uniform(0.75, 1.2, (number, 1))
    tint = rng.normal(0, 0.04, (number, 3))
    colour = np.clip((grey + strength * (rgba[:, :3] - grey) + tint) * gain, 0, 1)
    return np.concatenate([colour, rgba[:, 3:]], axis=1)


def expose(rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """u8[H, W, 3]: a picture u8[H, W, 3] as a camera of another exposure and with noise takes it."""
    gain, gamma, sigma = rng.uniform([0.7, 0.8, 0.0], [1.35, 1.25, 0.015])
    balance = rng.normal(1.0, 0.03, 3)
    light = gain * balance * (rgb / 255.0) ** gamma + sigma * rng.standard_normal(rgb.shape)
    return np.round(255 * np.clip(light, 0, 1)).astype(np.uint8)


Kind = Literal["free", "overhead", "wrist"]
"""Of cameras."""
_TILT, _SHIFT = np.radians(4.0), 0.03


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
"""Metres from the table; what is not in a scene is there."""
_REACH = 1.5
_LOW = 0.25
"""Metres over the table that the tool stays, so that the arm meets no object."""
_ARM_SPREAD = 0.25
_ARM_TRIES = 20
_SHADOWS = 1024
"""Pixels of a lamp's shadows; the usual 2,048 take most of a small picture's time."""


@dataclass(frozen=True, eq=False)
class RgbdImage:
    """What one camera saw. H rows, W columns.

    Attributes:
      rgb: u8[H, W, 3]. depth: f32[H, W], metres along the optical axis, inf where nothing is.
      label: u8[H, W], see `types`. camera: where it was seen from.
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

    def picture(self, camera: Camera, light_yaw: float = 0.0) -> RgbdImage:
        """What a camera of `cameras.SIZE` sees now."""
        rgb = self._renderer.average(self._data, camera, 1, _REACH, light_yaw=light_yaw)
        depth, geom = self._renderer.measure(self._data, camera)
        label = np.where(geom >= 0, self._label[geom], BACKGROUND).astype(np.uint8)
        return RgbdImage(rgb, depth, label, camera)


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
