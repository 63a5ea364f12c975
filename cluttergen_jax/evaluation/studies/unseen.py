"""Objects never seen in training: whole families of the modeller that were held out, and imported groups."""

from __future__ import annotations

from dataclasses import replace

from cluttergen_jax.evaluation.cells import (
    EFFORT,
    EFFORT_NOTES,
    Column,
    Row,
    asked,
    number,
    share_of,
    table_of,
)
from cluttergen_jax.evaluation.rivals import OURS, success_notes
from cluttergen_jax.evaluation.studies.density import table_sizes
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, named_rows, with_seeds
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.trial import Trial, row_name
from cluttergen_jax.evaluation.variant_pools import FIRST_SEED, NUM_VARIANTS, VARIANT_POOLS
from cluttergen_jax.tables import Table

ROWS = ("guided", "spread", "drop, ruin")
OBJECTS = 20
HELD_OUT, SEEN = VARIANT_POOLS


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Held-out families, families of training in fresh shapes, and imported groups merged, if at hand."""
    base = scale.trial(256, 4, num_objects=OBJECTS, support=table_sizes("0.50x0.60")[0])
    bases = [*grid(base, pool=VARIANT_POOLS), *_imported(base, scale.imported)]
    return with_seeds(named_rows(bases, *ROWS), OURS, scale.seeds)


def _imported(base: Trial, imported: tuple[tuple[str, int], ...]) -> list[Trial]:
    if not imported:
        return []
    pool = "+".join(name for name, _ in imported)
    return [replace(base, pool=pool, num_objects=min(OBJECTS, sum(number for _, number in imported)))]


def tables(result: Result) -> list[Table]:
    """Success and cost of every pool."""
    rows = result["records"]
    columns = (
        *asked("pool", num_objects="objects"),
        *asked("method", training_seed="training seed"),
        Column("fill", lambda row: number(row["figures"].get("fill"), 2)),
        Column("success [95 %]", lambda row: share_of(row["figures"])),
        *EFFORT,
    )
    made = [row for row in rows if "figures" in row]
    notes = (
        f"`{HELD_OUT}`: {NUM_VARIANTS} shapes of {len(VARIANT_POOLS[HELD_OUT])} families that no network is "
        f"trained on; `{SEEN}`: {NUM_VARIANTS} shapes, from seed {FIRST_SEED} on, of families that it is "
        "trained on; other pools are imported objects, which nothing is trained on",
        "fill: the sum of the objects' footprints (boxes from above) over the region's area, on average",
        *EFFORT_NOTES,
        *RULES,
        *success_notes(made, lambda row: row["trial"]["pool"]),
        *_differences(made),
    )
    return [table_of(result["title"] + margin_of(made), columns, rows, notes)]


def _differences(made: list[Row]) -> list[str]:
    """Success on every unseen pool less that on the seen one, for each method."""
    success = {
        (row_name(row["trial"]), row["trial"]["pool"]): row["figures"]["success"] for row in reversed(made)
    }
    pools = [pool for pool in dict.fromkeys(row["trial"]["pool"] for row in made) if pool != SEEN]
    return [
        f"success of `{name}` on {pool} less that on {SEEN}: {value - success[name, SEEN]:+.3f}"
        for name in ROWS
        for pool in pools
        if (value := success.get((name, pool))) is not None and (name, SEEN) in success
    ]


UNSEEN = Study(
    "unseen",
    "Twenty objects on 0.50 x 0.60 m that no network was trained on",
    256,
    trials,
    tables,
    question=lambda row: row["trial"]["pool"],
)
