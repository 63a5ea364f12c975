"""Certainty: the chance that a pose is right, by a logistic rule fitted to poses whose errors are known."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from cluttergen_jax.downstream.perception.types import PoseEstimate
from cluttergen_jax.errors import PoolError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import checked_record, convert, with_checksum

FILE = "certainty.json"
FEATURES = ("bias", "score", "gap", "lead", "visible", "pixels", "steady")
_PRIOR = 2.0
"""Strength of what holds the weights near to the usual ones, in poses."""
_STEPS = 50


@dataclass(frozen=True)
class Certainty:
    """Chances from what is known of estimates.

    Attributes:
      weights: of `FEATURES`; the usual ones were set by hand.
      number: poses that they were fitted to; 0 for the usual ones.
    """

    weights: tuple[float, ...] = (-6.0, 6.0, 4.0, 1.0, 1.5, 0.3, 1.0)
    number: int = 0

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """f64[...] in (0, 1): the chance that poses with features f[..., 7] are right."""
        return 1 / (1 + np.exp(-np.asarray(features, np.float64) @ np.array(self.weights)))

    def fit_to(self, features: np.ndarray, is_right: np.ndarray) -> Certainty:
        """The rule that fits poses best, bool[P], with features f[P, 7] (Newton's method)."""
        usual = np.array(self.weights)
        weights = usual.copy()
        prior = _PRIOR * np.eye(len(usual)) / 4
        for _ in range(_STEPS):
            chance = 1 / (1 + np.exp(-features @ weights))
            slope = features.T @ (chance - is_right) + prior @ (weights - usual)
            bend = (features * (chance * (1 - chance))[:, None]).T @ features + prior
            change = np.linalg.solve(bend, slope)
            weights = weights - change / max(1.0, float(np.linalg.norm(change)))
            if np.linalg.norm(change) < 1e-8:
                break
        return Certainty(tuple(weights.tolist()), len(features))


class _Stored(msgspec.Struct):
    """What the file holds."""

    weights: dict[str, float]
    number: Annotated[int, msgspec.Meta(ge=0)]


def features_of(estimate: PoseEstimate, is_steady: bool) -> np.ndarray:
    """f64[7], in the order of `FEATURES`."""
    pixels = np.log10(max(estimate.num_pixels, 1)) - 2
    told = (estimate.score, estimate.gap, estimate.lead)
    return np.array([1.0, *told, estimate.visible, pixels, float(is_steady)])


def read_certainty(folder: Path) -> Certainty:
    """The rule beside a segmenter; the usual one where there is none.

    Raises:
      PoolError: the file is damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return Certainty()
    try:
        stored = convert(checked_record(path.read_bytes()), _Stored)
        return Certainty(tuple(stored.weights[name] for name in FEATURES), stored.number)
    except (OSError, ValueError, KeyError) as error:
        raise PoolError(
            f"{path} is damaged ({error})", hint="cluttergen perception eval --calibrate"
        ) from error


def write_certainty(folder: Path, certainty: Certainty) -> None:
    """Stores the rule beside a segmenter."""
    weights = dict(zip(FEATURES, certainty.weights, strict=True))
    stored = with_checksum({"weights": weights, "number": certainty.number})
    write_atomically(folder / FILE, (json.dumps(stored, indent=1) + "\n").encode())


def reliability(
    chance: np.ndarray, is_right: np.ndarray, bins: int = 5
) -> list[tuple[float, float, int]]:
    """Of each bin of chances f[P] that holds any: their mean, the share that was right bool[P], how many."""
    place = np.minimum((chance * bins).astype(int), bins - 1)
    rows = []
    for each in range(bins):
        inside = place == each
        if inside.any():
            rows.append(
                (float(chance[inside].mean()), float(is_right[inside].mean()), int(inside.sum()))
            )
    return rows
