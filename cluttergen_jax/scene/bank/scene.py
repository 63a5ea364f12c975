"""Scenes of a bank: as values that exports, viewers and models take, and many as arrays, from its columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene import Origin, Scene
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.record import record_error
from cluttergen_jax.scene.bank.reference import missing_text, numbers_text
from cluttergen_jax.scene.bank.table import BankRow
from cluttergen_jax.scene.collection import most_of

_LEAVE_OUT = "leaving those out; without numbers, all that stand are taken"
_Config = TypeVar("_Config", bound=StabilityConfig | ContactConfig | PlacementConfig)
_LISTS = ("is_success", "is_placed", "objects")
_COLUMNS = ("index", *_LISTS, "poses")


def good_indices(bank: Bank) -> list[int]:
    """The numbers of the scenes that succeeded, without reading more of them.

    Raises:
      BankError: none did.
    """
    found: list[int] = []
    for rows in bank.tables(["index", "is_success"]):
        found += rows["index"].to_numpy()[rows["is_success"].to_numpy()].tolist()
    if not found:
        raise BankError(
            f"{bank.path}: none of its {bank.num_scenes} scenes succeeded", hint="more scenes"
        )
    return found


def select_rows(bank: Bank, indices: Sequence[int] | None = None) -> list[BankRow]:
    """The rows of these scenes, or of all that succeeded.

    Raises:
      BankError: one of them is not there or failed, or none succeeded.
    """
    if indices is None:
        rows = list(bank.scenes())
        good = [row for row in rows if row.is_success]
        if not good:
            raise BankError(
                f"{bank.path}: none of its {len(rows)} scenes succeeded", hint="more scenes"
            )
        return good
    by_index = bank.rows(indices)
    faults = []
    if len(by_index) < len(set(indices)):
        there = [
            int(index) for rows in bank.tables(["index"]) for index in rows["index"].to_numpy()
        ]
        faults.append(missing_text(indices, there))
    failed = [by_index[i] for i in indices if i in by_index and not by_index[i].is_success]
    if len(failed) == 1:
        faults.append(f"scene {failed[0].index} failed ({failed[0].verdict})")
    elif failed:
        numbers = numbers_text(int(row.index) for row in failed)
        verdicts = ", ".join(sorted({row.verdict for row in failed}))
        faults.append(f"{len(failed)} scenes failed: {numbers} ({verdicts})")
    if faults:
        raise BankError(f"{bank.path}: {'; '.join(faults)}", "scenes that stand", _LEAVE_OUT)
    return [by_index[index] for index in indices]


def read_scenes(bank: Bank, indices: Sequence[int] | None = None) -> Iterator[Scene]:
    """These scenes, or all that succeeded, one by one; each asset is read once.

    Raises:
      BankError: one of them is not there or failed, none succeeded, or the bank's record is damaged.
    """
    rows = select_rows(bank, indices)
    asset_of = lru_cache(maxsize=None)(bank.object)
    for row in rows:
        yield _scene(bank, row, [asset_of(base_name(name)) for name in row.objects])


def _scene(bank: Bank, row: BankRow, objects: Sequence[ObjectAsset]) -> Scene:
    recipe = bank.recipe
    checkpoint = recipe.get("checkpoint")
    stability, contact = rules_of(bank)
    return Scene(
        names=row.objects,
        objects=tuple(objects),
        poses=row.poses,
        support=bank.support,
        stability=stability,
        contact=contact,
        origin=Origin(
            bank=bank.path.resolve().name,
            index=row.index,
            pool=public_name(recipe.get("pool", "")),
            method=recipe.get("method", ""),
            # The name alone: a path would tell where its owner keeps files.
            checkpoint=None if checkpoint is None else Path(checkpoint).name,
            seed=recipe.get("seed"),
            verdict=row.verdict,
            drift=row.drift,
            is_success=bool(row.is_success),
            versions=recipe.get("versions", {}),
        ),
    )


def config_of(kind: type[_Config], values: Mapping[str, Any], path: Path) -> _Config:
    """A config as a bank's recipe has it (BankError: the recipe is damaged)."""
    known = {field.name for field in fields(kind)}
    try:
        plain: dict[str, Any] = {
            key: tuple(v) if isinstance(v, list) else v for key, v in values.items() if key in known
        }
        return kind(**plain)
    except (TypeError, AttributeError, ConfigError) as error:
        raise record_error(path, error) from error


def rules_of(bank: Bank) -> tuple[StabilityConfig, ContactConfig]:
    """With which a bank's scenes were made (BankError: the recipe is damaged)."""
    recipe = bank.record.get("recipe", {})
    stability = config_of(StabilityConfig, recipe.get("stability", {}), bank.path)
    contact = config_of(ContactConfig, recipe.get("contact", {}), bank.path)
    return stability, contact


def region_of(bank: Bank) -> Rectangle:
    """The region that a bank's recipe asks for (BankError: the recipe is damaged)."""
    try:
        asked = bank.recipe["region"]
        return Rectangle(tuple(asked["center"]), tuple(asked["half_extents"]), asked["yaw"])
    except (KeyError, TypeError, ValueError) as error:
        raise record_error(bank.path, error) from error


