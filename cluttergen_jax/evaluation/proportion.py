"""Shares and spreads: what a table says of many trials."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

_Z95 = 1.959964


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of a proportion (Wilson, 1927).

    The whole range from 0 to 1 where nothing was tried.
    """
    if trials == 0:
        return 0.0, 1.0
    rate, z2 = successes / trials, _Z95**2
    centre = rate + z2 / (2 * trials)
    half = _Z95 * math.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return (centre - half) / (1 + z2 / trials), (centre + half) / (1 + z2 / trials)


def spread_of(values: np.ndarray) -> dict[str, Any]:
    """Count, mean, standard deviation and quartiles of f[N]; None instead of figures of nothing."""
    if len(values) == 0:
        return {"count": 0, "mean": None, "std": None, "quartiles": None}
    return {
        "count": len(values),
        "mean": float(np.mean(values)),
        "std": float(np.std(values)),
        "quartiles": [float(each) for each in np.percentile(values, [25, 50, 75])],
    }
