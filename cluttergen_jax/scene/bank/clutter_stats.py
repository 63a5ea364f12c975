"""How cluttered the scenes of a bank are, and how near that is to what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.clutter import NAMES, Clutter
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.record import damaged_record

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


class ClutterTally:
    """Sums of the features that rows know, of the scenes that stand; rows are added some at a time.

    Args:
      bank: whose targets count.
    """

    def __init__(self, bank: Bank) -> None:
        self._targets = _targets(bank)
        self._number = dict.fromkeys(NAMES, 0)
        self._sum, self._num_near = dict.fromkeys(NAMES, 0.0), dict.fromkeys(NAMES, 0)

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        rows = rows.filter(rows["is_success"])
        for name in NAMES:
            values = _values(rows, name)
            self._number[name] += len(values)
            self._sum[name] += float(values.sum())
            if (asked := self._targets.get(name)) is not None:
                self._num_near[name] += int((np.abs(values - asked) <= _NEAR_ENOUGH * asked + 1e-6).sum())

    def features(self) -> tuple[FeatureStats, ...]:
        """Those that some row knows."""
        known = [name for name in NAMES if self._number[name]]
        return tuple(self._feature(name, self._targets.get(name)) for name in known)

    def _feature(self, name: str, asked: float | None) -> FeatureStats:
        number = self._number[name]
        within = None if asked is None else self._num_near[name] / number
        return FeatureStats(name, self._sum[name] / number, asked, within)


def _values(rows: pa.Table, name: str) -> np.ndarray:
    """f64[N]: a feature of the scenes that know it."""
    if name == "depth":
        lists = rows["levels"].drop_null().combine_chunks()
        levels = np.maximum(np.array(pc.list_flatten(lists)), 0)
        return np.bincount(np.array(pc.list_parent_indices(lists)), levels, len(lists))
    column = {"stack": "num_on", "contacts": "num_touching"}.get(name, name)
    return np.array(rows[column].drop_null(), float)


def _targets(bank: Bank) -> dict[str, float]:
    try:
        asked = bank.recipe.get("placement", {}).get("clutter")
        return Clutter.of(asked).targets if asked else {}
    except (AttributeError, ConfigError) as error:
        raise damaged_record(bank.path, error) from error
