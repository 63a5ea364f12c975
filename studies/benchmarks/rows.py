"""Rows of measurements that outlast an interruption: each is stored when it is made, and made once."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import time_text

Row = dict[str, Any]
Cases = Iterator[tuple[str, Callable[[], Row]]]
"""Names of rows, and what makes each: JSON values. A row with `goes_on` is made again, to go on."""


class OutOfTimeError(Exception):
    """There is no time left for another row in this call."""


@dataclass
class Rows:
    """Rows by part and name, in one JSON file that is whole after each row.

    Attributes:
      file: where they are.
      minutes: after which no row is begun in this call; none that is expected to end later is begun either.
      retries: rows that failed are made again.
      say: for what is told on the way.
    """

    file: Path
    minutes: float = 9.0
    retries: bool = False
    say: Callable[[str], None] = print
    _started: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.parts: dict[str, dict[str, Row]] = (
            json.loads(self.file.read_text(encoding="utf-8")) if self.file.exists() else {}
        )

    @property
    def seconds_left(self) -> float:
        """Of this call."""
        return 60 * self.minutes - (time.monotonic() - self._started)

    def of(self, part: str) -> dict[str, Row]:
        """The rows of a part that are not failures, by name."""
        return {name: row for name, row in self.parts.get(part, {}).items() if "failed" not in row}

    def make(self, part: str, cases: Cases) -> None:
        """Makes what is missing of a part.

        Raises:
          OutOfTimeError: the time is up; the same call goes on.
        """
        longest = 0.0
        for name, make in cases:
            kept = self.parts.setdefault(part, {}).get(name)
            if (
                kept is not None
                and not kept.get("goes_on")
                and not (self.retries and "failed" in kept)
            ):
                self.say(f"{part}: {name}: kept")
                continue
            if self.seconds_left <= longest:
                raise OutOfTimeError(f"{part}: {name}")
            self.say(f"{part}: {name} ... ({time_text(max(self.seconds_left, 0))} left)")
            started = time.monotonic()
            row = _made(make)
            seconds = time.monotonic() - started
            longest = max(longest, seconds)
            self.parts[part][name] = row
            write_atomically(self.file, json.dumps(self.parts, indent=1).encode())
            self.say(f"{part}: {name}: {shown(row)} ({time_text(seconds)})")


def _made(make: Callable[[], Row]) -> Row:
    try:
        return make()
    except (ClutterGenError, RuntimeError, ValueError, MemoryError) as error:
        # What does not fit into memory, or is not installed, is no reason to leave out the others.
        return {"failed": f"{type(error).__name__}: {error}".splitlines()[0]}


def shown(row: Row) -> str:
    """A row on a line, for people."""
    values = {name: value for name, value in row.items() if not isinstance(value, (dict, list))}
    return ", ".join(f"{name} {_text(value)}" for name, value in values.items())


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else f"{value}"


def columns(rows: dict[str, Row], names: Sequence[str]) -> list[list[str]]:
    """A table's lines, one for each row: its name, then these fields, empty where it has none."""
    return [
        [name, *(_text(row[each]) if each in row else "" for each in names)]
        for name, row in rows.items()
    ]
