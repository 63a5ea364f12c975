"""Acceptance bias: which objects, places and turns pass less often than they are proposed.

A candidate is a proposal (or a placed object, or an object that a scene was asked for), and it passes or
not. For
each category its lift is its share among those that pass over its share among all: 1 is no bias, 0.5 half as
often as proposed. Candidates of one scene depend on one another, so intervals are bootstrapped over scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError

NUM_OCTANTS = 8
ZONES = ("centre", "edge")


@dataclass(frozen=True, eq=False)
class Bias:
    """One way of sorting candidates. C categories.

    Attributes:
      name: what they were sorted by; labels: the categories.
      proposed, passed: i64[C], candidates, and those that passed.
      lift: f64[C], share among those that pass over share among all; NaN where nothing was proposed.
      low, high: f64[C], its 95 % interval; NaN where nothing was proposed.
    """

    name: str
    labels: tuple[str, ...]
    proposed: np.ndarray
    passed: np.ndarray
    lift: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def under_represented(self) -> tuple[str, ...]:
        """Categories whose whole interval lies below 1, the rarest first."""
        order = np.argsort(self.lift)
        return tuple(self.labels[c] for c in order if self.high[c] < 1.0)


def bias_of(
    name: str,
    category: np.ndarray,
    labels: Sequence[str],
    passed: np.ndarray,
    scene: np.ndarray,
    num_draws: int = 1000,
    seed: int = 0,
) -> Bias:
    """The lift of each category, with an interval from scenes drawn again with replacement.

    Args:
      category: i[M], each candidate's category, an index of `labels`.
      passed: bool[M].
      scene: i[M], the scene each candidate belongs to.
      num_draws: of the bootstrap.

    Raises:
      ConfigError: arrays of different lengths, or none of the candidates passed.
    """
    category = np.asarray(category, np.int64)
    passed = np.asarray(passed, bool)
    if not category.shape == passed.shape == np.shape(scene) or category.ndim != 1:
        raise ConfigError(
            f"shapes {category.shape}, {passed.shape} and {np.shape(scene)}", "one length for all"
        )
    if not passed.any():
        raise ConfigError(
            f"{len(passed)} candidates of which none passed", "at least one that passed"
        )
    scenes, row = np.unique(np.asarray(scene), return_inverse=True)
    tables = np.zeros((2, len(scenes), len(labels)))
    np.add.at(tables[0], (row, category), 1)
    np.add.at(tables[1], (row, category), passed)
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(scenes), np.full(len(scenes), 1 / len(scenes)), num_draws)
    # A category may be missing from a draw, or nothing may pass in it.
    drawn = _lift(weights @ tables[0], weights @ tables[1])
    low, high = _percentiles(drawn)
    proposed, kept = tables.sum(1)
    return Bias(
        name,
        tuple(labels),
        proposed.astype(np.int64),
        kept.astype(np.int64),
        _lift(proposed, kept),
        low,
        high,
    )


def _lift(proposed: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """f64[..., C]: share among those that passed over share among all."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return (passed / passed.sum(-1, keepdims=True)) / (
            proposed / proposed.sum(-1, keepdims=True)
        )


def _percentiles(drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[C] each: 2.5 % and 97.5 % of draws f64[B, C], without those that say nothing of a category."""
    low = np.full(drawn.shape[1], np.nan)
    high = np.full(drawn.shape[1], np.nan)
    for c, column in enumerate(drawn.T):
        known = column[np.isfinite(column)]
        if len(known):
            low[c], high[c] = np.percentile(known, [2.5, 97.5])
    return low, high


def zone_of(positions: np.ndarray, region: Rectangle) -> np.ndarray:
    """i64[...]: 0 in the region's middle, 1 near its edge, for positions f[..., 2] in the region's frame.

    The middle is the concentric rectangle of half the area, so that an even spread has one half in each.
    """
    reach = np.abs(np.asarray(positions)) / np.asarray(region.half_extents)
    return (reach.max(-1) > np.sqrt(0.5)).astype(np.int64)


def octant_of(yaw: np.ndarray) -> np.ndarray:
    """i64[...]: the eighth of a turn in which a yaw f[...] in radians lies; octant 0 begins at 0."""
    return (
        np.floor(np.mod(yaw, 2 * np.pi) / (2 * np.pi) * NUM_OCTANTS).astype(np.int64) % NUM_OCTANTS
    )


def acceptance_bias(
    names: Sequence[str],
    object_index: np.ndarray,
    positions: np.ndarray,
    yaw: np.ndarray,
    slot: np.ndarray,
    passed: np.ndarray,
    scene: np.ndarray,
    region: Rectangle,
    num_draws: int = 1000,
    seed: int = 0,
) -> dict[str, Bias]:
    """The four sortings of M candidates: by object, zone, yaw octant and place in the order.

    Take as candidates every proposal of all scenes, and as passing those that were stable in a scene that in
    the end succeeded; or every object that stands in a filled scene, and the last check as the judge.

    Args:
      names: of the world's K objects.
      object_index: i[M]; slot: i[M], counted from 0; scene: i[M]; passed: bool[M].
      positions: f[M, 2], metres, and yaw f[M], radians, in the region's frame (`arrangement`).

    Returns:
      `Bias` under "object", "zone", "yaw" and "order".
    """
    slot = np.asarray(slot)
    eighth = 360 // NUM_OCTANTS
    sortings = {
        "object": (np.asarray(object_index), list(names)),
        "zone": (zone_of(positions, region), list(ZONES)),
        "yaw": (
            octant_of(yaw),
            [f"{eighth * n}-{eighth * (n + 1)} deg" for n in range(NUM_OCTANTS)],
        ),
        "order": (slot, [str(n + 1) for n in range(int(slot.max(initial=0)) + 1)]),
    }
    return {
        name: bias_of(name, category, labels, passed, scene, num_draws, seed)
        for name, (category, labels) in sortings.items()
    }
