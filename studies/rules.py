"""Rows of one method by several rules: its own, and baselines that take objects away when they are stuck.

Tables of the paper keep the paper's rules, which are those of a `Trial` unless given. Everywhere else a row
has the rules that `generate` gives its method, and all rows of a table ask for the same support margin.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.comparison import request_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.trial import (
    RANDOM_ORDER,
    ROBUST,
    RUIN,
    TIDY,
    Trial,
)
from cluttergen_jax.placement.config import RUIN_AFTER


def own_rules(trial: Trial) -> Trial:
    """The trial by the rules that its method has by default, all else kept."""
    spec = replace(trial.spec, setting="default", order=None, ruin_after=None, min_margin=None)
    own = replace(spec.with_rules(trial.method), setting=trial.spec.setting)
    return replace(trial, spec=own)


_CHANGES = {
    RUIN: lambda trial: trial.replace(
        order="weighted", ruin_after=min(RUIN_AFTER, trial.spec.max_attempts)
    ),
    RANDOM_ORDER: lambda trial: trial.replace(order="random", ruin_after=0),
    TIDY: lambda trial: trial.replace(tidy=True),
    ROBUST: lambda trial: trial.replace(robust=True),
}
"""Rules after a method's name: objects mostly by size and some taken away again where it is stuck; in random
order and none taken away; the best pose of those that are trusted, not any; robust scenes."""


def named_rows(bases: Iterable[Trial], *names: str) -> tuple[Trial, ...]:
    """Rows of every base by their names in tables (`Trial.row_name`), the names vary fastest.

    Args:
      names: METHOD by its own rules; after it, each behind a comma, "ruin", "random order", "tidy" and
        "robust".

    Raises:
      ConfigError: there are no such rules.
    """

    def row(base: Trial, name: str) -> Trial:
        method, *rules = name.split(", ")
        trial = own_rules(base.replace(method=method))
        for each in rules:
            if each not in _CHANGES:
                raise ConfigError(
                    f"a row {name!r}", f"a method, and after commas {', '.join(_CHANGES)}"
                )
            trial = _CHANGES[each](trial)
        return trial

    return tuple(row(base, name) for base in bases for name in names)


def with_seeds(trials: Iterable[Trial], method: str, seeds: int | None) -> tuple[Trial, ...]:
    """The rows, those of a method once for each of so many training seeds; None is one."""
    return tuple(
        replace(trial, training_seed=seed)
        for trial in trials
        for seed in range((seeds or 1) if trial.method == method else 1)
    )


def margin_of(rows: Iterable[Row]) -> str:
    """What a heading says of the support margin that all rows ask for; "" if there are no rows."""
    margins = sorted({float(request_of(row).get("min_margin", 0.0)) for row in rows})
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
