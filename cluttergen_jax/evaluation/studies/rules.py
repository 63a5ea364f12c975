"""Rows of one method by several rules: its own, and baselines that take objects away when they are stuck.

Tables of the paper keep the paper's rules, which are those of a `Trial` unless given. Everywhere else a row
has the rules that `generate` gives its method, and all rows of a table ask for the same support margin.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.cells import Row
from cluttergen_jax.evaluation.trial import RANDOM_ORDER, ROBUST, RUIN, TIDY, Trial
from cluttergen_jax.placement.config import RUIN_AFTER
from cluttergen_jax.spec import SceneSpec


def own_rules(trial: Trial) -> Trial:
    """The trial by the rules that its method has by default, its budget kept."""
    return with_rules_of(trial, SceneSpec(max_attempts=trial.attempts, budget=trial.budget))


def with_rules_of(trial: Trial, spec: SceneSpec) -> Trial:
    """The trial by the rules of a request, the method's own where it gives none."""
    decided = spec.with_rules(trial.method)
    return replace(
        trial,
        order=decided.order or trial.order,
        ruin_after=decided.ruin_after or 0,
        budget=decided.budget,
        min_margin=decided.min_margin or 0.0,
        height=spec.height if trial.method == "random" else "rest",
    )


def with_ruin(trial: Trial) -> Trial:
    """The trial with the largest objects mostly first, and some taken away again where it is stuck."""
    return replace(trial, order="weighted", ruin_after=min(RUIN_AFTER, trial.attempts))


def without_ruin(trial: Trial) -> Trial:
    """The trial with objects in random order, none of them ever taken away."""
    return replace(trial, order="random", ruin_after=0)


def when_tidy(trial: Trial) -> Trial:
    """The trial with the best pose of those that are trusted, not any."""
    return replace(trial, tidy=True)


def when_robust(trial: Trial) -> Trial:
    """The trial with robust scenes asked for."""
    return replace(trial, robust=True)


_CHANGED = {RUIN: with_ruin, RANDOM_ORDER: without_ruin, TIDY: when_tidy, ROBUST: when_robust}


def named_rows(bases: Iterable[Trial], *names: str) -> tuple[Trial, ...]:
    """Rows of every base by their names in tables (`trial.row_name`), the names vary fastest.

    Args:
      names: METHOD by its own rules; after it, each behind a comma, "ruin" (`with_ruin`), "random order"
        (`without_ruin`), "tidy" (`when_tidy`) and "robust" (`when_robust`).

    Raises:
      ConfigError: there are no such rules.
    """
    return tuple(_named(base, name) for base in bases for name in names)


def _named(base: Trial, name: str) -> Trial:
    method, *rules = name.split(", ")
    trial = own_rules(replace(base, method=method))
    for each in rules:
        if each not in _CHANGED:
            raise ConfigError(f"a row {name!r}", f"a method, and after commas {', '.join(_CHANGED)}")
        trial = _CHANGED[each](trial)
    return trial


def with_seeds(trials: Iterable[Trial], method: str, seeds: int | None) -> tuple[Trial, ...]:
    """The rows, those of a method once for each of so many training seeds; None is one."""
    return tuple(
        replace(trial, training_seed=seed)
        for trial in trials
        for seed in range((seeds or 1) if trial.method == method else 1)
    )


def margin_of(rows: Iterable[Row]) -> str:
    """What a heading says of the support margin that all rows ask for; "" if there are no rows."""
    margins = sorted({float(row.get("trial", row).get("min_margin", 0.0)) for row in rows})
    if not margins:
        return ""
    if margins == [0.0]:
        return ", no support margin asked for"
    return f", support margin of {' or '.join(f'{1e3 * each:g}' for each in margins)} mm asked for"


RULES = (
    "rules: `guided` and `spread` draw larger objects mostly first, and after five failed attempts in a row "
    "take some objects away and place them again; the other methods place in random order and take nothing "
    "away. `, ruin`: a baseline with that order and taking away; `, random order`: a method without both; "
    "`, tidy`: with the best of the poses that it trusts instead of any of them (`--tidy`)",
)
"""A note below tables with such rows."""
