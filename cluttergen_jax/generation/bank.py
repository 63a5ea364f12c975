"""A saved bank as a source of resets: verified scenes as JAX arrays, drawn with a key."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence, Sized
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
import pyarrow as pa
from flax import struct

from cluttergen_jax.config import check_range
from cluttergen_jax.errors import BankError, ConfigError, range_text
from cluttergen_jax.generation.arguments import check_key, is_known
from cluttergen_jax.generation.bank_world import BankAttachment, attach_bank
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.placement import from_pose
from cluttergen_jax.scene import Bank, Scene, SceneCollection, read_bank, read_scenes, scene_cameras
from cluttergen_jax.scene.bank.hub import find_bank
from cluttergen_jax.scene.bank.scene import PlacedAssets, SceneArrayReader, join_scenes
from cluttergen_jax.scene.collection import SceneModel, compile_scenes
from cluttergen_jax.scene.scene import KEYFRAME
from cluttergen_jax.types import Array

if TYPE_CHECKING:
    from PIL import Image

_MOST = 2**31 - 1
_SHEET = 12
"""Scenes of a sheet."""


class BankArrays(struct.PyTreeNode):
    """The S scenes of a bank that stand, in one MuJoCo model of K objects; see `load_bank`. N slots.

    A scene taken from it (`reset`, `scene`) is of this type too, without the leading axis S. `bank[i]`
    and iteration give a `Scene`.

    Attributes:
      index: i32[S], their numbers in the bank.
      object_index: i32[S, N], the model's object in each slot, in the order of placement; -1 for none.
      is_present: bool[S, K], the model's objects that belong to the scene.
      qpos: f32[S, 7 K], the model's configuration; objects that do not belong wait far away.
      bank: the bank on disk.
      compiled: the MuJoCo model.
    """

    index: Array
    object_index: Array
    is_present: Array
    qpos: Array
    bank: Bank = struct.field(pytree_node=False)
    compiled: SceneModel = struct.field(pytree_node=False)

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, place: int | slice) -> Scene | list[Scene]:
        """The scene at `place` on the host, read from the bank; several by a slice. `scene` has it as arrays.

        Raises:
          ConfigError: there is no such scene, or this is one scene or in compiled code.
          BankError: the bank was changed since.
        """
        numbers = self._numbers()
        if isinstance(place, slice):
            return [self.bank[int(number)] for number in numbers[place]]
        if not -len(numbers) <= operator.index(place) < len(numbers):
            raise ConfigError(f"scene {place} of those that stand", range_text(0, len(numbers) - 1))
        return self.bank[int(numbers[place])]

    def __iter__(self) -> Iterator[Scene]:
        """The scenes on the host, one by one."""
        return read_scenes(self.bank, self._numbers().tolist())

    def _numbers(self) -> np.ndarray:
        """i32[S]: `index` on the host."""
        if not is_known(self.index) or np.ndim(self.index) != 1:
            raise ConfigError(
                "scenes on the host, of one scene or in compiled code",
                "a bank as `load_bank` reads it",
            )
        return np.asarray(self.index)

    def sheet(self, **options: Any) -> Image.Image:
        """Draws scenes on one contact sheet: the first 12 of these, or see `Bank.sheet`."""
        options.setdefault("scenes", self._numbers()[:_SHEET].tolist())
        return self.bank.sheet(**options)

    def show(self, **options: Any) -> Any:
        """Shows the bank in the viewer; see `Scene.show`."""
        return self.bank.show(**options)

    def _repr_html_(self) -> str | None:
        is_bank = is_known(self.index) and np.ndim(self.index) == 1
        return self.bank._repr_html_() if is_bank else None

    def __repr__(self) -> str:
        number = np.prod(np.shape(self.index), dtype=int)
        return f"BankArrays({number} scenes of {str(self.bank.path)!r}, {len(self.names)} objects together)"

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
        model = self.compiled.model
        bodies = self.compiled.model.jnt_bodyid
        lift = jnp.asarray(self.compiled.lift, jnp.float32)
        applied = jnp.where(self.is_present[..., None], 0.0, lift)
        none = jnp.zeros((*self.is_present.shape[:-1], model.nbody, 6))
        return none.at[..., bodies, :3].set(applied)

    @property
    def names(self) -> tuple[str, ...]:
        """The model's objects, in the order of `object_index`; bodies and joints bear them."""
        return self.compiled.names

    def model(self) -> mujoco.MjModel:
        """One compiled model for all scenes: put a scene's `qpos` and `xfrc_applied` into its data."""
        return self.compiled.model

    @property
    def collection(self) -> SceneCollection:
        """The same scenes on the host, to be put into a `mujoco.MjData`."""
        return SceneCollection(self.compiled, np.asarray(self.object_index), np.asarray(self.poses))

    def waiting_scene(self) -> Scene:
        """All K objects as one scene on the bank's support, where they wait, with its cameras."""
        return Scene(
            self.names,
            self.compiled.objects,
            self.compiled.model.qpos0.reshape(-1, 7),
            self.bank.support,
            self.bank.stability,
            self.bank.contact,
            cameras=scene_cameras(self.bank.support),
        )

    def to_mjspec(self) -> mujoco.MjSpec:
        """A specification of all scenes together, to be extended and compiled.

        It holds the support, each of the K objects once (as often as a scene has it at most), and the
        support's cameras. Objects wait far away in the air; `attach_to` and `cg.robot.with_robot` give states
        in which those of a scene stand. Surfaces are drawn, parts collide; time step, solver and contact
        parameters are those of the bank's files. There is no keyframe.
        """
        spec = self.waiting_scene().to_mjspec()
        spec.delete(spec.key(KEYFRAME))
        return spec

    def attach_to(
        self,
        spec: mujoco.MjSpec,
        prefix: str = "clutter/",
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        support: bool = True,
    ) -> BankAttachment:
        """Puts all objects of the bank into a user's own specification, such as that of a robot.

            attached = bank.attach_to(spec)
            world = attached.world(spec.compile())
            state = world.reset(jax.random.key(0))      # qpos, qvel, ctrl, xfrc_applied of the whole model

        Args:
          spec: changed in place; compile it afterwards. Its own options stay as they are; the objects keep
            their contact parameters.
          prefix: before every name of the bank.
          position, quaternion: T_world_scene, metres, wxyz: where the origin of the scenes comes to be.
          support: whether the support comes along.

        Raises:
          ConfigError: as `Scene.attach_to`.
        """
        return attach_bank(self, spec, prefix, position, quaternion, support)

    @with_own_settings
    def reset(self, key: Array) -> BankArrays:
        """A scene that stands, all of them equally likely. Pure: to be compiled and mapped.

        Args:
          key: one PRNG key, consumed.

        Raises:
          ConfigError: `key` is not one key.
        """
        check_key(key, "reset")
        return self.scene(jax.random.randint(key, (), 0, len(self)))

    @with_own_settings
    def scene(self, place: Array) -> BankArrays:
        """The scene at `place`, i32, among those that stand (0 to len - 1); it may be traced.

        Raises:
          ConfigError: there is no such scene. A traced place is moved to the nearest.
        """
        if is_known(place) and not 0 <= int(place) < len(self):
            raise ConfigError(f"scene {place} of those that stand", range_text(0, len(self) - 1))
        return jax.tree.map(lambda leaf: leaf[place], self)


