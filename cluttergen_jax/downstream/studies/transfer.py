"""The study `transfer`: a placer on objects, tables and cameras that it has not learned from."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.downstream.placer.heads.checkpoint import embedded_placers
from cluttergen_jax.downstream.studies.study import (
    HOUSEHOLD,
    SETS,
    DownstreamStudy,
    Found,
    PlacementSet,
    SuiteFolder,
)
from cluttergen_jax.downstream.studies.trained import Variant, household_placers, rows_of, table_of

PAIRS = 5000
CAMERAS = (
    PlacementSet("overhead", HOUSEHOLD.pool, camera="overhead"),
    PlacementSet("side", HOUSEHOLD.pool, camera="side"),
)
_NOTES = (
    "scored: learned from household alone, on one table, seen by cameras around it, 25 to 65 degrees up; the "
    "sets differ from that in what stands under `new`",
    "scored, all pools: the placer of the package, which learned from household and from all pools together, "
    "on the same table; of dining, kitchen, office and study nothing but the scenes is new to it",
    "overhead: straight down, where nothing hides anything; side: the paper's camera, always in one place",
)


def run(suite: SuiteFolder) -> Found:
    """Rows on all sets but household as it was learned from."""
    scale = suite.scale
    size = scale.capped(PAIRS)
    runs = household_placers(suite, "scored", size, suite.household())
    sets = [one for one in (*SETS[1:], *CAMERAS) if not scale.pools or one.pool in scale.pools]
    rows = []
    for one in sets[: 1 if scale.quick else None]:
        labels = {"set": one.name, "new": new_there(one)}
        placers: dict[str, dict[int, Path] | str] = {"scored": runs, "geometry-occupied": "geometry-occupied"}
        placers |= {f"{name}, all pools": name for name in embedded_placers()}
        variants = [Variant(labels | {"placer": name}, each) for name, each in placers.items()]
        rows += rows_of(suite.trials(suite.test_set(one)), variants, scale.noises)
    queries = sorted({row["trial"]["queries"] for row in rows})
    title = f"{' or '.join(f'{each:,}' for each in queries)} queries a set, learned from {size:,} pairs"
    return Found(rows, [table_of(title, rows, _NOTES)])


def new_there(asked: PlacementSet) -> str:
    """What of a set the placer has not learned from, its scenes aside."""
    differs = {
        "objects": asked.pool != HOUSEHOLD.pool,
        "table": asked.support != HOUSEHOLD.support,
        "camera": asked.camera != HOUSEHOLD.camera,
    }
    return ", ".join(name for name, is_new in differs.items() if is_new)


TRANSFER = DownstreamStudy("transfer", "Objects, tables and cameras that a placer has not learned from", run)
