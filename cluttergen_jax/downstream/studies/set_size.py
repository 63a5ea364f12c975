"""The study `set-size`: placers by how many pairs they learned from."""

from __future__ import annotations

from cluttergen_jax.downstream.placer.pairs.store import PairSet
from cluttergen_jax.downstream.studies.study import VALIDATING, DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import Variant, household_placers, rows_of, table_of

HEADS = ("scored", "mixture")
SIZES = (200, 1000, 5000, 20_000)
_FEW_SCENES = 5000
"""Up to so many pairs are the first of one set, of 500 scenes; more are of a set of their own."""
_NOTES = (
    "up to 5,000 pairs: the first so many of 5,000 of 500 scenes; 20,000 are of 2,000 scenes",
    "whatever their number, the epoch is chosen on 600 other pairs, of 60 scenes of their own",
    "every size is seen as often as the preset says: fewer pairs are fewer steps",
)


def run(suite: SuiteFolder) -> Found:
    """The heads `scored` and `mixture` by size; more pairs than the scale allows are left out."""
    scale = suite.scale
    sizes = [size for size in SIZES if size <= (scale.most_pairs or size)] or [scale.capped(SIZES[0])]
    variants = []
    for head in scale.chosen(*HEADS[: 1 if scale.quick else None]):
        for size in sizes:
            runs = household_placers(suite, head, size, _pairs(suite, size))
            variants.append(Variant({"head": head, "pairs": f"{size:,}"}, runs))
    rows = rows_of(suite.trials(suite.test_set()), variants, scale.noises)
    title = f"{rows[0]['trial']['queries']} queries of household, by pairs learned from"
    return Found(rows, [table_of(title, rows, _NOTES)])


def _pairs(suite: SuiteFolder, size: int) -> PairSet:
    if size <= _FEW_SCENES:
        return suite.household()
    return suite.training_set("household", 2000, size, VALIDATING)


SET_SIZE = DownstreamStudy("set-size", "Placers by how many pairs they learned from", run)
