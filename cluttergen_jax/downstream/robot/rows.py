"""Rows of episodes on disk: a file of lines, of which the first says how the others were made."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.proportions import finite, wilson

Row = TypeVar("Row")
_NONE = object()


class RowFile(Generic[Row]):
    """A file in which an interrupted command finds what it has done.

    Args:
      path: the file; None keeps nothing.
      recipe: what makes rows comparable; those of another recipe are not taken up again.
      kind: the data class of a row; numbers that are not finite are kept as null.
      command: that writes such files, for messages.
    """

    def __init__(self, path: Path | None, recipe: dict[str, Any], kind: type[Row], command: str) -> None:
        self._path, self._kind, self._command = path, kind, command
        self._recipe = json.loads(json.dumps(recipe))

    def read(self) -> list[Row]:
        """The rows that are kept.

        Raises:
          BankError: the file is damaged, or its rows were made by another recipe.
        """
        if self._path is None or not self._path.is_file():
            return []
        try:
            first, *lines = self._path.read_text(encoding="utf-8").splitlines() or [""]
            known: dict[str, Any] = dict(json.loads(first))
            rows = [self._row(line) for line in lines]
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise BankError(
                f"{self._path}: damaged ({error})",
                f"a file of `{self._command}`",
                "another `out`, or removing that file",
            ) from error
        names = sorted({*self._recipe, *known})
        if changed := [name for name in names if known.get(name, _NONE) != self._recipe.get(name, _NONE)]:
            raise BankError(
                f"{self._path} holds episodes made otherwise, with another {', '.join(changed)}",
                "the same settings, which continue them",
                "another `out`",
            )
        return rows

    def write(self, rows: Sequence[Row]) -> None:
        """Keeps these rows, all or none of them."""
        if self._path is not None:
            lines = [json.dumps(self._recipe, sort_keys=True), *(json.dumps(_plain(row)) for row in rows)]
            write_atomically(self._path, ("\n".join(lines) + "\n").encode())

    def _row(self, line: str) -> Row:
        known: Any = {key: math.nan if value is None else value for key, value in json.loads(line).items()}
        return self._kind(**known)


def _plain(row: Any) -> dict[str, Any]:
    return {key: finite(value) if isinstance(value, float) else value for key, value in asdict(row).items()}


def share_of(good: int, number: int) -> str:
    """A share with its Wilson interval, as tables show it."""
    low, high = wilson(good, number)
    return f"{good / max(number, 1):.3f} [{low:.3f}, {high:.3f}] of {number}"