class SceneArrays(NamedTuple):
    """S scenes of N slots.

    Attributes:
      number: i32[S], their numbers in the bank.
      asset_index: i32[S, N], the asset in each slot, in the order of placement; -1 is padding.
      poses: f32[S, N, 7], world frame, metres, wxyz.
    """

    number: np.ndarray
    asset_index: np.ndarray
    poses: np.ndarray

    def part(self, first: int, last: int) -> SceneArrays:
        """Scenes `first` to `last` - 1 of these."""
        return SceneArrays(*(array[first:last] for array in self))

    def pad_slots(self, num_slots: int) -> SceneArrays:
        """The same with at least so many slots."""
        more = ((0, 0), (0, max(num_slots - self.asset_index.shape[1], 0)))
        asset_index = np.pad(self.asset_index, more, constant_values=-1)
        return SceneArrays(self.number, asset_index, np.pad(self.poses, (*more, (0, 0))))


class _Slots(NamedTuple):
    """What is placed in S scenes of N slots, P objects in all, of L that are listed.

    Attributes:
      is_placed: bool[L]; scene, slot: i[P], where each is.
      asset_index: see `SceneArrays`.
    """

    is_placed: np.ndarray
    scene: np.ndarray
    slot: np.ndarray
    asset_index: np.ndarray


class SceneArrayReader:
    """Reads the scenes of a bank that stand, some thousand at a time.

    Attributes:
      names: assets that were read so far, by their number, in the order in which they came.
      most: how often the scene that has most of it has each.
    """

    def __init__(self, bank: Bank) -> None:
        self._bank = bank
        self.names: dict[str, int] = {}
        self.most = np.zeros(0, int)

    def scenes(self, wanted: np.ndarray | None = None) -> Iterator[SceneArrays]:
        """Those of these numbers (sorted) that stand; all that stand if None.

        Raises:
          BankError: the bank holds no scenes, or a block is damaged.
        """
        for rows in self._bank.tables(_COLUMNS, wanted):
            rows = rows.filter(rows["is_success"])
            if wanted is not None:
                rows = rows.filter(pa.array(np.isin(rows["index"].to_numpy(), wanted)))
            if rows.num_rows:
                yield self._arrays(rows)

    def look(self) -> int:
        """Fills `names` and `most` without reading a pose; the number of slots of the scene that has most.

        Raises:
          BankError: likewise.
        """
        num_slots = 0
        for rows in self._bank.tables(_LISTS):
            slots = self._slots(rows.filter(rows["is_success"]))
            num_slots = max(num_slots, slots.asset_index.shape[1])
        return num_slots

    def _arrays(self, rows: pa.Table) -> SceneArrays:
        slots = self._slots(rows)
        poses = rows["poses"].combine_chunks()
        values = np.array(pc.list_flatten(pc.list_flatten(poses)), np.float32).reshape(-1, 7)
        pad_slots = np.zeros((*slots.asset_index.shape, 7), np.float32)
        pad_slots[slots.scene, slots.slot] = values[slots.is_placed]
        return SceneArrays(np.array(rows["index"], np.int32), slots.asset_index, pad_slots)

    def _slots(self, rows: pa.Table) -> _Slots:
        columns = {name: rows[name].combine_chunks() for name in ("is_placed", "objects")}
        is_placed = np.array(pc.list_flatten(columns["is_placed"]), bool)
        scene = np.array(pc.list_parent_indices(columns["is_placed"]))[is_placed]
        # The slot of each among the placed ones of its scene.
        slot = np.arange(len(scene)) - np.searchsorted(scene, scene)
        asset_index = np.full((rows.num_rows, int(slot.max(initial=-1)) + 1), -1, np.int32)
        asset_index[scene, slot] = self._numbers(
            pc.list_flatten(columns["objects"]).filter(is_placed)
        )
        most = most_of(asset_index, len(self.names))
        most[: len(self.most)] = np.maximum(most[: len(self.most)], self.most)
        self.most = most
        return _Slots(is_placed, scene, slot, asset_index)

    def _numbers(self, objects: pa.Array) -> np.ndarray:
        """i32: the assets behind names in a world, numbered as they come."""
        encoded = objects.dictionary_encode()
        for name in map(base_name, encoded.dictionary.to_pylist()):
            self.names.setdefault(name, len(self.names))
        known = [self.names[base_name(name)] for name in encoded.dictionary.to_pylist()]
        return np.array(known, np.int32)[np.array(encoded.indices)]


def join_scenes(parts: Sequence[SceneArrays]) -> SceneArrays:
    """All the scenes of some parts, at least one, padded to the most slots."""
    num_slots = max(part.asset_index.shape[1] for part in parts)
    pad_slots = [part.pad_slots(num_slots) for part in parts]
    return SceneArrays(*(np.concatenate(arrays) for arrays in zip(*pad_slots, strict=True)))
