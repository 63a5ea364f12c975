"""Totals over scenes: how many succeed, what they took, and what was rejected; for people."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.scene.bank.table import COUNTED
from cluttergen_jax.types import Verdict


@dataclass
class Totals:
    """Sums over rows of a bank, which are added some at a time.

    Attributes:
      scenes, success, filled: how many, how many of them stand, and of how many every slot was filled.
      placed, attempts, simulated_steps: of all of them.
      num_rested: objects that took an attempt and were placed; own_attempts, rest_steps: sums over those.
      verdicts: attempts by verdict.
    """

    scenes: int = 0
    success: int = 0
    filled: int = 0
    placed: int = 0
    attempts: int = 0
    simulated_steps: int = 0
    num_rested: int = 0
    own_attempts: int = 0
    rest_steps: int = 0
    verdicts: dict[Verdict, int] = field(default_factory=lambda: dict.fromkeys(COUNTED, 0))

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        self.scenes += rows.num_rows
        self.success += _sum(rows, "is_success")
        self.filled += _sum(rows, "is_filled")
        self.placed += _sum(rows, "num_placed")
        self.simulated_steps += _sum(rows, "simulated_steps")
        attempts, steps, placed = (
            np.array(pc.list_flatten(rows[name])) for name in ("attempts", "rest_steps", "is_placed")
        )
        self.attempts += int(attempts.sum())
        # Objects that stood there at the beginning took no attempt.
        placed &= attempts > 0
        self.num_rested += int(placed.sum())
        self.own_attempts += int(attempts[placed].sum())
        self.rest_steps += int(steps[placed].sum())
        for verdict in COUNTED:
            self.verdicts[verdict] += _sum(rows, f"num_{verdict.label.replace('-', '_')}")

    def text(self, num_new: int = 0, seconds: float = 0.0) -> str:
        """Success, attempts, steps to rest and rejections by verdict.

        Args:
          num_new, seconds: scenes made just now and how long that took, for the rate; 0 leaves it out.
        """
        rested, total = max(self.num_rested, 1), max(sum(self.verdicts.values()), 1)
        lines = [
            f"scenes     {self.scenes}, of which {self.success} succeed ({self.success / self.scenes:.1%}): "
            "every object placed, and all stand together in the last check",
            f"filled     {self.filled} ({self.filled / self.scenes:.1%}) before the last check",
            f"attempts   {self.attempts}, {self.own_attempts / rested:.2f} per placed object",
            f"rest       after {self.rest_steps / rested:.0f} steps of 1/240 s in the mean",
        ]
        rejected = [
            f"{number} {verdict.label} ({number / total:.1%}): {verdict.sentence}"
            for verdict, number in self.verdicts.items()
            if number and verdict != Verdict.STABLE
        ]
        lines.append("rejected   " + ("\n           ".join(rejected) or "nothing"))
        if num_new and seconds > 0:
            lines.append(f"speed      {num_new} new scenes in {seconds:.1f} s, compilation included")
        return "\n".join(lines)


def _sum(rows: pa.Table, name: str) -> int:
    return int(np.sum(rows[name], dtype=np.int64))


def totals_of(tables: Iterable[pa.Table]) -> Totals:
    """The totals of all these rows."""
    totals = Totals()
    for rows in tables:
        totals.add(rows)
    return totals
