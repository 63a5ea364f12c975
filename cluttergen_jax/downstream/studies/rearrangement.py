"""The study `rearrangement`: an arm brings objects into layouts that the generator draws, and what helps."""

from __future__ import annotations

from typing import Any

import numpy as np

from cluttergen_jax.downstream.placer.evaluation.tables import Row, with_interval
from cluttergen_jax.downstream.rearrange.api import rearrange
from cluttergen_jax.downstream.rearrange.task import SETTINGS
from cluttergen_jax.downstream.rearrange.trials import Rearrangements
from cluttergen_jax.downstream.robot.trials import EPISODES
from cluttergen_jax.downstream.studies.robot import causes_of, told
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.proportions import proportion
from cluttergen_jax.tables import Table

OBSERVERS = ("true", "perception")
ABLATIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("all of it", {}),
    ("looks only once", {"relook": False}),
    ("lowest object first, as the paper", {"order": "lowest"}),
    ("one grasp an object, as the paper", {"one_grasp": True}),
    ("one layout, no choice", {"num_layouts": 1}),
)
ABLATED = ("paper", "blocked")
_EPISODES, _QUICK_EPISODES = 100, 1
_COLUMNS = (
    *("setting", "seen by", "success", "objects right", "failures"),
    *("picks", "fewest", "waits", "looks", "path m", "s", "CPU-s"),
)
_NOTES = (
    "success: every object within 15 mm and 10 degrees (up to symmetry) of the chosen layout, nothing else "
    "disturbed, and all stands (docs/contract.md)",
    "seen by `true`: the true poses; `perception`: two noisy cameras and this project's own segmenter",
    "picks and the fewest that could do, times that an object had to wait elsewhere, looks at all objects, "
    "the tool's path, simulated and computing seconds: means of an episode",
    "by cameras the hand may brush what it has let go until it has left it; told the true poses it may not",
    "the paper's robot in its setting: 7 of 10",
)


def run(suite: SuiteFolder) -> Found:
    """Every setting with the true poses and as cameras see it."""
    settings = list(SETTINGS)[: 1 if suite.scale.quick else None]
    asked = [{"setting": setting, "observer": observer} for setting in settings for observer in OBSERVERS]
    rows = [_row(suite, each) for each in asked]
    return Found(rows, [_table("Objects brought into a new layout", rows)])


def run_ablations(suite: SuiteFolder) -> Found:
    """One thing taken away at a time."""
    rows, tables = [], []
    for setting in ABLATED[: 1 if suite.scale.quick else None]:
        for observer in OBSERVERS[: 1 if suite.scale.quick else None]:
            found = [
                _row(suite, {"setting": setting, "observer": observer, **changed}, title)
                for title, changed in ABLATIONS[: 2 if suite.scale.quick else None]
            ]
            rows += found
            tables.append(_table(f"Setting `{setting}`, seen by `{observer}`", found))
    return Found(rows, tables)


def _row(suite: SuiteFolder, asked: dict[str, Any], title: str | None = None) -> Row:
    number, seed = suite.scale.scenes(_EPISODES, _QUICK_EPISODES), suite.scale.seed
    changed = [f"{name}-{value}" for name, value in asked.items() if name not in ("setting", "observer")]
    out = suite.folder / "episodes" / "-".join([f"rearrange-{seed}", asked["observer"], *changed])
    if suite.fresh:
        (out / asked["setting"] / EPISODES).unlink(missing_ok=True)
    found = rearrange(out, num_episodes=number, seed=seed, num_threads=suite.num_threads, **asked)
    return row_of({**asked, "row": title or asked["setting"]}, found)


def row_of(asked: dict[str, Any], found: Rearrangements) -> Row:
    """What became of the episodes of one row."""
    rows = found.rows
    names = ("picks", "fewest", "waits", "looks", "path", "seconds", "cpu")
    figures = {
        "success": proportion(np.array([row.is_success for row in rows])),
        "right": proportion(np.array([each for row in rows for each in row.right])),
        "causes": causes_of(row.outcome for row in rows if not row.is_success),
        **{name: float(np.mean([getattr(row, name) for row in rows])) for name in names},
    }
    return {"trial": {**asked, "episodes": len(rows)}, "figures": figures}


def _table(title: str, rows: list[Row]) -> Table:
    cells = []
    for row in rows:
        asked, figures = row["trial"], row["figures"]
        means = [f"{figures[name]:.1f}" for name in ("picks", "fewest", "waits", "looks", "path")]
        cells.append(
            (
                asked["row"],
                asked["observer"],
                with_interval(figures["success"]),
                with_interval(figures["right"]),
                told(figures["causes"]),
                *means,
                f"{figures['seconds']:.0f}",
                f"{figures['cpu']:.1f}",
            )
        )
    return Table(title, _COLUMNS, tuple(cells), _NOTES)


REARRANGEMENT = DownstreamStudy("rearrangement", "An arm rearranges objects", run, True)
REARRANGEMENT_ABLATIONS = DownstreamStudy(
    "rearrangement-ablations", "What helps the arm to rearrange objects", run_ablations, True
)
