"""The study `placement`: baselines, placers that come with the package, and what sees the scene itself."""

from __future__ import annotations

from cluttergen_jax.downstream.placer.evaluation.evaluate import (
    PlacerComparison,
    PlacerTrials,
    compare_placers,
)
from cluttergen_jax.downstream.placer.evaluation.tables import tables_of
from cluttergen_jax.downstream.placer.heads.checkpoint import embedded_placers
from cluttergen_jax.downstream.placer.proposers import BASELINES, FULL_STATE
from cluttergen_jax.downstream.studies.study import NOISES, SETS, DownstreamStudy, Found, SuiteFolder


def run(suite: SuiteFolder) -> Found:
    """All sets, the first told in full, of the others the main table."""
    scale = suite.scale
    sets = [one for one in SETS if not scale.pools or one.pool in scale.pools][: 1 if scale.quick else None]
    return found_of([_compared(suite.trials(suite.test_set(one)), scale.quick) for one in sets])


def found_of(compared: list[PlacerComparison]) -> Found:
    """Comparisons on several sets as one study."""
    tables = [*compared[0].tables, *(each.tables[0] for each in compared[1:])]
    return Found([row for each in compared for row in each.rows], tables)


def _compared(trials: PlacerTrials, quick: bool) -> PlacerComparison:
    """Baselines with and without noise; what sees the scene itself, once."""
    placers = ("random", "geometry") if quick else (*BASELINES, *embedded_placers())
    seen = compare_placers(trials, placers, NOISES, None)
    if quick:
        return seen
    whole = compare_placers(trials, FULL_STATE, (0.0,), None)
    rows = [*seen.rows, *whole.rows]
    return PlacerComparison(rows, tables_of(rows))


PLACEMENT = DownstreamStudy("placement", "Stable placement from one camera's view", run)
