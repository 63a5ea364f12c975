"""Studies of placers as they come: on several sets of queries, by noise, and by number of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cluttergen_jax.downstream.placer.evaluate import (
    PlacerComparison,
    PlacerTrials,
    cell,
    chain_table,
    compare_placers,
    tables_of,
)
from cluttergen_jax.downstream.placer.proposers import BASELINES, FULL_STATE
from cluttergen_jax.downstream.placer.scored import embedded_placers
from cluttergen_jax.tables import Table
from studies.downstream.suite_folder import NOISES, SETS, PlacementSet, SuiteFolder
from studies.downstream.trained import Variant, group_by_seed, rows_of, table_of
from studies.study import Findings, Study


def _compare_sets(suite: SuiteFolder, sets: Sequence[PlacementSet], stem: Path) -> Findings:
    """All sets, the first told in full, of the others the main table."""
    return found_of(
        [_compare(suite.trials(suite.test_set(one)), suite.scale.quick) for one in sets]
    )


def found_of(comparisons: list[PlacerComparison]) -> Findings:
    """Comparisons on several sets as one study."""
    tables = [*comparisons[0].tables, *(each.tables[0] for each in comparisons[1:])]
    return Findings([row for each in comparisons for row in each.rows], tables=tables)


def _compare(trials: PlacerTrials, quick: bool) -> PlacerComparison:
    """Baselines with and without noise; what sees the scene itself, once."""
    placers = ("random", "geometry") if quick else (*BASELINES, *embedded_placers())
    seen = compare_placers(trials, placers, NOISES, None)
    if quick:
        return seen
    rows = [*seen.rows, *compare_placers(trials, FULL_STATE, (0.0,), None).rows]
    return PlacerComparison(rows, tables_of(rows))


PLACEMENT = Study(
    "placement",
    "Stable placement from one camera's view",
    1,
    lambda scale: scale.sets(*SETS),
    measure=_compare_sets,
    brings_tables=True,
)

LADDER = (0.0, 0.5, 1.0, 2.0, 4.0)
_CHAINS = 256
_QUICK_CHAINS = 2


def _compare_noises(suite: SuiteFolder, placers: Sequence[str], stem: Path) -> Findings:
    """Queries at each level; chains without noise and with that of a usual camera."""
    noises = (0.0, 2.0) if suite.scale.quick else LADDER
    found = compare_placers(suite.trials(suite.test_set()), placers, noises, None)
    # Of these scenes the chains need the objects and their order, and no queries.
    number = suite.scale.number(_CHAINS, _QUICK_CHAINS)
    trials = suite.trials(suite.test_set(num_scenes=number, num_pairs=1))
    asked = [(placer, noise) for noise in NOISES for placer in placers]
    chains = [row for each in asked if (row := trials.chain(*each, number)) is not None]
    rows = found.rows + [{"trial": row["trial"], "figures": row} for row in chains]
    return Findings(rows, tables=[found.tables[0], *found.tables[2:4], chain_table(chains)])


NOISE = Study(
    "noise",
    "Stable placement by how noisy the camera is",
    1,
    lambda scale: ("geometry-occupied", "scored")[: 1 if scale.quick else None],
    measure=_compare_noises,
    brings_tables=True,
)

_CAMERAS_NOTE = (
    "cameras: the first is that of the query, the others stand elsewhere around the table; the highest that "
    "any has seen, and the lowest from which on one has seen that all is empty"
)


def _compare_cameras(suite: SuiteFolder, numbers: Sequence[int], stem: Path) -> Findings:
    """The same queries seen by one camera, two and four, their maps fused."""
    placers = ("geometry", "geometry-occupied", "scored")[
        slice(1, 2) if suite.scale.quick else slice(None)
    ]
    pairs = suite.test_set()
    rows = []
    for number in numbers:
        variants = [Variant({"placer": name, "cameras": str(number)}, name) for name in placers]
        rows += rows_of(suite.trials(pairs, num_cameras=number), variants, suite.scale.noises)
    main = table_of(f"{rows[0]['trial']['queries']} queries of household", rows, (_CAMERAS_NOTE,))
    # How much of the region nobody saw.
    unseen = {
        (row["variant"]["cameras"], f"{row['trial']['noise']:g}"): cell(row["figures"]["unseen"])
        for (row,) in group_by_seed(rows)
    }
    cells = tuple((*key, share) for key, share in unseen.items())
    second = Table("Share of the region unseen, mean", ("cameras", "noise", "unseen"), cells)
    return Findings(rows, tables=[main, second])


CAMERAS = Study(
    "cameras",
    "Stable placement seen by several cameras",
    1,
    lambda scale: (1, 2, 4)[: 2 if scale.quick else None],
    measure=_compare_cameras,
    brings_tables=True,
)
