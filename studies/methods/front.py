"""Methods as `generate` runs them, where they differ and where not: the table that README leads with."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from cluttergen_jax.assets.pool import ALL
from cluttergen_jax.evaluation.comparison import SPEED, SUCCESS, figure_column, request_columns
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.resolved import VARIANT_POOLS
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.spec import SceneSpec
from studies.cells import COST, FILL
from studies.methods.density import FILL_NOTE
from studies.rankings import success_notes
from studies.results import made_rows
from studies.study import Scale, Study

METHODS = ("random", "settle", "clear", "drop", "spread", "guided")
HELD_OUT = next(iter(VARIANT_POOLS))
CASES: tuple[tuple[str, str, int], ...] = (
    (ALL, "table", 20),
    (ALL, "table", 30),
    (ALL, "table-0.40x0.50", 20),
    ("dining", "table-0.30x0.40", 10),
    ("dining", "table-0.22x0.30", 10),
    (HELD_OUT, "table-0.50x0.60", 20),
    ("kitchen", "table", 10),
    ("office", "table", 10),
    ("dining", "table", 10),
)
"""Pool, support and objects of a scene: those first in which methods differ."""


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Every method in every case, by the rules of `generate`."""
    rows = [
        SceneSpec(pool=pool, support=support, num_objects=number, method=method)
        for pool, support, number in CASES
        if not scale.pools or pool in scale.pools
        for method in METHODS
    ]
    base = scale.trial(128, 4)
    return tuple(replace(base, spec=spec) for spec in rows[: scale.values(None, len(METHODS))])


def case_of(row: Row) -> str:
    """The question that a row asks of all methods alike."""
    trial = row["trial"]
    return _case(trial["pool"], trial["support"], trial["num_objects"])


def _case(pool: str, support: str, number: int) -> str:
    size = support.removeprefix("table-").replace("x", " x ")
    return f"{number} of {pool} on {'0.60 x 0.70' if size == 'table' else size} m"


SHORT = tuple(_case(*CASES[place]) for place in (1, 2, 4, 6))
"""The cases that README shows."""


def _notes(rows: list[Row]) -> Iterable[str]:
    return [
        "each method by its own rules, as `generate` has them; the support margin is 3 mm in every row",
        FILL_NOTE,
        *success_notes(made_rows(rows), case_of),
    ]


FRONT = Study(
    "front",
    "Methods as `generate` runs them",
    128,
    trials,
    (
        *request_columns("pool", support="table", num_objects="objects", method="method"),
        FILL,
        SUCCESS,
        figure_column("placed", "placed", 2),
        *COST,
        SPEED,
    ),
    _notes,
    question=case_of,
)
