"""What pictures of one model may vary in: colours, the table's texture, and light."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.rendering.lighting import FLOOR, KEY_LIGHT, SKY_LIGHT

NUM_TEXTURES = 20
TEXTURES_OF = {"train": range(16), "val": range(16, 18), "test": range(18, NUM_TEXTURES)}
"""By split: what is chosen on the split `val` is judged on textures that are in no other."""
_MATERIAL = "table-{:02d}"
_SIDE = 128
_DARKEST = 0.15
_BRIGHTEST = 0.9


def table_texture(number: int) -> np.ndarray:
    """u8[128, 128, 3]: a table's texture, the same for the same number.

    In turns: plain with specks, boards along one side, marble, checks, and cloth.
    """
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng((number, 17))
    base, other = rng.uniform(_DARKEST, _BRIGHTEST, (2, 3))
    other = base + rng.uniform(0.15, 0.6) * (other - base)
    x, y = np.meshgrid(np.arange(_SIDE), np.arange(_SIDE))
    noise = rng.normal(size=(_SIDE, _SIDE))
    soft = gaussian_filter(noise, 6, mode="wrap")
    soft /= soft.std()
    patterns = (
        lambda: (gaussian_filter(noise, 0.7, mode="wrap") > 0.9) * 1.0,
        lambda: (
            0.5 + 0.5 * np.sin(x / 3.0 + 2 * gaussian_filter(noise, (20, 2), mode="wrap") / 0.06)
        ),
        lambda: np.abs(np.sin(2.5 * soft)),
        lambda: ((x // 16 + y // 16) % 2) * 1.0,
        lambda: 0.5 + 0.25 * (np.sin(x * np.pi / 2) + np.sin(y * np.pi / 2)),
    )
    share = np.clip(patterns[number % len(patterns)](), 0, 1)[..., None]
    return np.round(255 * np.clip(base + share * (other - base), 0, 1)).astype(np.uint8)


def add_table_materials(spec: mujoco.MjSpec) -> None:
    """Adds a material for each table texture."""
    for number in range(NUM_TEXTURES):
        name = _MATERIAL.format(number)
        pixels = table_texture(number)
        image = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
        image.width = _SIDE
        image.height = _SIDE
        image.nchannel = 3
        image.data = pixels.tobytes()
        material = spec.add_material(name=name, specular=0.1, shininess=0.2, texrepeat=(2, 2))
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def table_materials(model: mujoco.MjModel) -> list[int]:
    """The material of each table texture, of a model with `add_table_materials`."""
    return [model.material(_MATERIAL.format(number)).id for number in range(NUM_TEXTURES)]


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
    return Light(
        float(ambient), float(diffuse), 0.0 if is_off else float(lamps), rng.uniform(0, 2 * np.pi)
    )


def jitter_colours(rgba: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """f[N, 4]: colours f[N, 4] of surfaces, each a little brighter or darker, paler, of another tint."""
    number = len(rgba)
    grey = rgba[:, :3].mean(1, keepdims=True)
    strength = rng.uniform(0.7, 1.2, (number, 1))
    gain = rng.uniform(0.75, 1.2, (number, 1))
    tint = rng.normal(0, 0.04, (number, 3))
    colour = np.clip((grey + strength * (rgba[:, :3] - grey) + tint) * gain, 0, 1)
    return np.concatenate([colour, rgba[:, 3:]], axis=1)


class Appearance:
    """How the things of a model look, to be changed between pictures.

    Args:
      model: compiled of a specification with `add_table_materials` and `add_lighting`; it is changed.
      is_object: bool[ngeom], the surfaces of objects.
    """

    def __init__(self, model: mujoco.MjModel, is_object: np.ndarray) -> None:
        self.model = model
        is_table = (model.geom_group == VISUAL_GROUP) & (
            model.geom_bodyid == model.body("support").id
        )
        self._table = np.flatnonzero(is_table)
        self._objects = np.flatnonzero(is_object)
        self._floor = model.geom(FLOOR).id
        self._rgba = model.geom_rgba.copy()
        self._lamps = {name: model.light(name).diffuse.copy() for name in (KEY_LIGHT, SKY_LIGHT)}
        self._materials = table_materials(model)

    def set_light(self, light: Light) -> None:
        """Light for the next pictures; how its lamps are turned is told to them."""
        headlight = self.model.vis.headlight
        headlight.ambient[:] = light.ambient
        headlight.diffuse[:] = light.diffuse
        for name, diffuse in self._lamps.items():
            self.model.light(name).diffuse[:] = light.lamps * diffuse
            self.model.light(name).active[:] = light.lamps > 0

    def set_texture(self, number: int) -> None:
        """The table's texture for the next pictures."""
        self.model.geom_matid[self._table] = self._materials[number]

    def draw_colours(self, rng: np.random.Generator) -> np.ndarray:
        """f32[ngeom, 4]: colours of objects about their own, some grey of the floor, all else as it was."""
        rgba = self._rgba.copy()
        rgba[self._objects] = jitter_colours(rgba[self._objects], rng)
        rgba[self._floor, :3] = rng.uniform(0.1, 0.9) + rng.normal(0, 0.03, 3)
        return np.clip(rgba, 0, 1)
