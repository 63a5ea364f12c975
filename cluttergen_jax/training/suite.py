"""The runs that the paper's tables need, as data: pools x variants x seeds, and the number of attempts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from cluttergen_jax.errors import ConfigError

SUITES = ("paper",)
POOLS = ("dining", "study", "office", "kitchen", "household")
VARIANTS = ("policy", "open_loop", "short_memory", "normal", "beta")
SEEDS = (0, 1, 2)
ATTEMPTS_POOL = "dining"
ATTEMPTS = (1, 2, 3, 5, 10)
DEFAULT_ATTEMPTS = 5
PAPER_BUDGET = 2_500_000
"""Environment steps of each of the paper's runs."""


@dataclass(frozen=True)
class PlannedRun:
    """One training run of a suite.

    Attributes:
      pool, variant, seed, attempts: as `cluttergen train` takes them.
    """

    pool: str
    variant: str
    seed: int
    attempts: int = DEFAULT_ATTEMPTS

    @property
    def name(self) -> str:
        """Of the run's folder; `evaluate` finds it by this name."""
        extra = "" if self.attempts == DEFAULT_ATTEMPTS else f"-attempts{self.attempts}"
        return f"{self.pool}-{self.variant}{extra}-{self.seed}"


def plan(
    suite: str, pools: Sequence[str] = POOLS, seeds: Sequence[int] = SEEDS, only: str | None = None
) -> list[PlannedRun]:
    """The runs of a suite, in order: all tables with the first seed come before the second one.

    Args:
      only: a pattern such as `dining-*` or `*-policy-0` for the runs' names.

    Raises:
      ConfigError: there is no such suite, or nothing is left.
    """
    if suite not in SUITES:
        raise ConfigError(f"suite {suite!r}", ", ".join(SUITES), "--suite paper")
    if len(set(seeds)) < len(seeds) or not all(seed >= 0 for seed in seeds):
        raise ConfigError(f"seeds {' '.join(map(str, seeds))}", "different numbers from 0", "--seeds 0 1 2")
    runs = [run for seed in seeds for run in _of_seed(seed, pools)]
    chosen = [run for run in runs if only is None or fnmatchcase(run.name, only)]
    if not chosen:
        names = ", ".join(run.name for run in runs[:4])
        raise ConfigError(
            f"no run of suite {suite!r} is called {only!r}", f"{names} ...", "--suite-list, which lists them"
        )
    return chosen


def _of_seed(seed: int, pools: Sequence[str]) -> list[PlannedRun]:
    """Table 1's variants on each pool; of the first seed, other numbers of attempts too."""
    runs = [PlannedRun(pool, variant, seed) for pool in pools for variant in VARIANTS]
    if ATTEMPTS_POOL in pools and seed == SEEDS[0]:
        runs += [
            PlannedRun(ATTEMPTS_POOL, VARIANTS[0], seed, attempts)
            for attempts in ATTEMPTS
            if attempts != DEFAULT_ATTEMPTS
        ]
    return runs
