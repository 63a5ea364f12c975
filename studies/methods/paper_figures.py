"""The paper's figures of success: by objects (1a), by steps of each attempt, by attempts, and in training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.evaluation.comparison import (
    Column,
    request_columns,
    share,
)
from cluttergen_jax.evaluation.records import Row, Spread
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.learning.training.suite import DEFAULT_ATTEMPTS, TABLE_ATTEMPTS
from cluttergen_jax.placement.methods.table import BASELINES
from cluttergen_jax.plots import PAGE, colour, grid_of_panels, mark, prepare, save
from studies.cells import BOTH, LOOSE, STEPS, STRICT, columns_of, mean_and_spread
from studies.methods import table1
from studies.methods.table1 import CLUTTERGEN, first_seed
from studies.plots import PAPERS, add_legend, label_of, plot_shares
from studies.results import made_rows
from studies.study import Findings, Scale, Study, of_methods


def _plot_by_pool(
    rows: list[Row],
    stem: Path,
    draw: Callable[[Any, str, list[Row]], None],
    x: str,
    y: str,
    papers: Callable[[Any], None] | None = None,
) -> list[str]:
    """A panel for each pool, drawn by `draw` from the pool's rows; `x` and `y` label the axes.

    Args:
      papers: draws what the paper shows of no pool in particular, in a panel of its own.
    """
    pools = list(dict.fromkeys(row["trial"]["pool"] for row in rows))
    figure, axes = grid_of_panels(len(pools) + (papers is not None), 3, PAGE / 3, 2.0)
    for axis, pool in zip(axes, pools, strict=False):
        draw(axis, pool, [row for row in rows if row["trial"]["pool"] == pool])
        prepare(axis, pool, x, y)
    if papers is not None:
        papers(axes[-1])
        prepare(axes[-1], "the paper, read off its picture", x, y)
    add_legend(figure, "outside lower center", 3)
    return save(figure, stem)


def _plot_papers(axis: Any, values: Sequence[float], name: str, marker: str) -> None:
    x = range(1, len(values) + 1)
    label = f"{name}, the paper"
    style = {"color": PAPERS, "linewidth": 0.9, "linestyle": ":", "markersize": 3.5}
    axis.plot(x, values, marker=marker, label=label, **style)


# Figure 1a: success against the number of objects.

OBJECTS_PAPER = {
    "ClutterGen": (0.99, 1.0, 1.0, 0.99, 0.98, 0.99, 0.96, 0.94, 0.94, 0.87),
    "RRS": (0.73, 0.49, 0.25, 0.22, 0.08, 0.03, 0.0, 0.0, 0.0, 0.0),
}
"""The paper's success with 1, 2, ... objects, read off its picture; RRS is its `random`."""
_MARKS = {"ClutterGen": "X", "RRS": "o"}


def at_least(histogram: Sequence[int]) -> list[float]:
    """Shares of episodes in which at least 1, 2, ... objects were placed, from how many placed 0, 1, ...

    An episode of n objects is the beginning of one of more: the order is uniform, and no method is told how
    many are to come.
    """
    total = sum(histogram)
    return [sum(histogram[number:]) / total for number in range(1, len(histogram))]


def _most_objects(rows: list[Row]) -> int:
    return max((len(row["figures"]["placed_histogram"]) - 1 for row in made_rows(rows)), default=1)


def _with_papers_objects(rows: list[Row]) -> list[Row]:
    known = [name for name, shares in OBJECTS_PAPER.items() if _most_objects(rows) <= len(shares)]
    return [*rows, *(Row(pool="the paper's", method=name) for name in known)]


def _objects_columns(rows: list[Row]) -> tuple[Column, ...]:
    """A column for each number of objects."""

    def cell(row: Row, number: int) -> str:
        theirs = OBJECTS_PAPER.get(row.get("method", ""))
        return share((theirs or at_least(row["figures"]["paper"]["placed_histogram"]))[number - 1])

    numbers = range(1, _most_objects(rows) + 1)
    return (
        *request_columns("pool", "method"),
        *columns_of(numbers, lambda number: f"n = {number}", cell),
    )