@with_own_settings
def load_bank(
    path: str | Path,
    *,
    hub: str | None = None,
    revision: str | None = None,
    num_scenes: int | None = None,
    seed: int = 0,
) -> BankArrays:
    """Reads a bank for use as the reset of an environment; scenes that failed are left out.

    Args:
      path: a bank's folder, or OWNER/NAME on a hub: pulled when it is first asked for, and kept
        (`pull_bank`, extra `hub`).
      hub, revision: of such a name; see `push_bank`. A revision is pulled each time.
      num_scenes: at most so many of those that stand, in the order of the bank: of a bank of a million, as
        many as memory is wanted for. All of them if not given.
      seed: draws them, each subset equally likely.

    Raises:
      BankError: there is no bank, it or one of its assets is damaged, or no scene in it stands.
      UnsafePathError: it names paths outside of its folder.
      ConfigError: a setting is outside its range.
    """
    if num_scenes is not None:
        check_range("num_scenes", num_scenes, 1, _MOST, 1000)
        check_range("seed", seed, 0, _MOST, 0)
    bank = read_bank(find_bank(path, hub=hub, revision=revision))
    reader = SceneArrayReader(bank)
    wanted = None if num_scenes is None else _draw_numbers(bank, num_scenes, seed)
    parts = list(reader.scenes(wanted))
    _check_any(bank, parts)
    return _arrays(bank, _compile_model(bank, reader), join_scenes(parts))


