"""A saved bank as a source of resets: verified scenes as JAX arrays, drawn with a key."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlie
import mujoco
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.arguments import check_key, is_known
from cluttergen_jax.placement.region import from_pose
from cluttergen_jax.scene import SceneCollection, collect
from cluttergen_jax.scene.bank import Bank, read_bank
from cluttergen_jax.scene.bank.hub import find_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.types import Array


class BankArrays(struct.PyTreeNode):
    """The S scenes of a bank that stand, in one MuJoCo model of K objects; see `load_bank`. N slots.

    A scene that is taken from it (`reset`, `scene`) is of this type too, without the leading axis S.

    Attributes:
      index: i32[S], their numbers in the bank.
      object_index: i32[S, N], the model's object in each slot, in the order of placement; -1 for none.
      is_present: bool[S, K], the model's objects that belong to the scene.
      qpos: f32[S, 7 K], the model's configuration; objects that do not belong wait far away.
      bank: the bank on disk.
      collection: its scenes in one MuJoCo model, on the host.
    """

    index: Array
    object_index: Array
    is_present: Array
    qpos: Array
    bank: Bank = struct.field(pytree_node=False)
    collection: SceneCollection = struct.field(pytree_node=False)

    def __len__(self) -> int:
        return len(self.index)

    @property
    def is_placed(self) -> Array:
        """bool[S, N]: there is an object in the slot."""
        return self.object_index >= 0

    @property
    def poses(self) -> Array:
        """f32[S, N, 7]: world pose of each slot's object, metres, wxyz; the identity where there is none."""
        poses = self.qpos.reshape(*self.is_present.shape, 7)
        placed = jnp.take_along_axis(poses, jnp.maximum(self.object_index, 0)[..., None], axis=-2)
        return jnp.where(self.is_placed[..., None], placed, jnp.eye(7, dtype=jnp.float32)[3])

    @property
    def T_world_object(self) -> jaxlie.SE3:
        """SE3[S, N]: `poses`."""
        return from_pose(self.poses)

    @property
    def xfrc_applied(self) -> Array:
        """f32[S, nbody, 6], newtons: what keeps objects that do not belong in the air where they wait."""
        model, bodies = self.collection.model, self.collection.model.jnt_bodyid
        weight = jnp.asarray(-model.opt.gravity * model.body_mass[bodies, None], jnp.float32)
        applied = jnp.where(self.is_present[..., None], 0.0, weight)
        none = jnp.zeros((*self.is_present.shape[:-1], model.nbody, 6))
        return none.at[..., bodies, :3].set(applied)

    @property
    def names(self) -> tuple[str, ...]:
        """The model's objects, in the order of `object_index`; bodies and joints bear them."""
        return self.collection.names

    def model(self) -> mujoco.MjModel:
        """One compiled model for all scenes: put a scene's `qpos` and `xfrc_applied` into its data."""
        return self.collection.model

    def reset(self, key: Array) -> BankArrays:
        """A scene that stands, all of them equally likely. Pure: to be compiled and mapped.

        Args:
          key: one PRNG key, consumed.

        Raises:
          ConfigError: `key` is not one key.
        """
        check_key(key, "reset")
        return self.scene(jax.random.randint(key, (), 0, len(self)))

    def scene(self, place: Array) -> BankArrays:
        """The scene at `place`, i32, among those that stand (0 to len - 1); it may be traced.

        Raises:
          ConfigError: there is no such scene. A traced place is moved to the nearest.
        """
        if is_known(place) and not 0 <= int(place) < len(self):
            raise ConfigError(f"scene {place} of those that stand", f"0 to {len(self) - 1}")
        return jax.tree.map(lambda leaf: leaf[place], self)


def load_bank(path: str | Path, *, hub: str | None = None, revision: str | None = None) -> BankArrays:
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
    return BankArrays(
        index=jnp.array([scene.origin.index for scene in scenes], jnp.int32),
        object_index=jnp.asarray(collection.object_index, jnp.int32),
        is_present=jnp.asarray(collection.is_present),
        qpos=jnp.asarray(collection.qpos, jnp.float32),
        bank=bank,
        collection=collection,
    )
