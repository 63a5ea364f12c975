"""Table 1 with the paper's own objects, as far as they were imported."""

from __future__ import annotations

from cluttergen_jax.evaluation.studies.study import Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import tables
from cluttergen_jax.evaluation.trial import Trial


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The full method on the paper's own groups."""
    base = scale.counted_twice(1000, 6)
    return tuple(
        trial
        for pool, number in scale.imported
        if pool in scale.chosen(pool)
        for trial in grid(base, pool=(pool,), num_objects=(number,), method=("random", "policy"))
    )


IMPORTED_GROUPS = Study("imported", "The same with the paper's own objects", 1000, trials, tables)
