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

_COLUMNS = ("index", "is_success", "is_placed", "objects", "poses")


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
        for rows in self._bank.tables(_COLUMNS):
            rows = rows.filter(rows["is_success"])
            if wanted is not None:
                rows = rows.filter(pa.array(np.isin(rows["index"].to_numpy(), wanted)))
            if rows.num_rows:
                yield self._arrays(rows)

    def _arrays(self, rows: pa.Table) -> StandingScenes:
        columns = {name: rows[name].combine_chunks() for name in ("is_placed", "objects", "poses")}
        is_placed = np.array(pc.list_flatten(columns["is_placed"]))
        scene = np.array(pc.list_parent_indices(columns["is_placed"]))[is_placed]
        poses = np.array(pc.list_flatten(pc.list_flatten(columns["poses"])), np.float32).reshape(-1, 7)
        # The slot of each among the placed ones of its scene.
        slot = np.arange(len(scene)) - np.searchsorted(scene, scene)
        shape = (rows.num_rows, int(slot.max(initial=-1)) + 1)
        found = StandingScenes(
            np.array(rows["index"], np.int32), np.full(shape, -1, np.int32), np.zeros((*shape, 7), np.float32)
        )
        found.asset_index[scene, slot] = self._numbers(pc.list_flatten(columns["objects"]).filter(is_placed))
        found.poses[scene, slot] = poses[is_placed]
        most = most_of(found.asset_index, len(self.names))
        most[: len(self.most)] = np.maximum(most[: len(self.most)], self.most)
        self.most = most
        return found

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
