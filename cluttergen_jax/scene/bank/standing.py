"""Scenes of a bank that stand as arrays, from its columns: no Python object for a scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.collection import most_of

_LISTS = ("is_success", "is_placed", "objects")
_COLUMNS = ("index", *_LISTS, "poses")


class StandingScenes(NamedTuple):
    """S scenes of N slots.

    Attributes:
      number: i32[S], their numbers in the bank.
      asset_index: i32[S, N], the asset in each slot, in the order of placement; -1 is padding.
      poses: f32[S, N, 7], world frame, metres, wxyz.
    """

    number: np.ndarray
    asset_index: np.ndarray
    poses: np.ndarray

    def part(self, first: int, last: int) -> StandingScenes:
        """Scenes `first` to `last` - 1 of these."""
        return StandingScenes(*(array[first:last] for array in self))

    def padded(self, num_slots: int) -> StandingScenes:
        """The same with at least so many slots."""
        more = ((0, 0), (0, max(num_slots - self.asset_index.shape[1], 0)))
        asset_index = np.pad(self.asset_index, more, constant_values=-1)
        return StandingScenes(self.number, asset_index, np.pad(self.poses, (*more, (0, 0))))


class _Slots(NamedTuple):
    """What is placed in S scenes of N slots, P objects in all, of L that are listed.

    Attributes:
      is_placed: bool[L]; scene, slot: i[P], where each is.
      asset_index: see `StandingScenes`.
    """

    is_placed: np.ndarray
    scene: np.ndarray
    slot: np.ndarray
    asset_index: np.ndarray


class StandingReader:
    """Reads the scenes of a bank that stand, some thousand at a time.

    Attributes:
      names: assets that were read so far, by their number, in the order in which they came.
      most: how often the scene that has most of it has each.
    """

    def __init__(self, bank: Bank) -> None:
        self._bank = bank
        self.names: dict[str, int] = {}
        self.most = np.zeros(0, int)

    def scenes(self, wanted: np.ndarray | None = None) -> Iterator[StandingScenes]:
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

    def _arrays(self, rows: pa.Table) -> StandingScenes:
        slots = self._slots(rows)
        poses = rows["poses"].combine_chunks()
        values = np.array(pc.list_flatten(pc.list_flatten(poses)), np.float32).reshape(-1, 7)
        padded = np.zeros((*slots.asset_index.shape, 7), np.float32)
        padded[slots.scene, slots.slot] = values[slots.is_placed]
        return StandingScenes(np.array(rows["index"], np.int32), slots.asset_index, padded)

    def _slots(self, rows: pa.Table) -> _Slots:
        columns = {name: rows[name].combine_chunks() for name in ("is_placed", "objects")}
        is_placed = np.array(pc.list_flatten(columns["is_placed"]), bool)
        scene = np.array(pc.list_parent_indices(columns["is_placed"]))[is_placed]
        # The slot of each among the placed ones of its scene.
        slot = np.arange(len(scene)) - np.searchsorted(scene, scene)
        asset_index = np.full((rows.num_rows, int(slot.max(initial=-1)) + 1), -1, np.int32)
        asset_index[scene, slot] = self._numbers(pc.list_flatten(columns["objects"]).filter(is_placed))
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


def joined(parts: Sequence[StandingScenes]) -> StandingScenes:
    """All the scenes of some parts, at least one, padded to the most slots."""
    num_slots = max(part.asset_index.shape[1] for part in parts)
    padded = [part.padded(num_slots) for part in parts]
    return StandingScenes(*(np.concatenate(arrays) for arrays in zip(*padded, strict=True)))
