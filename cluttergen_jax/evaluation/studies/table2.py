"""Table 2: success while the queried region changes from episode to episode."""

from __future__ import annotations

from cluttergen_jax.evaluation.cells import BOTH, LOOSE, STRICT, Column, Row, asked, share, table_of
from cluttergen_jax.evaluation.studies.contact_sheets import renders
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN, IMPORTED, TWINS, differences, differs
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.region import REGION_CHANGES
from cluttergen_jax.tables import Table

POOL = "household"
"""Stands for group 5, the only one that the paper's table is of."""
PAPER = {
    "none": 0.99,
    "translation": 0.89,
    "rotation": 0.92,
    "shrinkage": 0.76,
    "expansion": 0.93,
    "all": 0.85,
}
"""The paper's success by change: group 5, a table of 1.40 x 1.40 x 0.70 m, 500 episodes."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Policies that were trained on one region, on a large table; the paper's own objects where at hand."""
    own = [pool for pool, _ in scale.imported if pool == f"{IMPORTED}{POOL}"]
    base = scale.counted_twice(500, 4, support="table-1.40x1.40", region=(0.60, 0.70))
    methods = ("policy", CLUTTERGEN, "random")
    return grid(base, pool=scale.chosen(POOL, *own), method=methods, change=REGION_CHANGES)


def tables(result: Result) -> list[Table]:
    """Success by both counts."""
    columns = (
        *asked("pool", "method", "change"),
        *BOTH,
        Column("paper: success", _papers, is_asked=True),
        Column("what differs", differs),
    )
    notes = (
        STRICT,
        LOOSE,
        "table of 1.40 x 1.40 m, region of 0.60 x 0.70 m at its middle; each episode draws its own change: "
        "translation up to 15 cm in x and y, rotation up to half a turn to either side, half extents up to "
        "10 cm smaller or larger",
        "a drawn region is kept on the table: moved inwards by as little as it takes",
        *differences(result),
    )
    return [table_of(result["title"], columns, result["records"], notes)]


def _papers(row: Row) -> str:
    trial = row["trial"]
    is_theirs = trial["pool"].removeprefix(IMPORTED) == POOL and trial["method"] in TWINS
    return share(PAPER[trial["change"]]) if is_theirs else "-"


TABLE2 = Study(
    "table2",
    "The queried region changed at random, zero-shot (table 2)",
    500,
    trials,
    tables,
    renders=renders,
    measured_as="renders",
)
