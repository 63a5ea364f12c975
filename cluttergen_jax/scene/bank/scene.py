"""Scenes of a bank: named in arguments and messages, as values that models take, and many as arrays."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.problem import Standing
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.record import INDEX, record_error
from cluttergen_jax.scene.bank.remote import bank_folder, is_url
from cluttergen_jax.scene.bank.table import BankRow, rows_of
from cluttergen_jax.scene.collection import most_of

REFERENCES = "BANK, BANK:INDEX or BANK/scenes/NUMBER.xml"
_SAID = 8


def parse_reference(text: str) -> tuple[Path, int | None] | None:
    """The bank's folder and the scene's number in it, None for all of them.

    Whatever is no file is taken for a bank's folder, unread; of a URL it is the mirror, which is fetched.
    None for a file that is no scene of a bank.

    Args:
      text: one of `REFERENCES`, where BANK may be a URL.

    Raises:
      BankError: a URL cannot be reached.
    """
    if is_url(text):
        head, _, number = text.rpartition(":")
        # What follows a question mark may end with a port.
        has_number = number.isdecimal() and "?" not in text
        return bank_folder(head if has_number else text), int(number) if has_number else None
    path = Path(text)
    if path.is_file():
        bank = path.parent.parent
        is_scene = (
            path.parent.name == "scenes" and path.stem.isdecimal() and (bank / INDEX).is_file()
        )
        return (bank, int(path.stem)) if is_scene else None
    head, _, number = text.rpartition(":")
    if head and number.isdecimal() and not path.exists():
        return Path(head), int(number)
    return path, None


def numbers_text(numbers: Iterable[int]) -> str:
    """Numbers of scenes as ranges such as `0-3, 7, 9-12`; of many ranges the first eight."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and runs[-1][1] == number - 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    ranges = [str(first) if first == last else f"{first}-{last}" for first, last in runs[:_SAID]]
    return ", ".join([*ranges, *(["..."] if len(runs) > _SAID else [])])


def missing_text(asked: Collection[int], held: Collection[int]) -> str:
    """What to say of scenes that were asked for and are not held, in one sentence; empty if all are there.

    Args:
      asked: numbers, each once.
      held: at least one.
    """
    held = held if isinstance(held, range) else frozenset(held)
    missing = [number for number in asked if number not in held]
    if not missing:
        return ""
    holds = f"{held[0]}-{held[-1]}" if isinstance(held, range) else numbers_text(held)
    if len(missing) == 1:
        return f"no scene {missing[0]} in it, which holds {holds}"
    most = f"{len(missing)} of the {len(asked)} scenes asked for"
    return f"{most} ({numbers_text(missing)}) are not in it, which holds {holds}"


def read_start(text: str | None) -> Standing | None:
    """The objects of one scene of a bank, from the bank's own copies, and where they stand.

    Args:
      text: which one, as `parse_reference` reads it; None for nothing.

    Raises:
      ConfigError: the text names no single scene.
      BankError: there is no such bank or scene, or the scene failed.
    """
    if text is None:
        return None
    path, number = parse_reference(text) or (None, None)
    if path is None or number is None:
        raise ConfigError(f"start {text!r}", "BANK:INDEX, such as out:3")
    bank = read_bank(path)
    scene = bank.rows([number]).get(number)
    if scene is None or not scene.is_success:
        state = "no such scene" if scene is None else f"a scene that failed: {scene.verdict}"
        raise BankError(f"start {text}: {state}", "a scene that stands")
    return [bank.object(base_name(name)) for name in scene.objects], scene.poses


_LEAVE_OUT = "leaving those out; without numbers, all that stand are taken"
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
        raise _none_succeeded(bank)
    return found


def num_good(bank: Bank) -> int:
    """How many scenes succeeded (BankError: none did)."""
    number = sum(int(np.sum(rows["is_success"])) for rows in bank.tables(["is_success"]))
    if not number:
        raise _none_succeeded(bank)
    return number


def _none_succeeded(bank: Bank) -> BankError:
    return BankError(
        f"{bank.path}: none of its {bank.num_scenes} scenes succeeded", hint="more scenes"
    )


def select_rows(bank: Bank, indices: Sequence[int] | None = None) -> Iterator[BankRow]:
    """The rows of these scenes, in this order, or of all that succeeded; read some at a time.

    Raises:
      BankError: one of them is not there or failed, before the first row; or none succeeded.
    """
    if indices is None:
        yield from _good_rows(bank)
        return
    _check_selected(bank, indices)
    for first in range(0, len(indices), BLOCK_SIZE):
        some = indices[first : first + BLOCK_SIZE]
        rows = bank.rows(some)
        for index in some:
            yield rows[index]


