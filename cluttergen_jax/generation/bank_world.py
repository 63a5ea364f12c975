"""A bank inside a model that holds more than its objects, such as a robot; states of it, drawn by a key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.arguments import check_key
from cluttergen_jax.numerics import new_key, with_own_settings
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.types import Array

if TYPE_CHECKING:
    from cluttergen_jax.generation.bank import BankArrays

_HERE = (0.0, 0.0, 0.0)
_UNTURNED = (1.0, 0.0, 0.0, 0.0)
_MOST_SEED = 2**32 - 1


class WorldState(struct.PyTreeNode):
    """The beginning of an episode, for all of a model. K objects of the bank, N slots of a scene.

    Attributes:
      qpos: f32[nq]; qvel: f32[nv]; ctrl: f32[nu].
      xfrc_applied: f32[nbody, 6], newtons: what holds objects that the scene lacks where they wait.
      index: i32, the scene's number in the bank.
      object_index: i32[N], the object in each slot, in the order of placement; -1 for none.
      is_present: bool[K], the objects that belong to the scene.
      fields: fields of the model that this episode has of its own, by their names in `MjModel` and
        `mjx.Model`; empty unless something is randomized.
    """

    qpos: Array
    qvel: Array
    ctrl: Array
    xfrc_applied: Array
    index: Array
    object_index: Array
    is_present: Array
    fields: dict[str, Array]


@dataclass(frozen=True)
class BankAttachment:
    """Where the objects of a bank are found in a specification that they were attached to.

    Attributes:
      bank: the scenes.
      prefix: before every name of theirs.
      position, quaternion: T_world_scene, metres, wxyz.
    """

    bank: BankArrays
    prefix: str = ""
    position: tuple[float, ...] = _HERE
    quaternion: tuple[float, ...] = _UNTURNED

    def world(self, model: mujoco.MjModel) -> BankWorld:
        """The compiled model with resets from the bank; what is no object begins as the model has it.

        Raises:
          ConfigError: the model is not of the specification that the bank was attached to.
        """
        if not isinstance(model, mujoco.MjModel):
            raise ConfigError(
                f"world of a {type(model).__name__}", "a mujoco.MjModel", "spec.compile()"
            )
        missing = [name for name in self.bank.names if not _has_joint(model, self.prefix + name)]
        if missing:
            raise ConfigError(
                f"a model without {self.prefix}{missing[0]}",
                "that of the specification it was attached to",
            )
        return BankWorld(self, model)


@dataclass(frozen=True, eq=False, repr=False)
class BankWorld:
    """A model with all objects of a bank in it, whatever else it holds and in whatever order.

    Attributes:
      attachment: where the objects are.
      model: compiled.
      qpos0: f64[nq], where everything begins that is no object; the model's own if not given.
      ctrl0: f64[nu], with these controls; zeros if not given.
    """

    attachment: BankAttachment
    model: mujoco.MjModel
    qpos0: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ctrl0: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.qpos0):
            object.__setattr__(self, "qpos0", self.model.qpos0.copy())
        if not len(self.ctrl0):
            object.__setattr__(self, "ctrl0", np.zeros(self.model.nu))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.bank!r}, nq={self.model.nq}, nu={self.model.nu})"

    @property
    def bank(self) -> BankArrays:
        """The scenes."""
        return self.attachment.bank

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The K objects, as their bodies and free joints are called in the model."""
        return tuple(self.attachment.prefix + name for name in self.bank.names)

    @cached_property
    def bodies(self) -> np.ndarray:
        """i[K], of the objects."""
        return np.array([self.model.body(name).id for name in self.names])

    @cached_property
    def object_qpos(self) -> np.ndarray:
        """i[K, 7], where each object's pose is in `qpos`."""
        return self._addresses(self.model.jnt_qposadr, 7)

    @cached_property
    def object_dofs(self) -> np.ndarray:
        """i[K, 6], where each object's velocity is in `qvel`."""
        return self._addresses(self.model.jnt_dofadr, 6)

    def _addresses(self, first: np.ndarray, number: int) -> np.ndarray:
        joints = [self.model.joint(name).id for name in self.names]
        return first[joints][:, None] + np.arange(number)

    @with_own_settings
    def reset(self, seed: int | Array, index: int | None = None) -> WorldState:
        """The beginning of an episode: a scene of the bank, all equally likely, and everything else at home.

        Args:
          seed: one PRNG key: then it is pure, to be compiled and mapped, and gives arrays of JAX. Or a whole
            number: then it gives arrays of NumPy. Equal ones give equal states.
          index: the number in the bank of the scene, if it is not to be drawn.

        Raises:
          ConfigError: the seed is neither, or the bank holds no stable scene of that number.
        """
        is_whole = isinstance(seed, Integral) and not isinstance(seed, bool)
        if is_whole and not 0 <= int(seed) <= _MOST_SEED:
            raise ConfigError(
                f"reset(seed={seed})", f"0 to {_MOST_SEED}, or one key of JAX", "reset(0)"
            )
        key = new_key(int(seed)) if is_whole else seed
        check_key(key, "reset")
        scene_key, own_key = jax.random.split(key)
        scene = (
            self.bank.reset(scene_key) if index is None else self.bank.scene(self._place_of(index))
        )
        state = self._state(scene, own_key)
        return jax.device_get(state) if is_whole else state

    def _place_of(self, index: int) -> int:
        known = np.asarray(self.bank.index)
        is_whole = isinstance(index, Integral) and not isinstance(index, bool)
        found = np.flatnonzero(is_whole & (known == index))
        if not len(found):
            raise ConfigError(
                f"scene {index!r} of {self.bank!r}",
                f"stable scenes: {', '.join(map(str, known[:8]))}{' ...' if len(known) > 8 else ''}",
            )
        return int(found[0])

    def _state(self, scene: BankArrays, key: Array) -> WorldState:
        num_objects = len(self.names)
        poses = self._to_world(scene.qpos.reshape(num_objects, 7))
        # By this model's gravity: options of what a bank is attached to are its own.
        lift = -self.own_field("body_mass")[self.bodies, None] * self.model.opt.gravity
        held = jnp.where(scene.is_present[:, None], 0.0, jnp.asarray(lift, jnp.float32))
        force = jnp.zeros((self.model.nbody, 6))
        return WorldState(
            qpos=jnp.asarray(self.qpos0, jnp.float32).at[self.object_qpos].set(poses),
            qvel=jnp.zeros(self.model.nv),
            ctrl=jnp.asarray(self.ctrl0, jnp.float32),
            xfrc_applied=force.at[self.bodies, :3].set(held),
            index=scene.index,
            object_index=scene.object_index,
            is_present=scene.is_present,
            fields={},
        )

    def _to_world(self, poses: Array) -> Array:
        """f32[K, 7]: poses of the bank's frame in the model's."""
        frame = (*self.attachment.position, *self.attachment.quaternion)
        if frame == (*_HERE, *_UNTURNED):
            return poses
        moved: jaxlie.SE3 = from_pose(jnp.asarray(frame, jnp.float32)) @ from_pose(poses)
        return jnp.concatenate([moved.translation(), moved.rotation().wxyz], axis=-1)

    @cached_property
    def _own_fields(self) -> dict[str, np.ndarray]:
        """Of the fields of the model that episodes have written, what they were before."""
        return {}

    def own_field(self, name: str) -> np.ndarray:
        """A field of the model as it is where no episode changes it."""
        return self._own_fields.get(name, getattr(self.model, name))

    def put(self, data: mujoco.MjData, state: WorldState) -> None:
        """Puts `data` at rest at the beginning of an episode, and `state.fields` into the model.

        Raises:
          ConfigError: either is of another model, or it is a batch of states.
        """
        if not isinstance(data, mujoco.MjData):
            raise ConfigError(
                f"put into a {type(data).__name__}", "a mujoco.MjData", "MjData(world.model)"
            )
        host: Any = jax.device_get(state)
        for what, shape in (("data", data.qpos.shape), ("state", np.shape(host.qpos))):
            if shape != (self.model.nq,):
                raise ConfigError(
                    f"{what} with qpos of shape {shape}",
                    f"of this model, qpos f[{self.model.nq}]",
                    "of a batch one state: jax.tree.map(lambda x: x[0], states)",
                )
        for name in host.fields:
            self._own_fields.setdefault(name, getattr(self.model, name).copy())
        for name, own in self._own_fields.items():
            getattr(self.model, name)[:] = host.fields.get(name, own)
        mujoco.mj_resetData(self.model, data)
        for name in ("qpos", "qvel", "ctrl", "xfrc_applied"):
            getattr(data, name)[:] = getattr(host, name)
        mujoco.mj_forward(self.model, data)


def _has_joint(model: mujoco.MjModel, name: str) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0


def attach_bank(
    bank: BankArrays,
    spec: mujoco.MjSpec,
    prefix: str,
    position: Sequence[float],
    quaternion: Sequence[float],
    support: bool,
) -> BankAttachment:
    """See `BankArrays.attach_to`."""
    bank.waiting_scene().attach_to(
        spec, prefix, position=position, quaternion=quaternion, support=support
    )
    # It holds a state of no scene, and is not extended where more is added.
    spec.delete(spec.key(f"{prefix}scene"))
    return BankAttachment(bank, prefix, tuple(map(float, position)), tuple(map(float, quaternion)))
