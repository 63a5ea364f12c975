"""Table 1: success and stable steps of six methods on five pools."""

from __future__ import annotations

from typing import Any

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.cells import Column, Row, asked, share, table_of
from cluttergen_jax.evaluation.published import IMPORTED, TWINS, differences, differs
from cluttergen_jax.evaluation.studies.counts import LOOSE, STRICT, pooled, stable_steps
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.baselines import BASELINES
from cluttergen_jax.tables import Table

TABLE_METHODS = ("random", "open_loop", "short_memory", "normal", "beta", "policy")
"""`beta` is the paper's full method; `policy` is ours, which a preset may give another head."""

_PAPER_POOLS = ("dining", "study", "office", "kitchen", "household")
_PAPER: dict[str, tuple[tuple[float, int], ...]] = {
    "random": ((0.005, 169), (0.0, 290), (0.0, 171), (0.02, 214), (0.005, 176)),
    "open_loop": ((0.212, 139), (0.145, 207), (0.086, 171), (0.232, 165), (0.251, 135)),
    "short_memory": ((0.359, 102), (0.414, 111), (0.364, 107), (0.517, 98), (0.602, 83)),
    "normal": ((0.925, 74), (0.833, 85), (0.951, 56), (0.969, 51), (0.989, 44)),
    "beta": ((0.912, 89), (0.874, 71), (0.963, 60), (0.973, 50), (0.988, 46)),
}
PAPER = {method: dict(zip(_PAPER_POOLS, row, strict=True)) for method, row in _PAPER.items()}
"""The paper's success rate and stable steps by method and pool; `beta` is its ClutterGen."""


def papers(method: str, pool: str) -> tuple[float, int] | None:
    """The paper's success and stable steps that a row stands beside; None if there are none.

    Args:
      pool: an embedded one, or the same name after `IMPORTED`.
    """
    return PAPER.get(TWINS.get(method, method), {}).get(pool.removeprefix(IMPORTED))


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Every method on every pool, learned ones for each seed of training."""
    base, pools = scale.counted_twice(1000, 6), scale.chosen(*EMBEDDED)
    rows = grid(base, pool=pools, method=TABLE_METHODS, training_seed=scale.training_seeds)
    return tuple(row for row in rows if row.training_seed == 0 or row.method not in BASELINES)


def first_seed(scale: Scale) -> tuple[Trial, ...]:
    """Those of the first seed of training, which other figures look at more closely."""
    return tuple(trial for trial in trials(scale) if trial.training_seed == 0)


def one_pool(scale: Scale, *methods: str) -> tuple[Trial, ...]:
    """Those of some methods on `household`, or on the first pool that was asked for."""
    pool = scale.chosen("household")[0]
    return tuple(each for each in first_seed(scale) if each.pool == pool and each.method in methods)


def tables(result: Result) -> list[Table]:
    """Success and stable steps by pool and method, training seeds taken together."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in result["records"]:
        groups.setdefault((row["trial"]["pool"], row["trial"]["method"]), []).append(row)
    columns = (
        *asked("pool", "method"),
        Column("seeds", _seeds, is_asked=True),
        Column("success, strict [95 %]", lambda group: pooled(group["made"], is_loose=False)),
        Column("by seed", _by_seed),
        Column("success, paper's count [95 %]", lambda group: pooled(group["made"], is_loose=True)),
        Column("stable steps", lambda group: stable_steps(group["made"])),
        Column("paper: success", lambda group: _papers_cell(group, 0), is_asked=True),
        Column("paper: steps", lambda group: _papers_cell(group, 1), is_asked=True),
        Column("what differs", lambda group: differs(group["made"][0])),
    )
    notes = (
        STRICT,
        LOOSE,
        "stable steps: all attempts of a placed object added up, mean ± standard deviation over objects, by "
        "the paper's count, attempts run to step 240",
        "seeds: of training; rows with fewer than were asked for are of those that have a checkpoint",
        *differences(result),
    )
    return [table_of(result["title"], columns, map(_joined, groups.values()), notes)]


def _joined(rows: list[Row]) -> Row:
    """The rows of all training seeds as one, missing if all are."""
    made = [row for row in rows if "figures" in row]
    return {"trial": rows[0]["trial"], "made": made} | ({} if made else rows[0])


def _seeds(group: Row) -> str:
    made: list[Any] = group["made"]
    return "-" if made and not any(row.get("policy") for row in made) else str(len(made))


def _by_seed(group: Row) -> str:
    seeds = [share(row["figures"]["success"]) for row in group["made"]]
    return " ".join(seeds) if len(seeds) > 1 else "-"


def _papers_cell(group: Row, place: int) -> str:
    theirs = papers(group["trial"]["method"], group["trial"]["pool"])
    return (share(theirs[0]), str(theirs[1]))[place] if theirs else "-"


TABLE1 = Study("table1", "Success and stable steps by method and pool (table 1)", 1000, trials, tables)
