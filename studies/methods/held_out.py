"""Objects that no network was trained on: held-out families of the modeller, and imported groups."""

from __future__ import annotations

from collections.abc import Iterator

from cluttergen_jax.evaluation.comparison import SUCCESS, name_of, request_columns
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import FIRST_SEED, NUM_VARIANTS, VARIANT_POOLS
from cluttergen_jax.evaluation.trial import Trial, grid
from studies.cells import EFFORT, EFFORT_NOTES, FILL
from studies.methods.density import FILL_NOTE, table_sizes
from studies.rankings import OURS, success_notes
from studies.results import made_rows
from studies.rules import RULES, named_rows, with_seeds
from studies.study import Scale, Study

ROWS = ("guided", "spread", "drop, ruin", "settle")
OBJECTS = 20
HELD_OUT, SEEN = VARIANT_POOLS


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Held-out families, families of training in fresh shapes, and imported groups merged, if at hand."""
    base = scale.trial(256, 4, num_objects=OBJECTS, support=table_sizes("0.50x0.60")[0])
    bases = list(grid(base, pool=VARIANT_POOLS))
    if scale.imported:
        pool = "+".join(name for name, _ in scale.imported)
        num_objects = min(OBJECTS, sum(number for _, number in scale.imported))
        bases.append(base.replace(pool=pool, num_objects=num_objects))
    return with_seeds(named_rows(bases, *ROWS), OURS, scale.seeds)


def _pool_of(row: Row) -> str:
    return str(row["trial"]["pool"])


def _notes(rows: list[Row]) -> list[str]:
    made = made_rows(rows)
    return [
        f"`{HELD_OUT}`: {NUM_VARIANTS} shapes of {len(VARIANT_POOLS[HELD_OUT])} families that no network is "
        f"trained on; `{SEEN}`: {NUM_VARIANTS} shapes, from seed {FIRST_SEED} on, of families that it is "
        "trained on; other pools are imported objects, which nothing is trained on",
        FILL_NOTE,
        *EFFORT_NOTES,
        *RULES,
        *success_notes(made, _pool_of),
        *_differences(made),
    ]


def _differences(made: list[Row]) -> Iterator[str]:
    """Success on every unseen pool less that on the seen one, for each method."""
    success = {(name_of(row), _pool_of(row)): row["figures"]["success"] for row in reversed(made)}
    pools = [pool for pool in dict.fromkeys(map(_pool_of, made)) if pool != SEEN]
    for name in ROWS:
        for pool in pools:
            if {(name, pool), (name, SEEN)} <= success.keys():
                difference = success[name, pool] - success[name, SEEN]
                yield f"success of `{name}` on {pool} less that on {SEEN}: {difference:+.3f}"


HELD_OUT_OBJECTS = Study(
    "unseen",
    "Twenty objects on 0.50 x 0.60 m that no network was trained on",
    256,
    trials,
    (
        *request_columns(
            "pool", num_objects="objects", method="method", training_seed="training seed"
        ),
        FILL,
        SUCCESS,
        *EFFORT,
    ),
    _notes,
    says_margin=True,
    question=_pool_of,
)