def _plot_fig1a(rows: list[Row], stem: Path) -> list[str]:
    """The strict count, and with empty marks the paper's; 95 % intervals."""

    def draw(axis: Any, pool: str, rows: list[Row]) -> None:
        for row in rows:
            method = row["trial"]["method"]
            figures = row["figures"]
            for source, is_hollow in ((figures["paper"], True), (figures, False)):
                histogram = source["placed_histogram"]
                placed = [sum(histogram[number:]) for number in range(1, len(histogram))]
                count = "the paper's count" if is_hollow else "strict"
                label = f"{label_of(method)}, {count}"
                x = range(1, len(histogram))
                trials = [sum(histogram)] * len(placed)
                plot_shares(axis, method, x, placed, trials, is_hollow, label)

    def papers(axis: Any) -> None:
        for name, theirs in OBJECTS_PAPER.items():
            _plot_papers(axis, theirs, name, _MARKS[name])
        axis.set_ylim(-0.03, 1.03)

    return _plot_by_pool(rows, stem, draw, "objects", "success rate", papers)


FIG1A = Study(
    "fig1a",
    "Success against the number of objects (figure 1a)",
    1000,
    lambda scale: of_methods(first_seed(scale), "random", CLUTTERGEN, "policy"),
    _objects_columns,
    (
        LOOSE,
        "an episode of n objects is the beginning of one of ten: orders are uniform, and no method is told "
        "how many are to come",
        "strict in the plot: but for the last check; intervals of 95 %; the paper's values were read off its "
        "picture, which does not say of which group they are",
    ),
    prepare=_with_papers_objects,
    plot=_plot_fig1a,
)

# Steps of the first attempt, the second and so on, at objects that took at least three.

STEPS_PAPER = {
    "dining": (88, 91, 84, 60, 50),
    "study": (113, 107, 100, 64, 44),
    "office": (118, 118, 92, 66, 51),
    "kitchen": (106, 85, 49, 48, 60),
    "household": (136, 102, 120, 98, 34),
}
"""The paper's mean steps of attempts 1 to 5 by the pool that stands for its group, read off its picture."""
_FEWEST = 20
"""Attempts behind a point of the plot."""


def _with_papers_steps(rows: list[Row]) -> list[Row]:
    lines: list[Row] = []
    for pool in dict.fromkeys(row["trial"]["pool"] for row in rows):
        lines += [row for row in rows if row["trial"]["pool"] == pool]
        lines += [Row(pool=pool, method="ClutterGen, the paper")] if pool in STEPS_PAPER else []
    return lines


def _steps_columns(rows: list[Row]) -> tuple[Column, ...]:
    """Mean steps, a column for each attempt."""

    def cell(row: Row, attempt: int) -> str:
        if "trial" in row:
            return mean_and_spread(_steps(row).get(attempt, {"mean": None}))
        theirs = STEPS_PAPER[row["pool"]]
        return str(theirs[attempt - 1]) if attempt <= len(theirs) else "-"

    def placements(row: Row) -> str:
        return str(_steps(row).get(1, {"count": 0})["count"]) if "trial" in row else "-"

    most = max((row["trial"]["attempts"] for row in rows if "trial" in row), default=0)
    return (
        *request_columns("pool", "method"),
        Column("placements", placements),
        *columns_of(range(1, most + 1), lambda attempt: f"attempt {attempt}", cell),
    )


def _steps_notes(rows: list[Row]) -> list[str]:
    return [
        LOOSE,
        "objects that stood in the end and took at least three attempts; mean ± standard deviation; in the "
        f"plot 95 % intervals of means, points of {_FEWEST} attempts or more",
        "the paper's values were read off its picture; it takes their fall for a sign that its policy learns "
        "from failures within an episode",
        *_selection(rows),
    ]


