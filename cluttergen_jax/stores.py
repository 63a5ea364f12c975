"""What interrupted commands continue: blocks of files in a folder, and rows in a file, each of one recipe.

A folder of blocks has a record of how they are made; a file of rows has it as its first line. Another recipe
is refused (`kept_folder.check_recipe`). Banks, whose reader travels alone, have blocks of their own.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.kept_folder import KeptFolder, check_recipe, hold
from cluttergen_jax.progress import Progress
from cluttergen_jax.schema import (
    Record,
    SchemaError,
    checked_record,
    convert,
    digest_of,
    parse_json,
    record_bytes,
    with_checksum,
)
from cluttergen_jax.statistics import finite

FORMAT = 1
Row = TypeVar("Row")
GRASPS = "grasps"
"""Of a recipe of rows: the digest of each object's grasps. Objects are added as episodes have them."""
_ROWS = "rows"
"""In the first line: the checksum of the others."""


@dataclass(frozen=True)
class BlockStore:
    """A kind of folder whose blocks are written as a whole or not at all, and whose record says how.

    Attributes:
      content: what blocks hold, in the plural.
      index: the file's name of the record; kind: what the record calls itself.
      command: that makes it, for messages.
      begun: beginnings of names that may lie there before the record does.
      argument: of the function, for messages.
    """

    content: str
    index: str
    kind: str
    command: str
    begun: tuple[str, ...] = ()
    argument: str = "out"

    def folder(self, path: Path) -> KeptFolder:
        """A folder of this kind, which may not exist yet."""
        return KeptFolder(
            path,
            is_whole=lambda folder: (folder / self.index).is_file(),
            refusal=f"{{path}} holds {{other}}, no {self.content}",
            is_begun=lambda each: each.name.startswith(self.begun),
        )

    def hold(self, path: Path) -> AbstractContextManager[None]:
        """Holds a folder in the block, in which the same thread may lock it again; it is made if need be.

        Raises:
          BankError: it holds something else, or another process writes there.
        """
        return hold(self.folder(path).lock())

    def read_record(self, path: Path) -> Record:
        """The record of a folder, without what kind it is of.

        Raises:
          BankError: there is none, it is damaged, or of another kind.
        """
        file = path / self.index
        try:
            record = checked_record(file.read_bytes())
            if (record.pop("kind", None), record.pop("format", None)) != (self.kind, FORMAT):
                raise SchemaError(f"not the record of {self.kind} of format {FORMAT}")
        except (FileNotFoundError, NotADirectoryError) as error:
            raise BankError(
                f"{path} holds no {self.content}: it has no {self.index}",
                f"a folder that `{self.command}` made",
            ) from error
        except (OSError, SchemaError) as error:
            hint = f"a fresh copy of the folder, or `{self.command}` into another"
            raise BankError(f"{file} cannot be read ({error})", hint=hint) from error
        return record

    def write_record(self, path: Path, record: Mapping[str, Any]) -> None:
        """Stores it."""
        whole = {"format": FORMAT, "kind": self.kind, **record}
        write_atomically(path / self.index, record_bytes(whole), is_durable=True)

    def begin(self, path: Path, recipe: Mapping[str, Any]) -> Record:
        """What is known of a folder; empty where it is begun now, and then its record says how it is made.

        Raises:
          BankError: it was made by another recipe, or its record is damaged.
        """
        if not (path / self.index).exists():
            self.write_record(path, {"recipe": recipe})
            return {}
        known = self.read_record(path)
        theirs = known.get("recipe", {})
        check_recipe(path, f"{self.content} made", recipe, theirs, f"another `{self.argument}`")
        return known


class RowStore(Generic[Row]):
    """A file in which an interrupted command finds the rows that it has made.

    Args:
      path: the file; None keeps nothing.
      recipe: what makes rows comparable; those of another recipe are not taken up again.
      kind: the data class of a row; numbers that are not finite are kept as null.
      command: that writes such files, for messages.
      added: names of the recipe that published rows do not have. Such rows are shown, not continued: with
        what they were made is not known.
    """

    def __init__(
        self,
        path: Path | None,
        recipe: Mapping[str, object],
        kind: type[Row],
        command: str,
        added: Sequence[str] = (),
    ) -> None:
        self._path = path
        self._kind = kind
        self._command = command
        self._added = added
        self._recipe = json.loads(json.dumps(recipe))

    def read(self, number: int) -> list[Row]:
        """The rows that are kept, `number` at most.

        Raises:
          BankError: they are damaged or of another recipe, or there are fewer and they cannot be continued.
        """
        if self._path is None or not self._path.is_file():
            return []
        try:
            first, _, text = self._path.read_bytes().partition(b"\n")
            known = checked_record(first)
            unstated = {*self._recipe, GRASPS}.difference(known)
            grasps = convert(known.pop(GRASPS, {}), dict[str, str])
            if known.pop(_ROWS, digest_of(text)) != digest_of(text):
                raise SchemaError("its rows do not match their checksum")
            rows = [self._row(line) for line in text.splitlines()]
        except (OSError, SchemaError) as error:
            raise BankError(
                f"{self._path}: damaged ({error})",
                f"a file of `{self._command}`",
                "another `out`, or removing that file",
            ) from error
        lacking = [name for name in self._added if name in unstated]
        ours = {name: value for name, value in self._recipe.items() if name not in lacking}
        check_recipe(self._path, "rows made", ours, known)
        if lacking:
            self._show(lacking, len(rows) < number)
        if grasps:
            self._recipe[GRASPS] = grasps
        return rows[:number]

    def _show(self, lacking: Sequence[str], is_continued: bool) -> None:
        """Says what is not known of rows (BankError: more are asked for)."""
        told = f"rows that do not say with which {', '.join(lacking)} they were made"
        if is_continued:
            raise BankError(
                f"{self._path} holds {told}",
                "as many as it holds, which shows them",
                "another `out`",
            )
        print(f"note: {self._path} holds {told}: shown as they are", file=sys.stderr)

    def note_grasps(self, found: Mapping[str, str]) -> None:
        """Adds the digests of objects' grasps to the recipe (BankError: the rows were made with others)."""
        known = self._recipe.setdefault(GRASPS, {})
        check_recipe(
            self._path or Path(),
            "rows made",
            {GRASPS: dict(found)},
            {GRASPS: {**found, **{name: known[name] for name in found if name in known}}},
        )
        known.update(found)

    def write(self, rows: Sequence[Row]) -> None:
        """Keeps these rows, all or none of them."""
        if self._path is not None:
            text = "".join(json.dumps(_plain(row)) + "\n" for row in rows).encode()
            first = with_checksum({**self._recipe, _ROWS: digest_of(text)})
            write_atomically(self._path, f"{json.dumps(first, sort_keys=True)}\n".encode() + text)

    def complete(
        self,
        rows: list[Row],
        number: int,
        make: Callable[[int], Row],
        title: str,
        unit: str = "episode",
        note: Callable[[list[Row]], str] = lambda rows: "",
    ) -> list[Row]:
        """Makes and keeps rows one after another until there are `number`; note: says how far it is."""
        with Progress(title, number, unit, kept=len(rows)) as progress:
            for index in range(len(rows), number):
                rows.append(make(index))
                self.write(rows)
                progress.update(note=note(rows))
        return rows

    def _row(self, line: bytes) -> Row:
        found = convert(parse_json(line), Record)
        numbers = {key: math.nan if value is None else value for key, value in found.items()}
        return convert(numbers, self._kind)


def _plain(row: Any) -> Record:
    return {
        key: finite(value) if isinstance(value, float) else value
        for key, value in asdict(row).items()
    }
