"""A bank on disk: `bank.json`, `scenes-*.parquet`, `assets/`, and a file per scene if wanted.

    bank.json               how it was made; what makes another run the same bank
    scenes-000000.parquet   block 0: scenes 0 to 255, a row each, failures included
    assets/objects/NAME/    each object once; assets/support/ the table
    scenes/000000.xml .png  successful scenes as MJCF, meshes by relative path, and their pictures

A block is written as a whole or not at all, so an interrupted bank is continued where it stopped.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.assets.part_files import write_parts
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import read_support, write_support
from cluttergen_jax.errors import BankError

FORMAT = 1
_INDEX = "bank.json"


@dataclass(frozen=True, eq=False)
class SceneRecord:
    """One scene of a bank.

    Attributes:
      index: its number in the bank.
      objects: names of the placed objects in the order of placement.
      poses: f32[N, 7], their world poses, metres, wxyz.
      is_success: every slot is filled and the finished scene stands.
      verdict: the last word on it, in the words of `types.Verdict`.
    """

    index: int
    objects: tuple[str, ...]
    poses: np.ndarray
    is_success: bool
    verdict: str


@dataclass(frozen=True, eq=False)
class Bank:
    """A bank that is read. `record` is what `bank.json` holds."""

    path: Path
    record: dict[str, Any]

    @property
    def num_scenes(self) -> int:
        """How many scenes the bank was asked for."""
        return int(self.record["num_scenes"])

    @cached_property
    def table(self) -> pa.Table:
        """All rows that are there, in order."""
        paths = [block_path(self.path, block) for block in _blocks(self.path)]
        if not paths:
            raise BankError(f"{self.path} holds no scenes yet", hint="running `cluttergen generate` again")
        try:
            return pa.concat_tables([pq.read_table(path) for path in paths])
        except (pa.ArrowException, OSError) as error:
            raise BankError(
                f"{self.path}: a block of scenes is damaged ({error})",
                hint="deleting that file and running the same `cluttergen generate` again",
            ) from error

    def scenes(self) -> Iterator[SceneRecord]:
        """Every scene, failures included."""
        for row in self.table.to_pylist():
            placed = np.array(row["is_placed"], bool)
            yield SceneRecord(
                index=row["index"],
                objects=tuple(np.array(row["objects"])[placed]),
                poses=np.array(row["poses"], np.float32).reshape(-1, 7)[placed],
                is_success=row["is_success"],
                verdict=row["verdict"],
            )

    def object(self, name: str) -> ObjectAsset:
        """The asset called `name`, from the bank's own copy."""
        return read_object(self.path / "assets" / "objects" / name)

    @cached_property
    def support(self) -> SupportAsset:
        """The table, from the bank's own copy."""
        return read_support(self.path / "assets" / "support")


def block_path(path: Path, block: int) -> Path:
    """Where block number `block` is stored."""
    return path / f"scenes-{block:06d}.parquet"


def _blocks(path: Path) -> list[int]:
    return sorted(int(each.stem.split("-")[1]) for each in path.glob("scenes-*.parquet"))


def read_bank(path: str | Path) -> Bank:
    """Opens a bank.

    Raises:
      BankError: there is none, or `bank.json` is damaged or of another format.
    """
    index = Path(path) / _INDEX
    try:
        record = json.loads(index.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise BankError(
            f"{path} is not a bank: it has no {_INDEX}", "a folder that `generate` made"
        ) from error
    except (OSError, ValueError) as error:
        raise BankError(f"{index} cannot be read ({error})") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise BankError(f"{index} is not a bank of format {FORMAT}")
    return Bank(Path(path), record)


class BankWriter:
    """Creates a bank, or continues one that was made with the same settings.

    Args:
      path: the bank's folder.
      recipe: JSON values that decide what the scenes are: two banks of equal recipes hold equal scenes.
      num_scenes: how many; a bank may be continued to a larger number.
      objects, support: stored once.
      overwrite: begin anew if the folder holds another bank.

    Raises:
      BankError: the folder holds something else, or a bank of another recipe.
    """

    def __init__(
        self,
        path: str | Path,
        recipe: dict[str, Any],
        num_scenes: int,
        objects: dict[str, ObjectAsset],
        support: SupportAsset,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        recipe = json.loads(json.dumps(recipe))
        if overwrite and (self.path / _INDEX).exists():
            _remove_bank(self.path)
        else:
            self._check_place(recipe)
        self.path.mkdir(parents=True, exist_ok=True)
        for name, asset in objects.items():
            folder = self.path / "assets" / "objects" / name
            if not (folder / "object.json").exists():
                write_parts(folder, asset)
                write_object(folder, asset)
        if not (self.path / "assets" / "support").exists():
            write_support(self.path / "assets" / "support", support)
        kept = max(num_scenes, self._stored_number())
        record = {"format": FORMAT, "num_scenes": kept, "recipe": recipe}
        write_atomically(self.path / _INDEX, (json.dumps(record, indent=1) + "\n").encode())

    def _stored_number(self) -> int:
        return read_bank(self.path).num_scenes if (self.path / _INDEX).exists() else 0

    def _check_place(self, recipe: dict[str, Any]) -> None:
        if (self.path / _INDEX).exists():
            theirs = read_bank(self.path).record["recipe"]
            changed = sorted(k for k in {*recipe, *theirs} if recipe.get(k) != theirs.get(k))
            if changed:
                raise BankError(
                    f"{self.path} holds a bank made with another {', '.join(changed)}",
                    "the same settings, which continue it",
                    "another --out, or --overwrite to begin anew",
                )
        elif self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise BankError(f"{self.path} exists and is not a bank", "a new or empty folder", "another --out")

    def has_block(self, block: int, num_rows: int) -> bool:
        """Whether block number `block` is there with at least `num_rows` rows."""
        path = block_path(self.path, block)
        try:
            return path.exists() and pq.read_metadata(path).num_rows >= num_rows
        except (pa.ArrowException, OSError):
            return False

    def write_block(self, block: int, table: pa.Table) -> None:
        """Stores the rows of a block as a whole."""
        path = block_path(self.path, block)
        fresh = path.with_suffix(".partial")
        pq.write_table(table, fresh)
        os.replace(fresh, path)


def write_atomically(path: Path, data: bytes) -> None:
    """Writes a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.partial")
    fresh.write_bytes(data)
    os.replace(fresh, path)


def _remove_bank(path: Path) -> None:
    """Removes what a bank consists of, and nothing else that may lie in the folder."""
    for block in _blocks(path):
        block_path(path, block).unlink()
    for folder in ("assets", "scenes"):
        shutil.rmtree(path / folder, ignore_errors=True)
    (path / "overview.png").unlink(missing_ok=True)
    (path / _INDEX).unlink()


def names_of(objects: Sequence[ObjectAsset]) -> dict[str, ObjectAsset]:
    """Assets by their own name: an asset that stands in a world more than once is stored once."""
    return {asset.name: asset for asset in objects}