def _selection(rows: list[Row]) -> list[str]:
    """What the row without a memory says of that fall, where its own steps fall."""
    falls = [
        f"{row['trial']['pool']} {steps[0]:.0f} to {steps[-1]:.0f}"
        for row in made_rows(rows)
        if row["trial"]["method"] == "random"
        if len(steps := [each["mean"] for each in _frequent(row)]) > 1
        if steps[-1] < steps[0]
    ]
    if not falls:
        return []
    return [
        f"`random`, which remembers nothing, falls in the same way ({', '.join(falls)}): what stands in the "
        "end had a last attempt that went well, so the fall is selection, and no sign of learning"
    ]


def _steps(row: Row) -> dict[int, Spread]:
    """The spreads of steps by attempt, the paper's count."""
    return {each["attempt"]: each for each in row["figures"]["paper"]["steps_by_attempt"]}


def _frequent(row: Row) -> list[Spread]:
    return [each for each in _steps(row).values() if each["count"] >= _FEWEST]


def _mark_size(number: int) -> float:
    """Points, of a mark behind which there are so many attempts."""
    return 2.5 * np.log10(number) - 1.5


def _plot_steps(rows: list[Row], stem: Path) -> list[str]:
    """Mean steps of each attempt with their 95 % intervals; the larger a mark, the more are behind it."""

    def draw(axis: Any, pool: str, rows: list[Row]) -> None:
        for row in rows:
            if steps := _frequent(row):
                method = row["trial"]["method"]
                error = [1.96 * each["std"] / np.sqrt(each["count"]) for each in steps]
                x = [each["attempt"] for each in steps]
                y = [each["mean"] for each in steps]
                style = {"color": colour(method), "label": label_of(method), "linewidth": 1.0}
                axis.errorbar(
                    x, y, error, marker=mark(method), markersize=1, elinewidth=0.7, **style
                )
                sizes = [_mark_size(each["count"]) ** 2 for each in steps]
                axis.scatter(x, y, sizes, colour(method), mark(method), linewidths=0)
        if pool in STEPS_PAPER:
            _plot_papers(axis, STEPS_PAPER[pool], "ClutterGen", "X")
        axis.set_xticks(range(1, DEFAULT_ATTEMPTS + 1))
        axis.set_ylim(0, 250)
        for number in (_FEWEST, 200, 1000):
            style = {"color": PAPERS, "linestyle": "", "marker": "o"}
            axis.plot([], [], markersize=_mark_size(number), label=f"n = {number:,}", **style)

    return _plot_by_pool(rows, stem, draw, "attempt", "steps of 1/240 s")


STEPS_BY_ATTEMPT = Study(
    "steps_by_attempt",
    "Steps of each attempt at objects that took at least three",
    1000,
    first_seed,
    _steps_columns,
    _steps_notes,
    prepare=_with_papers_steps,
    plot=_plot_steps,
)

# Success against the attempts that an object is allowed.


def _by_attempts(scale: Scale) -> tuple[Trial, ...]:
    """Chance, the paper's method and ours, for each number of attempts.

    `train --suite paper` makes a `policy` for each of them; the paper's was trained with five.
    """
    base = scale.trial_by_both_counts(1000, 6)
    pools = scale.pools_or("dining")
    attempts = scale.values(TABLE_ATTEMPTS, (1, DEFAULT_ATTEMPTS))
    return grid(base, pool=pools, method=("random", CLUTTERGEN, "policy"), max_attempts=attempts)


def _trained_with(row: Row) -> str:
    return str((row.get("policy") or {}).get("max_attempts", "-"))


def _sort(rows: list[Row]) -> list[Row]:
    """Pool by pool and method by method, both as they come first, by attempts: rows may have been kept."""
    order = {
        name: list(dict.fromkeys(row["trial"][name] for row in rows)) for name in ("pool", "method")
    }

    def place(row: Row) -> tuple[int, ...]:
        return (
            *(known.index(row["trial"][name]) for name, known in order.items()),
            row["trial"]["attempts"],
        )

    return sorted(rows, key=place)