def _good_rows(bank: Bank) -> Iterator[BankRow]:
    num_good = 0
    for rows in bank.tables():
        good = rows.filter(rows["is_success"])
        num_good += good.num_rows
        yield from rows_of(good)
    if not num_good:
        raise _none_succeeded(bank)


def _check_selected(bank: Bank, indices: Sequence[int]) -> None:
    """Refuses scenes that are not there or failed (BankError)."""
    wanted = np.unique(np.array(indices, np.int64))
    num_found = 0
    failed: dict[int, str] = {}
    for rows in bank.tables(["index", "is_success", "verdict"], wanted):
        found = rows.filter(np.isin(rows["index"].to_numpy(), wanted))
        num_found += found.num_rows
        bad = found.filter(pc.invert(found["is_success"]))
        failed |= zip(bad["index"].to_pylist(), bad["verdict"].to_pylist(), strict=True)
    faults = []
    if num_found < len(wanted):
        there = [
            int(index) for rows in bank.tables(["index"]) for index in rows["index"].to_numpy()
        ]
        faults.append(missing_text(indices, there))
    if len(failed) == 1:
        ((index, verdict),) = failed.items()
        faults.append(f"scene {index} failed ({verdict})")
    elif failed:
        verdicts = ", ".join(sorted(set(failed.values())))
        faults.append(f"{len(failed)} scenes failed: {numbers_text(failed)} ({verdicts})")
    if faults:
        raise BankError(f"{bank.path}: {'; '.join(faults)}", "scenes that stand", _LEAVE_OUT)


def read_scenes(bank: Bank, indices: Sequence[int] | None = None) -> Iterator[Scene]:
    """These scenes, or all that succeeded, one by one; each asset is read once, and rows some at a time.

    Raises:
      BankError: one of them is not there or failed, none succeeded, or the bank's record is damaged.
    """
    asset_of = lru_cache(maxsize=None)(bank.object)
    for row in select_rows(bank, indices):
        yield bank.scene_of(row, asset_of)


def region_of(bank: Bank) -> Rectangle:
    """The region that a bank's recipe asks for (BankError: the recipe is damaged)."""
    try:
        asked = bank.recipe["region"]
        return Rectangle(tuple(asked["center"]), tuple(asked["half_extents"]), asked["yaw"])
    except (KeyError, TypeError, ValueError) as error:
        raise record_error(bank.path, error) from error


class PlacedAssets(NamedTuple):
    """The assets of S scenes of N slots, and where they are.

    Attributes:
      number: i32[S], their numbers in the bank.
      asset_index: i32[S, N], the asset in each slot, in the order of placement; -1 is padding.
      poses: f32[S, N, 7], world frame, metres, wxyz.
    """

    number: np.ndarray
    asset_index: np.ndarray
    poses: np.ndarray

    def part(self, first: int, last: int) -> PlacedAssets:
        """Scenes `first` to `last` - 1 of these."""
        return PlacedAssets(*(array[first:last] for array in self))

    def pad_slots(self, num_slots: int) -> PlacedAssets:
        """The same with at least so many slots."""
        more = ((0, 0), (0, max(num_slots - self.asset_index.shape[1], 0)))
        asset_index = np.pad(self.asset_index, more, constant_values=-1)
        return PlacedAssets(self.number, asset_index, np.pad(self.poses, (*more, (0, 0))))


class _Slots(NamedTuple):
    """What is placed in S scenes of N slots, P objects in all, of L that are listed.

    Attributes:
      is_placed: bool[L]; scene, slot: i[P], where each is.
      asset_index: see `PlacedAssets`.
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

    def scenes(self, wanted: np.ndarray | None = None) -> Iterator[PlacedAssets]:
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

    def _arrays(self, rows: pa.Table) -> PlacedAssets:
        slots = self._slots(rows)
        poses = rows["poses"].combine_chunks()
        values = np.array(pc.list_flatten(pc.list_flatten(poses)), np.float32).reshape(-1, 7)
        pad_slots = np.zeros((*slots.asset_index.shape, 7), np.float32)
        pad_slots[slots.scene, slots.slot] = values[slots.is_placed]
        return PlacedAssets(np.array(rows["index"], np.int32), slots.asset_index, pad_slots)

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


def join_scenes(parts: Sequence[PlacedAssets]) -> PlacedAssets:
    """All the scenes of some parts, at least one, padded to the most slots."""
    num_slots = max(part.asset_index.shape[1] for part in parts)
    pad_slots = [part.pad_slots(num_slots) for part in parts]
    return PlacedAssets(*(np.concatenate(arrays) for arrays in zip(*pad_slots, strict=True)))
