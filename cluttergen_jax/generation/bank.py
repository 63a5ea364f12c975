"""A saved bank as a source of resets: verified scenes as JAX arrays, drawn with a key."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.arguments import check_key, is_known
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.scene import SceneCollection, collect
from cluttergen_jax.scene.bank import Bank, read_bank
from cluttergen_jax.scene.bank.hub import find_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.types import Array


class StoredScene(struct.PyTreeNode):
    """A scene of a bank that stands, in the terms of `SceneBank.model`. N slots, K objects in the model.

    Attributes:
      index: i32, its number in the bank.
      object_index: i32[N], the model's object in each slot, in the order of placement; -1 for none.
      is_placed: bool[N], there is one.
      T_world_object: SE3[N], metres; the identity where there is none.
      is_present: bool[K], the model's objects that belong to the scene.
      qpos: f32[7 K], the model's configuration; objects that do not belong wait far away.
      xfrc_applied: f32[nbody, 6], newtons: what keeps those in the air where they wait.
    """

    index: Array
    object_index: Array
    is_placed: Array
    T_world_object: jaxlie.SE3
    is_present: Array
    qpos: Array
    xfrc_applied: Array


class StoredArrays(struct.PyTreeNode):
    """What is stored of the S scenes of a bank that stand. N slots, K objects in `SceneBank.model`.

    Attributes:
      index: i32[S], their numbers in the bank.
      object_index: i32[S, N], the model's object in each slot, -1 for none.
      poses: f32[S, N, 7], world pose of each slot's object, metres, wxyz; the identity where there is none.
      is_present: bool[S, K], the model's objects that belong to the scene.
      qpos: f32[S, 7 K], the model's configuration.
      weight: f32[nbody, 6], newtons, upwards: what keeps an object that does not belong where it waits.
    """

    index: Array
    object_index: Array
    poses: Array
    is_present: Array
    qpos: Array
    weight: Array


@dataclass(frozen=True, eq=False)
class SceneBank:
    """The scenes of a bank that stand; see `load_bank`.

    Attributes:
      bank: the bank on disk.
      collection: all its scenes in one MuJoCo model.
      arrays: what `reset` draws from, on JAX's default device.
    """

    bank: Bank
    collection: SceneCollection
    arrays: StoredArrays

    def __len__(self) -> int:
        return len(self.collection.qpos)

    @property
    def names(self) -> tuple[str, ...]:
        """The model's objects, in the order of `StoredScene.object_index`; bodies and joints bear them."""
        return self.collection.names

    def model(self) -> mujoco.MjModel:
        """One compiled model for all scenes: put `StoredScene.qpos` and `xfrc_applied` into its data."""
        return self.collection.model

    def reset(self, key: Array) -> StoredScene:
        """A scene that stands, all of them equally likely. Pure: to be compiled and mapped.

        Args:
          key: one PRNG key, consumed.

        Raises:
          ConfigError: `key` is not one key.
        """
        check_key(key, "reset")
        return self.scene(jax.random.randint(key, (), 0, len(self)))

    def scene(self, place: Array) -> StoredScene:
        """The scene at `place`, i32, among those that stand (0 to len - 1); it may be traced.

        Raises:
          ConfigError: there is no such scene. A traced place is moved to the nearest.
        """
        if is_known(place) and not 0 <= int(place) < len(self):
            raise ConfigError(f"scene {place} of those that stand", f"0 to {len(self) - 1}")
        arrays = self.arrays
        object_index, is_present = arrays.object_index[place], arrays.is_present[place]
        bodies = jnp.asarray(self.collection.model.jnt_bodyid)
        is_absent = jnp.zeros(arrays.weight.shape[0], bool).at[bodies].set(~is_present)
        return StoredScene(
            index=arrays.index[place],
            object_index=object_index,
            is_placed=object_index >= 0,
            T_world_object=from_pose(arrays.poses[place]),
            is_present=is_present,
            qpos=arrays.qpos[place],
            xfrc_applied=jnp.where(is_absent[:, None], arrays.weight, 0.0),
        )


def load_bank(path: str | Path, *, hub: str | None = None, revision: str | None = None) -> SceneBank:
    """Reads a bank for use as the reset of an environment; scenes that failed are left out.

    Args:
      path: a bank's folder, or OWNER/NAME on a hub: pulled when it is first asked for, and kept
        (`pull_bank`, extra `hub`).
      hub, revision: of such a name; see `push_bank`. A revision is pulled each time.

    Raises:
      BankError: there is no bank, it or one of its assets is damaged, or no scene in it stands.
      UnsafePathError: it names paths outside of its folder.
    """
    bank = read_bank(find_bank(path, hub=hub, revision=revision))
    scenes = list(read_scenes(bank))
    collection = collect(scenes)
    object_index = collection.object_index
    poses = collection.qpos.reshape(len(scenes), -1, 7)[np.arange(len(scenes))[:, None], object_index]
    poses = np.where(object_index[..., None] >= 0, poses, np.eye(7)[3])
    model = collection.model
    weight = np.zeros((model.nbody, 6))
    weight[model.jnt_bodyid, :3] = -model.opt.gravity * model.body_mass[model.jnt_bodyid, None]
    arrays = StoredArrays(
        index=jnp.array([scene.origin.index for scene in scenes], jnp.int32),
        object_index=jnp.asarray(object_index, jnp.int32),
        poses=jnp.asarray(poses, jnp.float32),
        is_present=jnp.asarray(collection.is_present),
        qpos=jnp.asarray(collection.qpos, jnp.float32),
        weight=jnp.asarray(weight, jnp.float32),
    )
    return SceneBank(bank, collection, arrays)
