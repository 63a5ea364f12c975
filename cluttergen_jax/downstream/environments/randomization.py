"""Domain randomization: what of a world differs from episode to episode, drawn with the reset's key."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from numbers import Real

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation import BankWorld
from cluttergen_jax.geometry import Array
from cluttergen_jax.rendering import add_table_materials, table_materials

_MOST = 10.0
_LEAST_FACTOR = 0.05
_FACTORS = ("mass", "friction", "light")
_MAX_COLOUR = 1.0
_MAX_SHIFT = 1.0
_MAX_TURN = math.pi


@dataclass(frozen=True)
class RandomizationConfig:
    """Ranges of what is drawn anew for each episode, uniformly; a factor of 1 and 0 leave things as they are.

    Sizes of objects are not among these: meshes belong to the compiled model. Import the same mesh in
    several sizes, and they are drawn as objects are.

    Attributes:
      mass: least and greatest factor of each object's mass and inertia.
      friction: of all friction, the support's and the robot's included, since of two things that touch the
        rougher one decides.
      colour: most by which each channel of an object's and the support's colours is multiplied or divided,
        less 1.
      texture: give the support one of 20 textures (`cluttergen dataset --vary texture`); of a support that
        has an image of its own, too.
      light: factor of all lamps.
      camera_shift: metres that each camera is moved at most along each axis.
      camera_turn: radians that each camera is turned at most about each axis.
    """

    mass: tuple[float, float] = (0.8, 1.25)
    friction: tuple[float, float] = (0.8, 1.25)
    colour: float = 0.25
    texture: bool = True
    light: tuple[float, float] = (0.6, 1.2)
    camera_shift: float = 0.01
    camera_turn: float = 0.02

    def __post_init__(self) -> None:
        for name in _FACTORS:
            given = getattr(self, name)
            is_pair = isinstance(given, (tuple, list)) and len(given) == 2
            if not (is_pair and all(isinstance(each, Real) for each in given)) or not (
                _LEAST_FACTOR <= given[0] <= given[1] <= _MOST
            ):
                raise ConfigError(
                    f"{type(self).__name__}.{name} = {given!r}",
                    f"two factors, the lesser first, {_LEAST_FACTOR:g} to {_MOST:g}",
                    f"{name}=(1.0, 1.0) to leave it as it is",
                )
        most = {"colour": _MAX_COLOUR, "camera_shift": _MAX_SHIFT, "camera_turn": _MAX_TURN}
        for name, limit in most.items():
            given = getattr(self, name)
            if (
                isinstance(given, bool)
                or not isinstance(given, (int, float))
                or not 0 <= given <= limit
            ):
                raise ConfigError(f"{type(self).__name__}.{name} = {given!r}", f"0 to {limit:g}")
        if not isinstance(self.texture, bool):
            raise ConfigError(f"{type(self).__name__}.texture = {self.texture!r}", "True or False")


def prepare(spec: mujoco.MjSpec, config: RandomizationConfig) -> None:
    """Adds what is drawn from; before the specification is compiled."""
    if config.texture:
        add_table_materials(spec)


def draw_fields(
    key: Array, config: RandomizationConfig, world: BankWorld
) -> tuple[dict[str, Array], Array]:
    """Fields of a world's model for one episode, drawn about its own, whatever episodes before have written.

    Args:
      key: consumed.

    Returns:
      The fields, and f32[K], the factor of each object's mass.
    """
    model = world.model
    own = world.own_field
    bodies = world.bodies
    dofs = world.object_dofs
    keys = dict(zip((each.name for each in fields(config)), jax.random.split(key, 7), strict=True))
    found: dict[str, Array] = {}
    mass = jax.random.uniform(
        keys["mass"], (len(bodies),), minval=config.mass[0], maxval=config.mass[1]
    )
    if config.mass != (1, 1):
        # A free body's inverse weight is exactly proportional; MuJoCo's own way would need a whole model.
        factor = mass[:, None]
        inverse = 1 / mass[:, None]
        found["body_mass"] = _times(own("body_mass"), bodies, mass)
        found["body_inertia"] = _times(own("body_inertia"), bodies, factor)
        found["body_subtreemass"] = _times(own("body_subtreemass"), bodies, mass)
        found["body_invweight0"] = _times(own("body_invweight0"), bodies, inverse)
        found["dof_invweight0"] = _times(own("dof_invweight0"), dofs, inverse)
        found["dof_M0"] = _times(own("dof_M0"), dofs, factor)
    if config.friction != (1, 1):
        factor = jax.random.uniform(
            keys["friction"], (), minval=config.friction[0], maxval=config.friction[1]
        )
        found["geom_friction"] = factor * jnp.asarray(own("geom_friction"), jnp.float32)
    is_support = (model.geom_bodyid == model.body("support").id) & (
        model.geom_group == VISUAL_GROUP
    )
    if config.colour:
        seen = np.flatnonzero(
            (np.isin(model.geom_bodyid, bodies) & (model.geom_group == VISUAL_GROUP)) | is_support
        )
        most = math.log1p(config.colour)
        gain = jnp.exp(
            jax.random.uniform(keys["colour"], (len(seen), 3), minval=-most, maxval=most)
        )
        rgb = jnp.clip(own("geom_rgba")[seen, :3] * gain, 0, 1)
        found["geom_rgba"] = jnp.asarray(own("geom_rgba")).at[seen, :3].set(rgb)
    if config.texture:
        drawn = jax.random.choice(keys["texture"], jnp.array(table_materials(model)))
        found["geom_matid"] = jnp.where(is_support, drawn, jnp.asarray(own("geom_matid")))
    if config.light != (1, 1) and model.nlight:
        factor = jax.random.uniform(
            keys["light"], (), minval=config.light[0], maxval=config.light[1]
        )
        found["light_diffuse"] = factor * jnp.asarray(own("light_diffuse"), jnp.float32)
    if model.ncam:
        shift_key, turn_key = jax.random.split(keys["camera_shift"])
        shift = config.camera_shift * jax.random.uniform(
            shift_key, (model.ncam, 3), minval=-1, maxval=1
        )
        turn = config.camera_turn * jax.random.uniform(
            turn_key, (model.ncam, 3), minval=-1, maxval=1
        )
        if config.camera_shift:
            found["cam_pos"] = jnp.asarray(own("cam_pos"), jnp.float32) + shift
        if config.camera_turn:
            found["cam_quat"] = _rotate(jnp.asarray(own("cam_quat"), jnp.float32), turn)
    return found, mass


def _times(values: np.ndarray, rows: np.ndarray, factor: Array) -> Array:
    """The values, those of some rows multiplied; dofs i[K, 6] by f[K, 1], bodies i[K] by f[K, ...]."""
    return jnp.asarray(values, jnp.float32).at[rows].multiply(factor)


def _rotate(quaternion: Array, turn: Array) -> Array:
    """f32[n, 4] wxyz, turned first by rotation vectors f32[n, 3] of their own frames."""
    angle = jnp.linalg.norm(turn, axis=-1, keepdims=True)
    half = jnp.concatenate([jnp.cos(angle / 2), turn * jnp.sinc(angle / (2 * jnp.pi)) / 2], axis=-1)
    w = quaternion[:, :1]
    v = quaternion[:, 1:]
    u = half[:, :1]
    x = half[:, 1:]
    scalar = w * u - (v * x).sum(-1, keepdims=True)
    return jnp.concatenate([scalar, w * x + u * v + jnp.cross(v, x)], axis=-1)
