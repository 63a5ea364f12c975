"""Success on tables whose queried region changes at random: table 2, ten tables, and the authors' sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.comparison import Column, name_of, request_columns, share, table_of
from cluttergen_jax.evaluation.records import Figures, Row
from cluttergen_jax.evaluation.runner import per_scene
from cluttergen_jax.evaluation.trial import Trial, grid, trial_of
from cluttergen_jax.placement.region import REGION_CHANGES
from cluttergen_jax.statistics import wilson
from cluttergen_jax.tables import Table
from studies.cells import BOTH, LOOSE, STRICT, columns_of, figures_by, pooled_success
from studies.methods.density import table_sizes
from studies.methods.pictures import render_regions
from studies.methods.table1 import (
    CLUTTERGEN,
    IMPORTED,
    TWINS,
    differences,
    differs,
)
from studies.rankings import success_notes
from studies.results import Result, made_rows
from studies.rules import RULES, margin_of, named_rows
from studies.study import Scale, Study

POOL = "household"
"""Stands for group 5, the only one that the paper's table 2 is of."""
PAPER_BY_CHANGE = {
    "none": 0.99,
    "translation": 0.89,
    "rotation": 0.92,
    "shrinkage": 0.76,
    "expansion": 0.93,
    "all": 0.85,
}
"""The paper's success by change: group 5, a table of 1.40 x 1.40 x 0.70 m, 500 episodes."""


def _changes(scale: Scale) -> tuple[Trial, ...]:
    """Policies that were trained on one region, on a large table; the paper's own objects where at hand."""
    own = [pool for pool, _ in scale.imported if pool == f"{IMPORTED}{POOL}"]
    base = scale.trial_by_both_counts(500, 4, support="table-1.40x1.40", region="0.6x0.7")
    methods = ("policy", CLUTTERGEN, "random")
    changes = scale.values(tuple(REGION_CHANGES), ("none", "all"))
    return grid(base, pool=scale.pools_or(POOL, *own), method=methods, change=changes)