def stream_bank(
    path: str | Path, batch_size: int = 1024, *, hub: str | None = None, revision: str | None = None
) -> Iterator[BankArrays]:
    """Yields the scenes of a bank that stand batch by batch, in order, all in the same MuJoCo model.

    Only some thousand scenes are in memory at a time. Names are read first, poses then: which objects the
    model needs is known when all names have been seen.

    Args:
      path, hub, revision: as those of `load_bank`.
      batch_size: scenes of a batch; the last one may be smaller.

    Raises:
      BankError, UnsafePathError, ConfigError: as `load_bank`.
    """
    check_range("batch_size", batch_size, 1, _MOST, 1024)
    bank = read_bank(find_bank(path, hub=hub, revision=revision))
    reader = SceneArrayReader(bank)
    num_slots = reader.look()
    _check_any(bank, reader.names)
    compiled = _compile_model(bank, reader)
    rest: list[PlacedAssets] = []
    for part in reader.scenes():
        scenes = join_scenes([*rest, part.pad_slots(num_slots)])
        num_whole = len(scenes.number) // batch_size * batch_size
        for first in range(0, num_whole, batch_size):
            yield _arrays(bank, compiled, scenes.part(first, first + batch_size))
        rest = [scenes.part(num_whole, len(scenes.number))]
    if len(rest[0].number):
        yield _arrays(bank, compiled, rest[0])


def _draw_numbers(bank: Bank, number: int, seed: int) -> np.ndarray:
    """i64: so many of the scenes that stand, sorted."""
    rows = pa.concat_tables(bank.tables(["index", "is_success"]))
    good = rows["index"].to_numpy()[rows["is_success"].to_numpy()]
    drawn = np.random.default_rng(seed).choice(len(good), min(number, len(good)), replace=False)
    return good[np.sort(drawn)]


def _check_any(bank: Bank, found: Sized) -> None:
    if not len(found):
        number = sum(rows.num_rows for rows in bank.tables(["index"]))
        raise BankError(f"{bank.path}: none of its {number} scenes succeeded", hint="more scenes")


def _compile_model(bank: Bank, reader: SceneArrayReader) -> SceneModel:
    """The model of all scenes that a reader has seen."""
    assets = [bank.object(name) for name in reader.names]
    timestep = bank.stability.timestep
    return compile_scenes(assets, reader.most, bank.support, timestep, bank.contact)


@with_own_settings
def _arrays(bank: Bank, compiled: SceneModel, scenes: PlacedAssets) -> BankArrays:
    object_index = compiled.object_index(scenes.asset_index)
    return BankArrays(
        index=jnp.asarray(scenes.number),
        object_index=jnp.asarray(object_index),
        is_present=jnp.asarray(compiled.is_present(object_index)),
        qpos=jnp.asarray(compiled.qpos(object_index, scenes.poses, np.float32)),
        bank=bank,
        compiled=compiled,
    )