def _plot_attempts(rows: list[Row], stem: Path) -> list[str]:
    """Success by the paper's count, with 95 % intervals."""

    def draw(axis: Any, pool: str, rows: list[Row]) -> None:
        for method, some in groupby(_sort(rows), lambda row: row["trial"]["method"]):
            made = list(some)
            x = [row["trial"]["attempts"] for row in made]
            figures = [row["figures"]["paper"] for row in made]
            successes = [each["num_success"] for each in figures]
            plot_shares(axis, method, x, successes, [each["trials"] for each in figures])

    return _plot_by_pool(rows, stem, draw, "attempts per object", "success rate, paper's count")


ATTEMPTS = Study(
    "attempts",
    "Success against attempts allowed per object",
    1000,
    _by_attempts,
    (
        *request_columns("pool", "method", "attempts"),
        Column("trained with", _trained_with, is_asked=True),
        *BOTH,
        STEPS,
    ),
    (
        STRICT,
        LOOSE,
        "the paper: more attempts help up to 5; two or fewer hurt (a figure without numbers)",
    ),
    prepare=_sort,
    plot=_plot_attempts,
)

# Success against attempts of the training runs behind table 1.

# In the paper every group is above this success after so many attempts.
PAPER_ATTEMPTS = 2_300_000
PAPER_SUCCESS = 0.85


def _draw_curves(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Every run that left its progress; dots are evaluated by the last check."""
    folders = {trial: runner.checkpoints.run_folder(trial) for trial in trials}
    runs = {trial: folder for trial, folder in folders.items() if folder is not None}
    names = [
        f"{each.pool_name} {each.method} {each.training_seed}"
        for each in trials
        if each not in runs
    ]
    notes = (
        [f"without a training run (--checkpoints names their folder): {', '.join(names)}"]
        if names
        else []
    )
    if not runs:
        return Findings(notes=notes)
    pools = list(dict.fromkeys(trial.pool_name for trial in runs))
    figure, axes = grid_of_panels(len(pools), 3, PAGE / 3, 2.0)
    rows = [
        _draw_curve(axes[pools.index(trial.pool_name)], trial, folder)
        for trial, folder in runs.items()
    ]
    for axis, pool in zip(axes, pools, strict=True):
        prepare(axis, pool, "attempts (thousands)", "success rate while training")
        axis.set_ylim(0, 1.03)
    add_legend(figure, "outside lower center", 4)
    return Findings(rows, save(figure, stem), notes)


def _draw_curve(axis: Any, trial: Trial, folder: Path) -> Row:
    """Draws one run; where it ended."""
    progress, checked = (read_rows(folder / name) for name in ("progress.csv", "evaluations.csv"))
    label = label_of(trial.method) if trial.training_seed == 0 else None
    for rows, style in (
        (progress, {"linewidth": 1.0, "label": label}),
        (checked, {"marker": "o", "ls": ""}),
    ):
        x = [row["attempts"] / 1000 for row in rows]
        y = [row["success"] for row in rows]
        axis.plot(x, y, color=colour(trial.method), markersize=3, **style)
    return {
        "pool": trial.pool_name,
        "method": trial.method,
        "seed": trial.training_seed,
        "attempts": int(progress[-1]["attempts"]) if progress else 0,
        "success": progress[-1]["success"] if progress else None,
        "checked": checked[-1]["success"] if checked else None,
    }


def _written_at(runner: Runner, trial: Trial) -> int | None:
    """When the trial's run last wrote its progress, in nanoseconds."""
    run = runner.checkpoints.run_folder(trial)
    return None if run is None else (run / "progress.csv").stat().st_mtime_ns


LEARNING_CURVES = Study(
    "learning_curves",
    "Success while training",
    1000,
    lambda scale: tuple(trial for trial in table1.trials(scale) if trial.method not in BASELINES),
    (
        *request_columns("pool", "method", "seed"),
        Column("training attempts", lambda row: f"{row['attempts']:,}"),
        Column("success at the end, while training", lambda row: share(row["success"])),
        Column("by the last check", lambda row: share(row["checked"])),
    ),
    (f"the paper: above {PAPER_SUCCESS} after {PAPER_ATTEMPTS:,} attempts in every group",),
    _draw_curves,
    depends_on=_written_at,
)
