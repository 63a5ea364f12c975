"""All tables and figures, as data: which trials each needs, and how many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.published import IMPORTED
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.methods import FILTERED, METHODS
from cluttergen_jax.placement.changes import CHANGES
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.training.suite import ATTEMPTS

PAPER_METHODS = ("random", "open_loop", "short_memory", "normal", "beta", "policy")
"""`beta` is the paper's full method; `policy` is ours, which a preset may give another head."""

FURNITURE = (
    "bar_table",
    "coffee_table",
    "drawer_desk",
    "l_desk",
    "oval_table",
    "picnic_table",
    "round_table",
    "shelf_desk",
    "tray_table",
    "trestle_table",
)
LADDER = ("0.60x0.70", "0.50x0.60", "0.40x0.50", "0.35x0.45", "0.30x0.40")
CROWDS = (10, 15, 20, 30)
CROWD_METHODS = (*BASELINES, "policy", FILTERED, "ranked")
"""Without the paper's heads and shorter memories, which the ladder compares."""
MARGIN_METHODS = (*BASELINES, "policy", "ranked")
_TIGHT = f"table-{LADDER[2]}"


@dataclass(frozen=True)
class Scale:
    """How much is to be done.

    Attributes:
      quick: few trials, for a look at everything within minutes.
      trials: of every row, whatever the suite says; None leaves it to the suite.
      seeds: training seeds of the learned methods where a table asks for several.
      pools: names or folders; the embedded ones if empty.
      methods: whose rows are made; all if empty.
      seed: of the scenes.
      imported: pools of the authors' own objects that are at hand (`published.IMPORTED`), and how many
        objects a scene of each has.
    """

    quick: bool = False
    trials: int | None = None
    seeds: int = 3
    pools: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    seed: int = 0
    imported: tuple[tuple[str, int], ...] = ()

    def number(self, full: int, quick: int) -> int:
        """Trials of a row."""
        return self.trials or (quick if self.quick else full)

    def chosen(self, default: tuple[str, ...]) -> tuple[str, ...]:
        """The pools of a study: those that were asked for, else its own."""
        return self.pools or default


@dataclass(frozen=True)
class Study:
    """One table or figure.

    Attributes:
      name: for `--only` and files.
      title: for people.
      trials: rows, in order.
      measure: what is looked at beside the trials' own figures, of `measuring.MEASURES`; "" for nothing.
      layout: how it is shown, a name of `layouts.LAYOUTS`; "" takes the study's name.
      size: trials of each row, or episodes, of the full study; stated where fewer were made.
    """

    name: str
    title: str
    trials: tuple[Trial, ...]
    size: int
    measure: str = ""
    layout: str = ""


Suite = Callable[[Scale], tuple[Study, ...]]


