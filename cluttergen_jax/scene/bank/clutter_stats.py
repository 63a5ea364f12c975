"""How cluttered the scenes of a bank are, and how near that is to what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from cluttergen_jax.placement.clutter import NAMES, Clutter
from cluttergen_jax.scene.bank.bank import Bank

_NEAR_ENOUGH = 0.1
_WORDS = {
    "stack": "objects on others",
    "depth": "objects below each, summed",
    "contacts": "pairs that touch",
    "near": "metres to the nearest other, mean",
    "occlusion": "share hidden, mean",
}


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


def clutter_of(bank: Bank, rows: pa.Table) -> tuple[FeatureStats, ...]:
    """The features that the rows know, of the scenes that stand."""
    rows = rows.filter(rows["is_success"])
    targets = _targets(bank)
    found = []
    for name in NAMES:
        values = _values(rows, name)
        if not len(values):
            continue
        asked = targets.get(name)
        is_near = None if asked is None else np.abs(values - asked) <= _NEAR_ENOUGH * asked + 1e-6
        within = None if is_near is None else float(is_near.mean())
        found.append(FeatureStats(name, float(values.mean()), asked, within))
    return tuple(found)


def _values(rows: pa.Table, name: str) -> np.ndarray:
    """f64[N]: a feature of the scenes that know it."""
    if name == "depth":
        known = rows["levels"].drop_null().to_pylist()
        return np.array([sum(max(level, 0) for level in levels) for levels in known], float)
    column = {"stack": "num_on", "contacts": "num_touching"}.get(name, name)
    return np.array(rows[column].drop_null(), float)


def _targets(bank: Bank) -> dict[str, float]:
    asked = bank.record["recipe"].get("placement", {}).get("clutter")
    return Clutter.of(asked).targets if asked else {}
