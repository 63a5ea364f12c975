"""Success on ever smaller tables, with ever more objects on one, and by how full a table is."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.pool import ALL, find_pool
from cluttergen_jax.evaluation.comparison import (
    SPEED,
    SUCCESS,
    Column,
    missing,
    name_of,
    request_columns,
    table_of,
)
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.trial import Trial, grid, trial_of
from cluttergen_jax.plots import PAGE, new_figure, prepare, save
from cluttergen_jax.tables import Table
from studies.cells import EFFORT, EFFORT_NOTES, FILL
from studies.methods.table1 import ALL_METHODS
from studies.plots import add_legend, plot_shares
from studies.rankings import OURS, success_notes
from studies.results import Result, made_rows
from studies.rules import RULES, margin_of, named_rows, with_seeds
from studies.study import Scale, Study

SIZES = ("0.60x0.70", "0.50x0.60", "0.40x0.50", "0.35x0.45", "0.30x0.40")
_NARROW = "0.22x0.30"
FILLS = (0.5, 1.0, 1.5, 2.0)
"""Footprints of a scene's objects over the region's area, of the rungs by fill."""
_FILL_OBJECTS = 20
_SIDES = (0.60, 0.70)
"""Metres; tables of other areas are as long for their width."""
FULLNESS = ("settle", "drop", "drop, ruin", "clear, ruin", "spread", "guided")
"""Rows where it is about fullness: baselines with and without taking objects away, and who always does."""
_CROWDS = {20: None, 30: None, 40: 10}
"""Objects, and attempts of a scene for each of them where that is not what every row has."""
_APART = 0.04


def table_sizes(*sizes: str) -> tuple[str, ...]:
    """Names of cuboid tables whose whole top is the queried region."""
    return tuple(f"table-{size}" for size in sizes)


@lru_cache
def filled_table(fill: float, pool: str = ALL, num_objects: int = _FILL_OBJECTS) -> str:
    """The cuboid table that so many objects of a pool fill on average, its sides in whole centimetres.

    Args:
      fill: the sum of footprints (boxes seen from above) over the area of the top.
    """
    footprints = [
        4 * asset.half_extents[0] * asset.half_extents[1] for asset in find_pool(pool).objects
    ]
    area = num_objects * float(np.mean(footprints)) / fill
    width = np.sqrt(area * _SIDES[0] / _SIDES[1])
    # The other side makes up for what rounding the first one lost.
    width = round(width, 2)
    return table_sizes(f"{width:.2f}x{area / width:.2f}")[0]


def trials(scale: Scale) -> tuple[Trial, ...]:
    """All methods on tables of six sizes, then those that fill a table on tables filled by so much."""
    base = scale.trial(256, 8)
    names = (*ALL_METHODS, "drop, ruin", "clear, ruin")
    ladder = grid(base, pool=scale.pools_or("dining"), support=table_sizes(*SIZES, _NARROW))
    filled = [
        base.replace(pool=ALL, num_objects=_FILL_OBJECTS, support=filled_table(fill))
        for fill in FILLS
    ]
    rows = (*named_rows(ladder, *names), *named_rows(filled, *FULLNESS))
    return with_seeds(rows, OURS, scale.seeds)


def crowds(scale: Scale) -> tuple[Trial, ...]:
    """More and more objects on the paper's table; fewest of them also in random order, nothing taken away."""
    base = scale.trial(256, 4, pool=ALL)
    bases = [
        base.replace(num_objects=n, budget=times and times * n) for n, times in _CROWDS.items()
    ]
    plain = [
        f"{name}, random order{tidy}" for name in ("spread", "guided") for tidy in ("", ", tidy")
    ]
    rows = (*named_rows(bases[:1], *FULLNESS, *plain), *named_rows(bases[1:], *FULLNESS))
    return with_seeds(rows, OURS, scale.seeds)


FILL_NOTE = (
    "fill: the sum of the objects' footprints (boxes from above) over the region's area, on average"
)


