"""Sums over scenes: how many succeed, what they took, what was rejected, and how cluttered they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.clutter import NAMES, Clutter
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.record import record_error
from cluttergen_jax.scene.bank.table import COUNTED, count_column
from cluttergen_jax.types import Verdict

_NEAR_ENOUGH = 0.1
_WORDS = {
    "stack": "objects on others",
    "contained": "objects in others",
    "depth": "objects below each, summed",
    "contacts": "pairs that touch",
    "near": "metres to the nearest other, mean",
    "occlusion": "share hidden, mean",
}


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
            np.array(pc.list_flatten(rows[name]))
            for name in ("attempts", "rest_steps", "is_placed")
        )
        self.attempts += int(attempts.sum())
        # Objects that stood there at the beginning took no attempt.
        placed &= attempts > 0
        self.num_rested += int(placed.sum())
        self.own_attempts += int(attempts[placed].sum())
        self.rest_steps += int(steps[placed].sum())
        for verdict in COUNTED:
            self.verdicts[verdict] += _sum(rows, count_column(verdict))

    def text(self, num_new: int = 0, seconds: float = 0.0) -> str:
        """Success, attempts, steps to rest and rejections by verdict.

        Args:
          num_new, seconds: scenes made just now and how long that took, for the rate; 0 leaves it out.
        """
        rested = max(self.num_rested, 1)
        total = max(sum(self.verdicts.values()), 1)
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
            lines.append(
                f"speed      {num_new} scenes made in {seconds:.1f} s, compilation included"
            )
        return "\n".join(lines)


def _sum(rows: pa.Table, name: str) -> int:
    return int(np.sum(rows[name], dtype=np.int64))


def totals_of(tables: Iterable[pa.Table]) -> Totals:
    """The totals of all these rows."""
    totals = Totals()
    for rows in tables:
        totals.add(rows)
    return totals


@dataclass(frozen=True)
class FeatureStats:
    """One feature of clutter over the scenes of a bank that stand.

    Attributes:
      name: as in `placement.clutter.Clutter`.
      got: mean over the scenes.
      asked: the target; None where nothing was asked.
      within: share of the scenes within 10 % of the target; None likewise.
    """

    name: str
    got: float
    asked: float | None = None
    within: float | None = None

    def line(self) -> str:
        """For people."""
        text = f"{self.name} {self.got:.3g} ({_WORDS[self.name]})"
        if self.asked is None or self.within is None:
            return text
        return f"{text}, asked for {self.asked:g}: {self.within:.1%} of the scenes are within 10 %"


class ClutterTally:
    """Sums of the features that rows know, of the scenes that stand; rows are added some at a time.

    Args:
      bank: whose targets count.
    """

    def __init__(self, bank: Bank) -> None:
        self._targets = _targets(bank)
        self._number = dict.fromkeys(NAMES, 0)
        self._sum = dict.fromkeys(NAMES, 0.0)
        self._num_near = dict.fromkeys(NAMES, 0)

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        rows = rows.filter(rows["is_success"])
        for name in NAMES:
            values = _values(rows, name)
            self._number[name] += len(values)
            self._sum[name] += float(values.sum())
            if (asked := self._targets.get(name)) is not None:
                self._num_near[name] += int(
                    (np.abs(values - asked) <= _NEAR_ENOUGH * asked + 1e-6).sum()
                )

    def features(self) -> tuple[FeatureStats, ...]:
        """Those that some row knows."""
        known = [name for name in NAMES if self._number[name]]
        return tuple(
            FeatureStats(
                name,
                self._sum[name] / self._number[name],
                self._targets.get(name),
                self._num_near[name] / self._number[name] if name in self._targets else None,
            )
            for name in known
        )


def _values(rows: pa.Table, name: str) -> np.ndarray:
    """f64[N]: a feature of the scenes that know it."""
    if name == "depth":
        lists = rows["levels"].drop_null().combine_chunks()
        levels = np.maximum(np.array(pc.list_flatten(lists)), 0)
        return np.bincount(np.array(pc.list_parent_indices(lists)), levels, len(lists))
    column = {"stack": "num_on", "contained": "num_in", "contacts": "num_touching"}.get(name, name)
    return np.array(rows[column].drop_null(), float)


def _targets(bank: Bank) -> dict[str, float]:
    try:
        asked = bank.recipe.get("placement", {}).get("clutter")
        return Clutter.of(asked).targets if asked else {}
    except (AttributeError, ConfigError) as error:
        raise record_error(bank.path, error) from error
