"""Shares and spreads: what a table says of many trials."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np
from scipy.stats import binomtest


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of a proportion (Wilson, 1927); from 0 to 1 where nothing was tried."""
    if trials == 0:
        return 0.0, 1.0
    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def share_row(good: int, number: int) -> dict[str, float]:
    """A share with its interval, as a row of results has it; 0 of nothing."""
    low, high = wilson(good, number)
    return {"share": good / max(number, 1), "low95": low, "high95": high}


def proportion(is_good: np.ndarray) -> dict[str, float]:
    """The share of bool[N] that is true (`share_row`)."""
    return share_row(int(is_good.sum()), len(is_good))


def finite(value: float) -> float | None:
    """The figure, or None where it is none: JSON has no NaN."""
    return float(value) if math.isfinite(value) else None


class SpreadRow(TypedDict):
    """Count, mean, standard deviation and quartiles; None instead of figures of nothing."""

    count: int
    mean: float | None
    std: float | None
    quartiles: list[float] | None


def spread_of(values: np.ndarray) -> SpreadRow:
    """Of f[N]."""
    if len(values) == 0:
        return {"count": 0, "mean": None, "std": None, "quartiles": None}
    return {
        "count": len(values),
        "mean": float(np.mean(values)),
        "std": float(np.std(values)),
        "quartiles": [float(each) for each in np.percentile(values, [25, 50, 75])],
    }
