"""The temperature of a placer's chances."""

from __future__ import annotations

import numpy as np

_TEMPERATURES = np.exp(np.linspace(np.log(0.25), np.log(4.0), 129))


def best_temperature(logits: np.ndarray, label: np.ndarray) -> float:
    """By which logits f32[N] are divided so that their chances fit labels bool[N] best (least surprise)."""
    signed = np.where(label, 1.0, -1.0) * logits.astype(np.float64)
    surprise = [np.logaddexp(0.0, -signed / each).mean() for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(surprise))])
