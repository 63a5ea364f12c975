"""Shares and spreads: what a table says of many trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of a proportion (Wilson, 1927); from 0 to 1 where nothing was tried."""
    from scipy.stats import binomtest

    if trials == 0:
        return 0.0, 1.0
    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def share_row(good: int, number: int) -> dict[str, float]:
    """A share with its interval, as a row of results has it; 0 of nothing."""
    low, high = wilson(good, number)
    return {"share": good / max(number, 1), "low95": low, "high95": high}


def share_of(good: int, number: int) -> str:
    """A share with its interval, as tables show it."""
    low, high = wilson(good, number)
    return f"{good / max(number, 1):.3f} [{low:.3f}, {high:.3f}] of {number}"


def proportion(is_good: np.ndarray) -> dict[str, float]:
    """The share of bool[N] that is true (`share_row`)."""
    return share_row(int(is_good.sum()), len(is_good))


def whole_shares(
    total: int, shares: Sequence[float], least: Sequence[int] | np.ndarray | None = None
) -> np.ndarray:
    """i64[K]: how many of `total` items each of K shares gets, all of them together: the largest remainders.

    Each is within 1 of its exact part. Where `least` are handed out already, what is nearest to that.

    Args:
      shares: f[K], 0 or more, 1 in all.
      least: i[K], `total` or fewer in all.
    """
    exact = np.round(total * np.asarray(shares, np.float64), 6)
    low = np.zeros(len(exact), np.int64) if least is None else np.asarray(least, np.int64)
    counts = np.maximum(np.floor(exact).astype(np.int64), low)
    while counts.sum() != total:
        step = 1 if counts.sum() < total else -1
        lacks = np.where((step > 0) | (counts > low), step * (exact - counts), -np.inf)
        counts[np.argmax(lacks)] += step
    return counts


def share_out(
    number: int,
    shares: Sequence[float],
    rng: np.random.Generator,
    before: Sequence[int] | np.ndarray | None = None,
) -> np.ndarray:
    """i64[number]: to which share each item goes: exact counts (`whole_shares`), permuted by `rng`.

    Args:
      before: i[K], items that each share has already; with the new ones the counts are exact.
    """
    had = np.zeros(len(shares), np.int64) if before is None else np.asarray(before, np.int64)
    wanted = whole_shares(number + int(had.sum()), shares, had)
    return rng.permutation(np.repeat(np.arange(len(shares)), wanted - had))


def is_of_share(place: int, share: float, start: float) -> bool:
    """Whether item `place` of a row without an end is of a share: of the first n, n `share` to within 1.

    Each item is decided by itself (systematic sampling), so that rows may grow and be made in any order.

    Args:
      share: 0 to 1; start: 0 to 1, drawn once for the row.
    """
    return math.floor((place + 1) * share + start) > math.floor(place * share + start)


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
