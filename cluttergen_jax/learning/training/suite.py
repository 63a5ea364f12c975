"""The runs that the tables of `evaluate --suite` need, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from cluttergen_jax.config import Preset, Variant
from cluttergen_jax.errors import ConfigError

POOLS = ("dining", "study", "office", "kitchen", "household")
PAPERS_VARIANTS: tuple[Variant, ...] = ("open_loop", "short_memory", "normal", "beta_free")
"""The paper's method and its rivals: trained by one of its presets."""
TABLE_VARIANTS: tuple[Variant, ...] = ("policy", *PAPERS_VARIANTS)
PAPERS_PRESET: Preset = "paper_cpu"
"""What they are trained by unless another of the paper's presets is asked for."""
SEEDS = (0, 1, 2)
ATTEMPTS_POOL = "dining"
TABLE_ATTEMPTS = (1, 2, 3, 4, 5, 10)
DEFAULT_ATTEMPTS = 5
DEFAULT_OBJECTS = 10
LADDER_POOLS = ("dining",)


@dataclass(frozen=True)
class PlannedRun:
    """One training run of a suite.

    Attributes:
      pool, variant, seed, attempts: as `cluttergen train` takes them.
    """

    pool: str
    variant: Variant
    seed: int
    attempts: int = DEFAULT_ATTEMPTS

    def preset(self, asked: Preset) -> Preset:
        """What it is trained by where a preset is asked for a whole suite."""
        is_papers = asked.startswith("paper")
        if self.variant in PAPERS_VARIANTS:
            return asked if is_papers else PAPERS_PRESET
        return "cpu" if is_papers else asked

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
    if suite not in RUN_SUITES:
        raise ConfigError(f"suite {suite!r}", ", ".join(RUN_SUITES), "suite='paper'")
    if len(set(seeds)) < len(seeds) or not all(seed >= 0 for seed in seeds):
        raise ConfigError(
            f"seeds {' '.join(map(str, seeds))}", "different numbers from 0", "seeds=(0, 1, 2)"
        )
    runs = [run for seed in seeds for run in RUN_SUITES[suite](seed, pools)]
    chosen = [run for run in runs if only is None or fnmatchcase(run.name, only)]
    if not chosen:
        names = ", ".join(run.name for run in runs[:4]) + " and so on"
        raise ConfigError(
            f"no run of suite {suite!r} is called {only!r}", names, "`suite_list`, which lists them"
        )
    return chosen


def _paper_runs(seed: int, pools: Sequence[str]) -> list[PlannedRun]:
    """Table 1's variants on each pool; of the first seed, other numbers of attempts too."""
    runs = [PlannedRun(pool, variant, seed) for pool in pools for variant in TABLE_VARIANTS]
    if ATTEMPTS_POOL in pools and seed == SEEDS[0]:
        runs += [
            PlannedRun(ATTEMPTS_POOL, TABLE_VARIANTS[0], seed, attempts)
            for attempts in TABLE_ATTEMPTS
            if attempts != DEFAULT_ATTEMPTS
        ]
    return runs


def _extended_runs(seed: int, pools: Sequence[str]) -> list[PlannedRun]:
    """The ladder's variants, one seed each."""
    if seed != SEEDS[0]:
        return []
    ladder = [pool for pool in pools if pool in LADDER_POOLS]
    return [PlannedRun(pool, variant, seed) for pool in ladder for variant in TABLE_VARIANTS]


RUN_SUITES = {"paper": _paper_runs, "extended": _extended_runs}
