"""Success on ever smaller tables, and with ever more objects on one."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.evaluation.cells import SPEED, Column, Row, missing, number, share_of, table_of
from cluttergen_jax.evaluation.plots import add_legend, new_figure, prepare, save, success_line
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.methods import METHODS
from cluttergen_jax.placement.baselines import BASELINES
from cluttergen_jax.tables import Table

SIZES = ("0.60x0.70", "0.50x0.60", "0.40x0.50", "0.35x0.45", "0.30x0.40")
_CROWDS = (10, 15, 20, 30)
_CROWD_METHODS = (*BASELINES, "guided", "policy")
"""Without the paper's heads and shorter memories, which the tables of `density` compare."""
_APART = 0.04


def table_sizes(*sizes: str) -> tuple[str, ...]:
    """Names of cuboid tables whose whole top is the queried region."""
    return tuple(f"table-{size}" for size in sizes)


def trials(scale: Scale) -> tuple[Trial, ...]:
    """All methods on tables of five sizes."""
    pools, supports = scale.chosen("dining"), table_sizes(*SIZES)
    return grid(scale.trial(1000, 8), pool=pools, support=supports, method=METHODS)


def crowds(scale: Scale) -> tuple[Trial, ...]:
    """More and more objects on the paper's table."""
    return grid(scale.trial(500, 4, pool="all"), num_objects=_CROWDS, method=_CROWD_METHODS)


def tables(result: Result) -> list[Table]:
    """Success and cost."""
    made = [row for row in result["records"] if "figures" in row]
    lacking = [row for row in result["records"] if "figures" not in row]
    columns = (
        Column("pool", lambda row: row["trial"]["pool"]),
        Column("rung", lambda row: _rung(row["trial"])),
        Column("method", lambda row: row["trial"]["method"]),
        Column("success [95 %]", lambda row: share_of(row["figures"])),
        Column("objects placed", lambda row: number(row["figures"]["placed"], 2)),
        Column("attempts per valid scene", lambda row: _cost(row, "attempts", 1)),
        Column("simulated steps per valid scene", lambda row: _cost(row, "simulated_steps", 0)),
        SPEED,
    )
    notes = (
        "the same attempts for all (five an object), cut off as soon as they can no longer succeed; what "
        "overhangs can fall",
        "per valid scene: all attempts and steps of the row, rejected scenes included; speeds leave "
        "compilation out",
        *dict.fromkeys(map(missing, lacking)),
    )
    return [table_of(result["title"], columns, made, notes)]


def _cost(row: Row, name: str, digits: int) -> str:
    figures = row["figures"]
    return number(figures[f"{name}_per_valid_scene"], digits) if figures["num_success"] else "-"


def _rung(trial: dict) -> str:
    """Where a trial stands: its table, or its number of objects."""
    size = trial["support"].removeprefix("table-")
    return f"{trial['num_objects']} objects" if size == "table" else f"{size} m"


def plot(rows: list[Row], stem: Path) -> list[str]:
    """Strict success, a line for each method."""
    figure = new_figure(6.4, 3.0)
    axis = figure.subplots()
    rungs = list(dict.fromkeys(_rung(row["trial"]) for row in rows))
    methods = list(dict.fromkeys(row["trial"]["method"] for row in rows))
    for turn, method in enumerate(methods):
        chosen = [row for row in rows if row["trial"]["method"] == method]
        # Side by side, so that equal rates do not hide one another.
        shift = _APART * (turn - (len(methods) - 1) / 2)
        x = [rungs.index(_rung(row["trial"])) + shift for row in chosen]
        success_line(axis, method, x, [row["figures"] for row in chosen])
    prepare(axis, "", "", "success")
    axis.set_xticks(range(len(rungs)), rungs)
    add_legend(figure)
    return save(figure, stem)


DENSITY = Study(
    "density", "Tables of exactly the region's size, ten objects", 1000, trials, tables, plot=plot
)
CROWDS = Study("crowds", "Objects of the pool `all` on 0.60 x 0.70 m", 500, crowds, tables, plot=plot)