def learned(methods: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Methods that need a checkpoint."""
    return tuple(method for method in methods if method not in BASELINES)


def paper(scale: Scale) -> tuple[Study, ...]:
    """The paper's tables and figures, in its order."""
    table1 = _table1(scale)
    home = scale.chosen(("household",))[0]
    first = tuple(trial for trial in table1 if trial.training_seed == 0)
    at_home = tuple(trial for trial in first if trial.pool == home)
    return (
        Study("table1", "Success and stable steps by method and pool (table 1)", table1, 1000),
        Study("imported", "The same with the paper's own objects", _imported(scale), 1000, layout="table1"),
        Study(
            "fig1a",
            "Success against the number of objects (figure 1a)",
            _with(first, ("random", "beta", "policy")),
            1000,
        ),
        Study("steps_by_attempt", "Steps of each attempt at objects that took at least three", first, 1000),
        Study(
            "diversity_maps",
            "Where each object lies: Beta beside Normal",
            _with(at_home, ("normal", "beta", "policy")),
            1000,
            measure="diversity_maps",
        ),
        Study(
            "closed_loop",
            "One object on a crowded table: failed attempts ringed in red, until it stands",
            _with(at_home, ("policy", "random")),
            1000,
            measure="closed_loop",
        ),
        Study("learning_curves", "Success while training", _with(table1, learned()), 1000, "learning_curves"),
        Study("attempts", "Success against attempts allowed per object", _attempts(scale), 1000),
        Study(
            "table2",
            "The queried region changed at random, zero-shot (table 2)",
            _table2(scale),
            500,
            measure="renders",
        ),
        Study(
            "furniture",
            "Ten tables, regions fitted to each and changed at random",
            _furniture(scale),
            50,
            measure="renders",
        ),
        Study(
            "relations",
            "Relations that arise by themselves",
            _with(first, ("policy", "random")),
            1000,
            measure="relations",
        ),
    )


def honest(scale: Scale) -> tuple[Study, ...]:
    """What the paper does not ask: density, diversity, bias, robustness, survival, time."""
    ladder, crowds = _ladder(scale), _crowds(scale)
    scenes = _scenes(scale)
    small = tuple(replace(trial, trials=scale.number(64, 4)) for trial in scenes)
    return (
        Study("density", "Tables of exactly the region's size, ten objects", ladder, 1000),
        Study("crowds", "Objects of the pool `all` on 0.60 x 0.70 m", crowds, 500, layout="density"),
        Study("diversity", "How different the scenes of a method are", scenes, 512, measure="diversity"),
        Study("acceptance", "What passes less often than it is proposed", scenes, 512, measure="acceptance"),
        Study("robustness", "Creep, shaking and changed physics", small, 64, measure="robustness"),
        Study("survival", "The same scenes in another engine", small, 64, measure="survival"),
        Study("margin", "Support margins and tilted gravity", _margins(small), 64, measure="margin"),
        Study(
            "margin_survival",
            "What a support margin does for survival in another engine",
            tuple(each for each in _margins(small) if (each.method, each.support) == ("policy", _TIGHT)),
            64,
            measure="survival",
            layout="survival",
        ),
        Study("time", "Time per valid scene, end to end", _timed(scale), 256, measure="timing"),
    )


SUITES: dict[str, Suite] = {"paper": paper, "honest": honest}


def find_suite(name: str, scale: Scale, only: tuple[str, ...] = ()) -> tuple[Study, ...]:
    """The studies of a suite, or those of them that are named.

    Raises:
      ConfigError: there is no such suite, no such study in it, or nothing is left to be made.
    """
    if name not in SUITES:
        raise ConfigError(f"--suite {name}", ", ".join(SUITES), "--suite paper")
    studies = SUITES[name](scale)
    names = tuple(study.name for study in studies)
    unknown = [each for each in only if each not in names]
    if unknown:
        raise ConfigError(
            f"--only {' '.join(unknown)} in suite {name!r}",
            ", ".join(names),
            f"--only {names[0]}",
            closest(unknown[0], names),
        )
    asked = [study for study in studies if (not only or study.name in only) and study.trials]
    if not asked:
        raise ConfigError(
            f"--only {' '.join(only)} without such a pool",
            f"pools of the paper's objects whose names begin with {IMPORTED}",
            f"cluttergen import GROUP --pool {IMPORTED}dining",
        )
    if not scale.methods:
        return tuple(asked)
    kept = [replace(study, trials=_with(study.trials, scale.methods)) for study in asked]
    if not any(study.trials for study in kept):
        known = dict.fromkeys(trial.method for study in asked for trial in study.trials)
        raise ConfigError(f"--methods {' '.join(scale.methods)} with suite {name!r}", ", ".join(known))
    return tuple(study for study in kept if study.trials)


def _counted_twice(scale: Scale, size: tuple[int, int], **asked: Any) -> Trial:
    """A row by both counts, whose attempts run to step 240 as the paper's do; `size` is full and quick."""
    return Trial(trials=scale.number(*size), seed=scale.seed, whole_attempts=True, paper_count=True, **asked)


def _table1(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        _counted_twice(
            scale,
            pool=pool,
            method=method,
            size=(1000, 6),
            training_seed=seed,
        )
        for pool in scale.chosen(EMBEDDED)
        for method in PAPER_METHODS
        for seed in range(1 if method in BASELINES else scale.seeds)
    )


def _imported(scale: Scale) -> tuple[Trial, ...]:
    """The full method on the paper's own groups, as far as they were imported."""
    return tuple(
        _counted_twice(
            scale,
            pool=pool,
            method=method,
            num_objects=number,
            size=(1000, 6),
        )
        for pool, number in scale.imported
        if pool in scale.chosen((pool,))
        for method in ("random", "policy")
    )


def _with(trials: tuple[Trial, ...], methods: tuple[str, ...]) -> tuple[Trial, ...]:
    return tuple(trial for trial in trials if trial.method in methods)


def _attempts(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        _counted_twice(
            scale,
            pool=pool,
            method=method,
            attempts=attempts,
            size=(1000, 4),
        )
        for pool in scale.chosen(("dining",))
        for method in ("random", "policy")
        for attempts in ATTEMPTS
    )


def _table2(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        _counted_twice(
            scale,
            pool=pool,
            support="table-1.40x1.40",
            method=method,
            size=(500, 4),
            region=(0.60, 0.70),
            change=change,
        )
        for pool in scale.chosen(("household",))
        for method in ("policy", "beta", "random")
        for change in CHANGES
    )


def _furniture(scale: Scale) -> tuple[Trial, ...]:
    """Every table with every pool; quick, each with one of them by turns."""
    pools = scale.chosen(EMBEDDED)
    return tuple(
        Trial(
            pool=pool,
            support=support,
            method=method,
            trials=scale.number(50, 2),
            seed=scale.seed,
            change="all",
            paper_count=not scale.quick,
        )
        for method in ("policy", "drop")
        for place, pool in enumerate(pools)
        for turn, support in enumerate(FURNITURE)
        if not scale.quick or turn % len(pools) == place
    )


def _ladder(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        Trial(
            pool=pool,
            support=f"table-{size}",
            method=method,
            trials=scale.number(1000, 8),
            seed=scale.seed,
        )
        for pool in scale.chosen(("dining",))
        for size in LADDER
        for method in METHODS
    )


def _crowds(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        Trial(
            pool="all",
            method=method,
            num_objects=number,
            trials=scale.number(500, 4),
            seed=scale.seed,
        )
        for number in CROWDS
        for method in CROWD_METHODS
    )


def _scenes(scale: Scale) -> tuple[Trial, ...]:
    """The scenes that diversity and bias are asked of: the paper's table and a tight one."""
    return tuple(
        Trial(
            pool=pool,
            support=f"table-{size}",
            method=method,
            trials=scale.number(512, 16),
            seed=scale.seed,
        )
        for pool in scale.chosen(("dining",))
        for size in (LADDER[0], LADDER[2])
        for method in METHODS
    )


def _margins(trials: tuple[Trial, ...]) -> tuple[Trial, ...]:
    """Each of the trials of some methods without a margin and with that which `generate` asks for."""
    chosen = _with(trials, MARGIN_METHODS)
    return tuple(replace(trial, min_margin=margin) for trial in chosen for margin in (0.0, MIN_MARGIN))


def _timed(scale: Scale) -> tuple[Trial, ...]:
    return tuple(
        Trial(pool=pool, method=method, trials=scale.number(256, 8), seed=scale.seed)
        for pool in scale.chosen(("dining",))
        for method in METHODS
    )
