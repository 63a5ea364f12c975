"""What makes a model good to look at: light, floor and background, added to a spec before it is compiled."""

from __future__ import annotations

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import SHININESS, SPECULAR, VISUAL_GROUP

KEY_LIGHT = "lighting/key"
SKY_LIGHT = "lighting/sky"
FLOOR = "lighting/floor"
_MATTE = "lighting/matte"
_GROUND = (0.82, 0.82, 0.82)
_HORIZON = (0.90, 0.905, 0.915)
_ZENITH = (0.62, 0.69, 0.78)
# Of the two sides that the default view shows, the left one is to be the brighter.
KEY_DIRECTION = (-0.16, 0.55, -0.82)


def _add_background(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="lighting/sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_ZENITH,
        rgb2=_HORIZON,
        width=256,
        height=256 * 6,
    )
    # The floor fades into the horizon's colour, so that no edge shows.
    spec.visual.rgba.haze = (*_HORIZON, 1.0)
    spec.visual.map.haze = 0.6


def _add_floor(spec: mujoco.MjSpec) -> None:
    spec.add_material(name=FLOOR, rgba=(*_GROUND, 1.0), specular=0.0, shininess=0.0)
    spec.worldbody.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 1),
        material=FLOOR,
        contype=0,
        conaffinity=0,
        group=VISUAL_GROUP,
    )


def _add_lights(spec: mujoco.MjSpec) -> None:
    headlight = spec.visual.headlight
    headlight.active = 1
    headlight.ambient = (0.25, 0.25, 0.25)
    headlight.diffuse = (0.20, 0.20, 0.20)
    headlight.specular = (0.0, 0.0, 0.0)
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    common = {"type": directional, "castshadow": True, "ambient": (0.0, 0.0, 0.0)}
    spec.worldbody.add_light(
        name=KEY_LIGHT,
        dir=KEY_DIRECTION,
        diffuse=(0.54, 0.53, 0.51),
        specular=(0.25, 0.25, 0.25),
        **common,
    )
    spec.worldbody.add_light(
        name=SKY_LIGHT,
        dir=(0, 0, -1),
        diffuse=(0.44, 0.44, 0.45),
        specular=(0.0, 0.0, 0.0),
        **common,
    )


def _add_materials(spec: mujoco.MjSpec) -> None:
    """Gives a matte surface to every drawn geom that has none; its colour stays its own."""
    spec.add_material(name=_MATTE, specular=SPECULAR, shininess=SHININESS)
    for geom in spec.geoms:
        if geom.material == "":
            # A geom whose colour is MuJoCo's default would take the material's white.
            if np.allclose(geom.rgba, (0.5, 0.5, 0.5, 1.0), atol=1e-6):
                geom.rgba = (0.505, 0.505, 0.505, 1.0)
            geom.material = _MATTE


def add_lighting(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Adds light, a floor at z = 0, a background and matte surfaces to `spec`, and returns it.

    Nothing that is added touches anything or has mass: the physics stays what it was. Call it last, before
    the spec is compiled, and once.
    """
    _add_materials(spec)
    _add_background(spec)
    _add_lights(spec)
    _add_floor(spec)
    spec.visual.quality.shadowsize = 2048
    spec.visual.quality.offsamples = 0
    return spec
