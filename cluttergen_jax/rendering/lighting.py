"""What makes a model good to look at: light, floor and background, added to a spec before it is compiled."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import SHININESS, SPECULAR, VISUAL_GROUP, add_image
from cluttergen_jax.rendering.furnish import covering_texture
from cluttergen_jax.rendering.look import Covering, Lamp, Look

KEY_LIGHT = "lighting/key"
SKY_LIGHT = "lighting/sky"
FLOOR = "lighting/floor"
_MATTE = "lighting/matte"
_GROUND = (0.82, 0.82, 0.82)
_HORIZON = (0.90, 0.905, 0.915)
_ZENITH = (0.62, 0.69, 0.78)
# Of the two sides that the default view shows, the left one is to be the brighter.
KEY_DIRECTION = (-0.16, 0.55, -0.82)
_KEY_SPREAD = 0.10
"""Radians about its direction in which the key light is seen."""


def _add_background(spec: mujoco.MjSpec, look: Look | None) -> None:
    zenith = _ZENITH
    horizon = _HORIZON
    if look is not None:
        # A room has no horizon: in place of its walls there is their colour.
        horizon = look.sky.colour if look.wall is None else _mean_colour(look.wall)
        zenith = look.sky.colour if look.wall is None else horizon
    spec.add_texture(
        name="lighting/sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=zenith,
        rgb2=horizon,
        width=256,
        height=256 * 6,
    )
    # The floor fades into the horizon's colour, so that no edge shows.
    spec.visual.rgba.haze = (*horizon, 1.0)
    spec.visual.map.haze = 0.6


def _mean_colour(covering: Covering) -> tuple[float, float, float]:
    pixels = np.asarray(covering_texture(covering).image, np.float64)
    red, green, blue = (pixels.reshape(-1, 3).mean(0) / 255).tolist()
    return red, green, blue


def _add_floor(spec: mujoco.MjSpec, look: Look | None) -> None:
    material = spec.add_material(name=FLOOR, rgba=(*_GROUND, 1.0), specular=0.0, shininess=0.0)
    if look is not None:
        image = add_image(spec, covering_texture(look.floor))
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = image
        material.texuniform = True
        # On a plane MuJoCo counts by two metres.
        material.texrepeat = (2 / look.floor.tile, 2 / look.floor.tile)
        material.rgba = (1.0, 1.0, 1.0, 1.0)
        material.roughness = look.floor.roughness
        material.metallic = look.floor.metallic
    spec.worldbody.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 1),
        material=FLOOR,
        contype=0,
        conaffinity=0,
        group=VISUAL_GROUP,
    )


def _add_lights(spec: mujoco.MjSpec, look: Look | None) -> None:
    headlight = spec.visual.headlight
    headlight.active = 1
    headlight.specular = (0.0, 0.0, 0.0)
    if look is None:
        headlight.ambient = (0.25, 0.25, 0.25)
        headlight.diffuse = (0.20, 0.20, 0.20)
        _add_light(spec, KEY_LIGHT, KEY_DIRECTION, (0.54, 0.53, 0.51), 0.25, _KEY_SPREAD)
        _add_light(spec, SKY_LIGHT, (0, 0, -1), (0.44, 0.44, 0.45), 0.0)
        return
    sky = look.exposure * look.sky.strength * np.array(look.sky.colour)
    headlight.ambient = 0.9 * sky
    headlight.diffuse = 0.15 * sky
    for name, lamp in zip(lamp_names(look), look.lamps, strict=True):
        light = look.exposure * lamp.strength * np.array(lamp.colour)
        spread = float(np.arctan(lamp.size / 2 / lamp.distance))
        _add_light(spec, name, -lamp_direction(lamp), 0.7 * light, 0.25, spread)
    _add_light(spec, SKY_LIGHT, (0, 0, -1), 0.6 * sky, 0.0)


def _add_light(
    spec: mujoco.MjSpec,
    name: str,
    direction: Sequence[float] | np.ndarray,
    diffuse: Sequence[float] | np.ndarray,
    specular: float,
    spread: float = 0.0,
) -> None:
    """Adds a light from far away; `renderer.shift_lights` takes its bulb's radius as an angle, in radians."""
    spec.worldbody.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=direction,
        diffuse=diffuse,
        specular=(specular, specular, specular),
        ambient=(0.0, 0.0, 0.0),
        castshadow=True,
        bulbradius=spread,
    )


def lamp_names(look: Look) -> list[str]:
    """Names of the lights that stand for a look's lamps, the first one being the key light."""
    return [KEY_LIGHT, *(f"{KEY_LIGHT}-{number}" for number in range(1, len(look.lamps)))]


def lamp_direction(lamp: Lamp) -> np.ndarray:
    """f64[3], of length 1: from the scene to the lamp."""
    azimuth = np.radians(lamp.azimuth)
    elevation = np.radians(lamp.elevation)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _add_materials(spec: mujoco.MjSpec) -> None:
    """Gives a matte surface to every drawn geom that has none; its colour stays its own."""
    spec.add_material(name=_MATTE, specular=SPECULAR, shininess=SHININESS)
    for geom in spec.geoms:
        if geom.material == "":
            # A geom whose colour is MuJoCo's default would take the material's white.
            if np.allclose(geom.rgba, (0.5, 0.5, 0.5, 1.0), atol=1e-6):
                geom.rgba = (0.505, 0.505, 0.505, 1.0)
            geom.material = _MATTE


def add_lighting(spec: mujoco.MjSpec, look: Look | None = None) -> mujoco.MjSpec:
    """Adds light, a floor at z = 0, a background and matte surfaces to `spec`, and returns it.

    Nothing that is added touches anything or has mass: the physics stays what it was. Call it last, before
    the spec is compiled, and once.

    Args:
      look: whose floor and light they are; None has a grey floor.
    """
    _add_materials(spec)
    _add_background(spec, look)
    _add_lights(spec, look)
    _add_floor(spec, look)
    spec.visual.quality.shadowsize = 2048
    spec.visual.quality.offsamples = 0
    return spec
