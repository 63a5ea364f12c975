"""A bank of some scenes of another: their rows, files and objects as they are, numbered anew from 0.

Its recipe is the other's with `cut`: of which bank it was made, and by which numbers the seed makes its
scenes (`number_of_seed`), in order. So it is no bank that `generate` continues.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import inside, read_regular, write_atomically, writing
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.progress import track
from cluttergen_jax.scene.bank.bank import Bank, read_bank
from cluttergen_jax.scene.bank.blocks import StoredBlocks
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.record import cut_runs
from cluttergen_jax.scene.bank.remote import check_is_here, is_url
from cluttergen_jax.scene.bank.scene import missing_text
from cluttergen_jax.scene.bank.writer import BankWriter, Objects
from cluttergen_jax.schema import digest_of

_FILES = ("xml", "png")


def cut_bank(bank: Bank, numbers: Sequence[int] | None, out: str | Path, overwrite: bool) -> Bank:
    """Writes some scenes of a bank as a bank of their own; an interrupted cut goes on.

    Args:
      numbers: of scenes that are there, failures or not, each once; all that are there if None.
      overwrite: begin anew if `out` holds another bank.

    Raises:
      BankError: a scene is not there or damaged, its file was changed, or `out` holds something else.
      ConfigError: no numbers, one twice, or `out` is the bank itself.
    """
    check_is_here(bank.path)
    there = np.concatenate([rows["index"].to_numpy() for rows in bank.tables(["index"])])
    wanted = there if numbers is None else np.array(list(numbers), np.int64)
    _check_numbers(bank, wanted, there)
    if not is_url(out) and Path(out).resolve() == bank.path.resolve():
        raise ConfigError(f"{out}, which is the bank that is cut", "another folder")
    of_seed = _runs(number_of_seed(bank.recipe, int(number)) for number in wanted)
    cut = {"bank": bank.recipe.get("cut", {}).get("bank", bank.path.resolve().name)}
    recipe = {**bank.recipe, "cut": {**cut, "scenes": of_seed}}
    asset_of = lru_cache(maxsize=None)(bank.object)
    named = bank.assets["objects"] or {base_name(name) for name in bank.object_names}
    # Where blocks drew their objects, those that the scenes have.
    objects: Objects = asset_of
    if not bank.recipe.get("shelf"):
        objects = {name: asset_of(name) for name in sorted(named)}
    blocks = range(0, len(wanted), BLOCK_SIZE)
    stored = bank.blocks()
    with BankWriter(
        out,
        recipe,
        len(wanted),
        objects,
        bank.support,
        overwrite,
        known_bits=bank.record.get("bits", ()),
        open_support=bank.open_support if "support_open" in bank.assets else None,
    ) as writer:
        for first in track(blocks, "cutting", len(blocks), "block"):
            some = wanted[first : first + BLOCK_SIZE].tolist()
            block = first // BLOCK_SIZE
            if not writer.has_block(block, len(some)):
                writer.write_block(block, _rows(stored, some, first))
        writer.finish()
        with writing(writer.path):
            writer.keep_digests(_copy_files(bank, wanted, writer.path))
            write_card(read_bank(writer.path))
    return read_bank(writer.path)


def number_of_seed(recipe: Mapping[str, Any], number: int) -> int:
    """The number with which the recipe's seed makes a scene: its own, but in a bank that was cut.

    Raises:
      BankError: the recipe's `cut` does not have the scene.
    """
    if "cut" not in recipe:
        return number
    left = number
    for first, last in cut_runs(recipe):
        if left <= last - first:
            return first + left
        left -= last - first + 1
    raise BankError(f"scene {number} of a bank that was cut", f"fewer than {number - left + 1}")


def _check_numbers(bank: Bank, numbers: np.ndarray, there: np.ndarray) -> None:
    if not len(numbers):
        raise ConfigError("a cut of no scenes", "one or more", "scenes='0-99'")
    if len(np.unique(numbers)) < len(numbers):
        raise ConfigError("a cut with a scene twice", "each once")
    if not np.isin(numbers, there).all():
        missing = missing_text(numbers.tolist(), there.tolist())
        raise BankError(f"{bank.path}: {missing}", "scenes that are there", "leaving those out")


def _runs(numbers: Iterator[int]) -> list[list[int]]:
    """First and last of numbers that follow each other, in the order that they come in."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and runs[-1][1] == number - 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return runs


def _rows(stored: StoredBlocks, numbers: Sequence[int], first: int) -> pa.Table:
    """The rows of these scenes, in order, numbered from `first`."""
    found = []
    for block, some in groupby(numbers, lambda number: number // BLOCK_SIZE):
        rows = stored.read_block(block)
        found.append(rows.take(pa.array([number % BLOCK_SIZE for number in some])))
    table = pa.concat_tables([each.replace_schema_metadata(None) for each in found])
    index = pa.array(np.arange(first, first + len(numbers)), pa.int32())
    return table.set_column(table.schema.get_field_index("index"), "index", index)


def _copy_files(bank: Bank, numbers: np.ndarray, out: Path) -> dict[str, str]:
    """Copies the files of scenes, as far as the bank has them; digests of the models, by path."""
    digests = {}
    known = bank.files or {}
    there = {each.name for each in (bank.path / "scenes").glob("*")}
    for place, number in enumerate(track(numbers, "copying", len(numbers), "scene")):
        for ending in _FILES:
            file = f"{number:06d}.{ending}"
            name = f"scenes/{file}"
            if file not in there or not inside(bank.path, name).is_file():
                continue
            data = read_regular(inside(bank.path, name))
            digest = digest_of(data)
            if known.get(name, digest) != digest:
                hint = "the same `cluttergen generate` again, which writes it anew"
                raise BankError(f"{bank.path / name} is not what was written", hint=hint)
            own = f"scenes/{place:06d}.{ending}"
            write_atomically(inside(out, own), data)
            if ending == "xml":
                digests[own] = digest
    return digests
