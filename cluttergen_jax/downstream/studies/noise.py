"""The study `noise`: a ladder of noise, and tables filled by what a noisy camera sees alone."""

from __future__ import annotations

from cluttergen_jax.downstream.placer.evaluation.evaluate import compare_placers
from cluttergen_jax.downstream.placer.evaluation.tables import chain_table
from cluttergen_jax.downstream.studies.study import NOISES, DownstreamStudy, Found, SuiteFolder

PLACERS = ("geometry-occupied", "scored")
LADDER = (0.0, 0.5, 1.0, 2.0, 4.0)
_CHAINS, _QUICK_CHAINS = 256, 2


def run(suite: SuiteFolder) -> Found:
    """Queries at each level; chains without noise and with that of a usual camera."""
    quick = suite.scale.quick
    placers = PLACERS[:1] if quick else PLACERS
    found = compare_placers(suite.trials(suite.test_set()), placers, (0.0, 2.0) if quick else LADDER, None)
    # Of these scenes the chains need the objects and their order, and no queries.
    number = suite.scale.scenes(_CHAINS, _QUICK_CHAINS)
    trials = suite.trials(suite.test_set(num_scenes=number, num_pairs=1))
    asked = [(placer, noise) for noise in NOISES for placer in placers]
    chains = [row for each in asked if (row := trials.chain(*each, number)) is not None]
    tables = [found.tables[0], *found.tables[2:4], chain_table(chains)]
    return Found(found.rows + [{"trial": row["trial"], "figures": row} for row in chains], tables)


NOISE = DownstreamStudy("noise", "Stable placement by how noisy the camera is", run)