def _table2(result: Result) -> list[Table]:
    """Success by both counts."""

    def papers(row: Row) -> str:
        trial = row["trial"]
        is_theirs = trial["pool"].removeprefix(IMPORTED) == POOL and trial["method"] in TWINS
        return share(PAPER_BY_CHANGE[trial["change"]]) if is_theirs else "-"

    columns = (
        *request_columns("pool", "method", "change"),
        *BOTH,
        Column("paper: success", papers, is_asked=True),
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


TABLE2 = Study(
    "table2",
    "The queried region changed at random, zero-shot (table 2)",
    500,
    _changes,
    make_tables=_table2,
    renders=render_regions,
    measured_as="renders",
)

SUPPORTS = (
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
TOPS = (
    "0.59x0.61",
    "0.65x0.69",
    "0.86x0.35",
    "0.90x0.49",
    "1.06x0.80",
    "0.87x0.85",
    "0.90x0.66",
    "0.84x0.84",
    "0.95x0.41",
    "0.71x0.77",
    "0.81x0.53",
)
"""Metres: boxes about the tops of the authors' eleven tables."""
ROWS = ("drop", "drop, ruin", "spread", "guided")
"""Compared at equal support margins; `policy` has the paper's rules, beside the paper's figure."""
ALL_TABLES = "all"
_QUICK_TABLES = 2
PAPER = 0.70
"""The paper's success over ten furniture tables and all groups, 50 episodes each."""


def _trials(supports: tuple[str, ...], *policies: str) -> Callable[[Scale], tuple[Trial, ...]]:
    """Every table with every pool; the first tables if quick."""

    def trials(scale: Scale) -> tuple[Trial, ...]:
        places = {
            "pool": scale.pools_or(*EMBEDDED),
            "support": supports[: scale.values(None, _QUICK_TABLES)],
        }
        base = scale.trial(50, 2, change="all", paper_count=not scale.quick)
        learned = grid(base, method=policies, **places)
        bases = grid(base.replace(paper_count=False), **places)
        return (*learned, *(row for name in ROWS for row in named_rows(bases, name)))

    return trials


def _tables(result: Result) -> list[Table]:
    """Success by table, all pools together; then by table and pool, a table for each method and count."""
    names = dict.fromkeys(map(name_of, result["records"]))
    title = result["title"]
    of_name = {name: [row for row in result["records"] if name_of(row) == name] for name in names}
    found = []
    compared = {name: rows for name, rows in of_name.items() if name in ROWS}
    if len(compared) > 1:
        found.append(_side_by_side(title, compared))
    for name, rows in of_name.items():
        margin = margin_of(rows)
        tables_are = _TABLES[result["name"]]
        found.append(
            _by_support(f"{title} ({name}, strict{margin})", rows, tables_are, is_loose=False)
        )
        if any("paper" in row["figures"] for row in made_rows(rows)):
            title_of_count = f"{title} ({name}, paper's count{margin})"
            found.append(_by_support(title_of_count, rows, tables_are, is_loose=True))
    return found


def _lines(rows: Iterable[Row]) -> list[Row]:
    """A line for each support, and one for all of them together."""
    supports = dict.fromkeys(row["trial"]["support"] for row in rows)
    return [Row(support=each) for each in (*supports, ALL_TABLES)]


def _on(rows: Iterable[Row], support: str) -> list[Row]:
    return [row for row in rows if support in (row["trial"]["support"], ALL_TABLES)]


def _side_by_side(title: str, of_name: dict[str, list[Row]]) -> Table:
    """A line for each support, a column for each row's name, all pools together."""
    every = [row for rows in of_name.values() for row in rows]
    lines = _lines(every)
    columns = (
        Column("table", lambda line: line["support"]),
        *columns_of(
            of_name, str, lambda line, name: pooled_success(_on(of_name[name], line["support"]))
        ),
    )
    # Pooled over pools first: a share of all of a table's scenes, or of all scenes.
    pooled = [
        _pool_rows(name, line["support"], _on(rows, line["support"]))
        for line in (lines[-1], *lines[:-1])
        for name, rows in of_name.items()
    ]
    notes = (STRICT, *RULES, *success_notes(pooled, lambda row: row["support"]))
    return table_of(f"{title}, all pools{margin_of(made_rows(every))}", columns, lines, notes)


def _pool_rows(name: str, support: str, rows: list[Row]) -> Row:
    """Several rows as one; missing where none of them is made."""
    made = [row["figures"] for row in made_rows(rows)]
    if not made:
        return Row(method=name, support=support, missing="no rows")
    successes = sum(each["num_success"] for each in made)
    trials = sum(each["trials"] for each in made)
    low, high = wilson(successes, trials)
    figures = Figures(
        num_success=successes,
        success=successes / trials,
        low95=low,
        high95=high,
        attempts_per_valid_scene=per_scene(sum(each["attempts"] for each in made), successes),
        simulated_steps_per_valid_scene=per_scene(
            sum(each["simulated_steps"] for each in made), successes
        ),
    )
    return Row(method=name, support=support, figures=figures)


def _by_support(title: str, rows: list[Row], tables_are: str, is_loose: bool) -> Table:
    """A line for each support, a column for each pool."""

    def cell(line: Row, pool: str) -> str:
        some = [row for row in _on(rows, line["support"]) if row["trial"]["pool"] == pool]
        made = made_rows(some)
        if line["support"] == ALL_TABLES:
            return pooled_success(made, is_loose)
        return share(figures_by(made[-1], is_loose)["success"]) if made else "-"

    columns = (
        Column("table", lambda line: line["support"]),
        *columns_of(dict.fromkeys(row["trial"]["pool"] for row in rows), str, cell),
        Column("all pools", lambda line: pooled_success(_on(rows, line["support"]), is_loose)),
    )
    notes = (
        LOOSE if is_loose else STRICT,
        f"the paper: {share(PAPER)} over ten furniture tables and all groups, by its own count",
        "the region is the support's own, changed at random in every episode (as `all` in table 2), then "
        "moved and shrunk, by as little area as it takes, until it lies within the support's own again: on a "
        "narrow table a turned one is much smaller than the 0.60 x 0.70 m of training",
        tables_are,
        *(
            f"no checkpoint: {hint}"
            for hint in sorted({row["hint"] for row in rows if "hint" in row})
        ),
    )
    return table_of(title, columns, _lines(rows), notes)


def _question(row: Row) -> str:
    trial = trial_of(row)
    return f"{trial.pool} on {trial.support}, {1e3 * (trial.spec.min_margin or 0.0):g} mm"


TABLES = Study(
    "furniture",
    "Ten tables, regions fitted to each and changed at random",
    50,
    _trials(SUPPORTS, "policy"),
    make_tables=_tables,
    renders=render_regions,
    measured_as="renders",
    question=_question,
)
TABLE_TOPS = replace(
    TABLES,
    name="table_tops",
    title="Tables of the sizes of the authors' eleven, regions changed at random",
    trials=_trials(table_sizes(*TOPS), CLUTTERGEN, "policy"),
)
_TABLES = {
    TABLES.name: "the tables are this project's",
    TABLE_TOPS.name: "cuboids, each as large as the box about the top of one of the authors' tables",
}
