"""The study `cameras`: the same queries seen by one camera, two and four, their maps fused."""

from __future__ import annotations

from cluttergen_jax.downstream.placer.evaluation.tables import cell
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import Variant, grouped, rows_of, table_of
from cluttergen_jax.tables import Table

PLACERS = ("geometry", "geometry-occupied", "scored")
NUMBERS = (1, 2, 4)
_NOTE = (
    "cameras: the first is that of the query, the others stand elsewhere around the table; the highest that "
    "any has seen, and the lowest from which on one has seen that all is empty"
)


def run(suite: SuiteFolder) -> Found:
    """Placers by number of cameras."""
    quick = suite.scale.quick
    placers, numbers = (PLACERS[1:2], NUMBERS[:2]) if quick else (PLACERS, NUMBERS)
    pairs, rows = suite.test_set(), []
    for number in numbers:
        variants = [Variant({"placer": name, "cameras": str(number)}, name) for name in placers]
        rows += rows_of(suite.trials(pairs, num_cameras=number), variants, suite.scale.noises)
    main = table_of(f"{rows[0]['trial']['queries']} queries of household", rows, (_NOTE,))
    return Found(rows, [main, _unseen(rows)])


def _unseen(rows: list) -> Table:
    """How much of the region nobody saw."""
    told = {}
    for (row,) in grouped(rows):
        told[row["variant"]["cameras"], f"{row['trial']['noise']:g}"] = cell(row["figures"]["unseen"])
    cells = tuple((*key, share) for key, share in told.items())
    return Table("Share of the region unseen, mean", ("cameras", "noise", "unseen"), cells)


CAMERAS = DownstreamStudy("cameras", "Stable placement seen by several cameras", run)
