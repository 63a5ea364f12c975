"""Ten tables, with regions fitted to each and changed at random."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.cells import (
    LOOSE,
    STRICT,
    Column,
    Row,
    figures_by,
    name_of,
    pooled,
    share,
    table_of,
)
from cluttergen_jax.evaluation.episodes import per_scene
from cluttergen_jax.evaluation.rivals import success_notes
from cluttergen_jax.evaluation.studies.contact_sheets import renders
from cluttergen_jax.evaluation.studies.density import table_sizes
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, named_rows
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.statistics import wilson
from cluttergen_jax.tables import Table

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
PAPER = 0.70
"""The paper's success over ten furniture tables and all groups, 50 episodes each."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Every table with every pool; quick, each with one of them by turns."""
    return _trials(scale, SUPPORTS, ("policy",))


def trials_of_tops(scale: Scale) -> tuple[Trial, ...]:
    """The same on cuboid tables of the authors' sizes, with the paper's own method."""
    return _trials(scale, table_sizes(*TOPS), (CLUTTERGEN, "policy"))


def _trials(scale: Scale, supports: tuple[str, ...], policies: tuple[str, ...]) -> tuple[Trial, ...]:
    pools = scale.chosen(*EMBEDDED)
    base = scale.trial(50, 2, change="all", paper_count=not scale.quick)
    learned = grid(base, method=policies, pool=pools, support=supports)
    bases = grid(replace(base, paper_count=False), pool=pools, support=supports)
    ours = [row for name in ROWS for row in named_rows(bases, name)]
    return tuple(
        row
        for row in (*learned, *ours)
        if not scale.quick or supports.index(row.support) % len(pools) == pools.index(row.pool)
    )


def tables(result: Result) -> list[Table]:
    """Success by table, all pools together; then by table and pool, a table for each method and count."""
    names = dict.fromkeys(map(name_of, result["records"]))
    of_name = {name: [row for row in result["records"] if name_of(row) == name] for name in names}
    found = []
    tables_are = _TABLES[result["name"]]
    compared = {name: rows for name, rows in of_name.items() if name in ROWS}
    if len(compared) > 1:
        found.append(_side_by_side(result["title"], compared))
    for name, rows in of_name.items():
        margin = margin_of(rows)
        found.append(
            _by_support(f"{result['title']} ({name}, strict{margin})", rows, tables_are, is_loose=False)
        )
        if any("paper" in row.get("figures", {}) for row in rows):
            title = f"{result['title']} ({name}, paper's count{margin})"
            found.append(_by_support(title, rows, tables_are, is_loose=True))
    return found


def _side_by_side(title: str, of_name: dict[str, list[Row]]) -> Table:
    """A line for each support, a column for each row's name, all pools together."""
    every = [row for rows in of_name.values() for row in rows]
    made = [row for row in every if "figures" in row]

    def column(name: str) -> Column:
        return Column(name, lambda line: _total(row for row in line["rows"] if name_of(row) == name))

    supports = dict.fromkeys(row["trial"]["support"] for row in every)
    lines = [
        {"name": support, "rows": [row for row in every if row["trial"]["support"] == support]}
        for support in supports
    ]
    columns = (Column("table", lambda line: line["name"]), *map(column, of_name))
    # Pooled over pools first: a share of all of a table's scenes, or of all scenes.
    pooled_rows = [
        _pooled_row(name, support, [row for row in rows if support in (row["trial"]["support"], ALL_TABLES)])
        for support in (ALL_TABLES, *supports)
        for name, rows in of_name.items()
    ]
    notes = (STRICT, *RULES, *success_notes(pooled_rows, lambda row: row["support"]))
    return table_of(
        f"{title}, all pools{margin_of(made)}", columns, [*lines, {"name": ALL_TABLES, "rows": every}], notes
    )


def _pooled_row(name: str, support: str, rows: list[Row]) -> Row:
    """Several rows as one; missing where none of them is made."""
    made = [row["figures"] for row in rows if "figures" in row]
    head: Row = {"method": name, "support": support}
    if not made:
        return head | {"missing": "no rows"}
    sums = {
        each: sum(row[each] for row in made)
        for each in ("num_success", "trials", "attempts", "simulated_steps")
    }
    low, high = wilson(sums["num_success"], sums["trials"])
    valid = sums["num_success"]
    figures = sums | {
        "success": sums["num_success"] / sums["trials"],
        "low95": low,
        "high95": high,
        "attempts_per_valid_scene": per_scene(sums["attempts"], valid),
        "simulated_steps_per_valid_scene": per_scene(sums["simulated_steps"], valid),
    }
    return head | {"figures": figures}


def _total(some: Iterable[Row]) -> str:
    made = [row for row in some if "figures" in row]
    return pooled(made, is_loose=False) if made else "-"


def _by_support(title: str, rows: list[Row], tables_are: str, is_loose: bool) -> Table:
    """A line for each support, a column for each pool."""

    def pool_column(pool: str) -> Column:
        def cell(line: Row) -> str:
            of_pool = [row for row in line["rows"] if row["trial"]["pool"] == pool]
            return total(of_pool) if line["name"] == "all" else _rate(of_pool, is_loose)

        return Column(pool, cell)

    def total(some: Iterable[Row]) -> str:
        made = [row for row in some if "figures" in row]
        return pooled(made, is_loose) if made else "-"

    supports = dict.fromkeys(row["trial"]["support"] for row in rows)
    lines = [
        {"name": support, "rows": [row for row in rows if row["trial"]["support"] == support]}
        for support in supports
    ]
    columns = (
        Column("table", lambda line: line["name"]),
        *map(pool_column, dict.fromkeys(row["trial"]["pool"] for row in rows)),
        Column("all pools", lambda line: total(line["rows"])),
    )
    notes = (
        LOOSE if is_loose else STRICT,
        f"the paper: {share(PAPER)} over ten furniture tables and all groups, by its own count",
        "the region is the support's own, changed at random in every episode (as `all` in table 2), then "
        "moved and shrunk, by as little area as it takes, until it lies within the support's own again: on a "
        "narrow table a turned one is much smaller than the 0.60 x 0.70 m of training",
        tables_are,
        *(f"no checkpoint: {hint}" for hint in sorted({row["hint"] for row in rows if "hint" in row})),
    )
    return table_of(title, columns, [*lines, {"name": "all", "rows": rows}], notes)


def _rate(rows: list[Row], is_loose: bool) -> str:
    made = [row for row in rows if "figures" in row]
    return share(figures_by(made[-1], is_loose)["success"]) if made else "-"


def _question(row: Row) -> str:
    trial = row["trial"]
    return f"{trial['pool']} on {trial['support']}, {1e3 * trial.get('min_margin', 0.0):g} mm"


FURNITURE = Study(
    "furniture",
    "Ten tables, regions fitted to each and changed at random",
    50,
    trials,
    tables,
    renders=renders,
    measured_as="renders",
    question=_question,
)
TABLE_TOPS = replace(
    FURNITURE,
    name="table_tops",
    title="Tables of the sizes of the authors' eleven, regions changed at random",
    trials=trials_of_tops,
)
_TABLES = {
    FURNITURE.name: "the tables are this project's",
    TABLE_TOPS.name: "cuboids, each as large as the box about the top of one of the authors' tables",
}
