"""Rows of episodes on disk: a file of lines, of which the first says how the others were made."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import Progress
from cluttergen_jax.schema import (
    SchemaError,
    checked_record,
    convert,
    digest_of,
    parse_json,
    with_checksum,
)
from cluttergen_jax.statistics import finite, wilson

Row = TypeVar("Row")
_NONE = object()
GRASPS = "grasps"
"""Of a recipe: the digest of each object's grasps. Objects are added as episodes have them."""
_ROWS = "rows"
"""In the first line: the checksum of the others."""


class RowFile(Generic[Row]):
    """A file in which an interrupted command finds what it has done.

    Args:
      path: the file; None keeps nothing.
      recipe: what makes rows comparable; those of another recipe are not taken up again.
      kind: the data class of a row; numbers that are not finite are kept as null.
      command: that writes such files, for messages.
      added: names of the recipe that files of older versions do not have. Such rows are shown, not continued:
        with what they were made is not known.
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
          BankError: the file is damaged, its rows were made by another recipe, or there are fewer than
            `number` and an older version made them.
        """
        if self._path is None or not self._path.is_file():
            return []
        try:
            first, _, text = self._path.read_bytes().partition(b"\n")
            known = checked_record(first)
            convert(known.get(GRASPS, {}), dict[str, str])
            if known.pop(_ROWS, digest_of(text)) != digest_of(text):
                raise SchemaError("its rows do not match their checksum")
            rows = [self._row(line) for line in text.splitlines()]
        except (OSError, SchemaError) as error:
            raise BankError(
                f"{self._path}: damaged ({error})",
                f"a file of `{self._command}`",
                "another `out`, or removing that file",
            ) from error
        self._check_recipe(known, len(rows) < number)
        return rows[:number]

    def note_grasps(self, found: Mapping[str, str]) -> None:
        """Adds the digests of objects' grasps to the recipe.

        Raises:
          BankError: the rows were made with others.
        """
        known = self._recipe.setdefault(GRASPS, {})
        self._refuse(
            [
                f"{GRASPS} of {name}"
                for name in sorted(found)
                if known.get(name, found[name]) != found[name]
            ]
        )
        known.update(found)

    def _check_recipe(self, known: dict[str, Any], is_continued: bool) -> None:
        lacking = [
            name for name in self._added if name in {*self._recipe, GRASPS}.difference(known)
        ]
        names = sorted({*self._recipe, *known}.difference(lacking, [GRASPS]))
        self._refuse(
            [name for name in names if known.get(name, _NONE) != self._recipe.get(name, _NONE)]
        )
        if GRASPS in known:
            self._recipe[GRASPS] = dict(known[GRASPS])
        if not lacking:
            return
        told = f"of an older version, which did not note their {', '.join(lacking)}"
        if is_continued:
            raise BankError(
                f"{self._path} holds episodes {told}",
                "as many episodes as it holds, which shows them",
                "another `out`",
            )
        print(f"note: the episodes in {self._path} are {told}: shown as they are", file=sys.stderr)

    def _refuse(self, changed: Sequence[str]) -> None:
        if changed:
            raise BankError(
                f"{self._path} holds episodes made otherwise, with another {', '.join(changed)}",
                "the same settings, which continue them",
                "another `out`",
            )

    def write(self, rows: Sequence[Row]) -> None:
        """Keeps these rows, all or none of them."""
        if self._path is not None:
            text = "".join(json.dumps(_plain(row)) + "\n" for row in rows).encode()
            first = json.dumps(
                with_checksum({**self._recipe, _ROWS: digest_of(text)}), sort_keys=True
            )
            write_atomically(self._path, f"{first}\n".encode() + text)

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
        found = convert(parse_json(line), dict[str, Any])
        numbers = {key: math.nan if value is None else value for key, value in found.items()}
        return convert(numbers, self._kind)


def _plain(row: Any) -> dict[str, object]:
    return {
        key: finite(value) if isinstance(value, float) else value
        for key, value in asdict(row).items()
    }


def share_of(good: int, number: int) -> str:
    """A share with its Wilson interval, as tables show it."""
    low, high = wilson(good, number)
    return f"{good / max(number, 1):.3f} [{low:.3f}, {high:.3f}] of {number}"