def tables(result: Result) -> list[Table]:
    """Success and cost, by rung."""
    made = made_rows(result["records"])
    has_seeds = any(row["trial"]["training_seed"] for row in made)
    columns = (
        *request_columns("pool"),
        Column("rung", _rung),
        FILL,
        *request_columns("method"),
        *(request_columns(training_seed="training seed") if has_seeds else ()),
        SUCCESS,
        *EFFORT,
        SPEED,
    )
    notes = (
        "n: the objects of a scene; 5 n attempts a scene unless the rung says otherwise, cut off as soon as "
        "they can no longer succeed; what overhangs can fall",
        FILL_NOTE,
        *EFFORT_NOTES,
        *RULES,
        *success_notes(made, _question),
        *dict.fromkeys(missing(row) for row in result["records"] if "figures" not in row),
    )
    return [table_of(result["title"] + margin_of(made), columns, made, notes)]


def _question(row: Row) -> str:
    return f"{row['trial']['pool']}, {_rung(row)}"


def _rung(row: Row) -> str:
    """A row's table, or its number of objects, or both."""
    trial = trial_of(row)
    size = trial.support.removeprefix("table-")
    objects = f"{trial.num_objects} objects"
    if trial.spec.budget:
        objects += f", {trial.spec.budget // trial.num_objects} n attempts"
    if size == "table":
        return objects
    return f"{size} m" if trial.pool != ALL else f"{objects}, {size} m"


def plot(rows: list[Row], stem: Path) -> list[str]:
    """Strict success, a panel for each pool and in it a line for each method.

    Methods that stand on one rung of several are in the table only; of several training seeds, the first is
    drawn.
    """
    rows = [row for row in rows if not row["trial"]["training_seed"]]
    pools = list(dict.fromkeys(row["trial"]["pool"] for row in rows))
    panels = [[row for row in rows if row["trial"]["pool"] == pool] for pool in pools]
    rungs = [list(dict.fromkeys(map(_rung, panel))) for panel in panels]
    figure = new_figure(PAGE, 3.2)
    axes = figure.subplots(
        1, len(pools), sharey=True, squeeze=False, width_ratios=list(map(len, rungs))
    )[0]
    for axis, pool, panel, places in zip(axes, pools, panels, rungs, strict=True):
        _panel(axis, panel, places)
        trials = sorted({row["figures"]["trials"] for row in panel})
        number = f"{' or '.join(f'{each:,}' for each in trials)} scenes a point, 95 % intervals"
        title = f"{pool}: {number}" if len(pools) > 1 else number
        prepare(axis, title, "", "success rate" if axis is axes[0] else "")
        # Short enough to stand side by side.
        labels = [rung.replace(", ", "\n").replace("x", " x\n", 1) for rung in places]
        axis.set_xticks(range(len(places)), labels, fontsize=6)
    add_legend(figure)
    return save(figure, stem)


def _panel(axis: Any, rows: list[Row], rungs: list[str]) -> None:
    rungs_of = {
        name: {_rung(row) for row in rows if name_of(row) == name} for name in map(name_of, rows)
    }
    names = [name for name, own in rungs_of.items() if len(own) > 1 or len(rungs) == 1]
    for turn, name in enumerate(names):
        some = [row for row in rows if name_of(row) == name]
        # Side by side, so that equal rates do not hide one another.
        shift = _APART * (turn - (len(names) - 1) / 2)
        plot_shares(
            axis,
            name,
            [rungs.index(_rung(row)) + shift for row in some],
            [row["figures"]["num_success"] for row in some],
            [row["figures"]["trials"] for row in some],
        )


DENSITY = Study(
    "density",
    "Tables of exactly the region's size: ten objects, then twenty of `all` by fill",
    256,
    trials,
    make_tables=tables,
    plot=plot,
    question=_question,
)
CROWDS = replace(
    DENSITY, name="crowds", title="Objects of the pool `all` on 0.60 x 0.70 m", trials=crowds
)
