"""The study `training-seeds`: the placer that comes with the package, trained again with other seeds."""

from __future__ import annotations

from cluttergen_jax.downstream.studies.study import NUM_OBJECTS, SETS, DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import Variant, rows_of, table_of

PAIRS, EPOCHS = 2560, 10
"""Of each of the two sets, and times that they are seen: as the placer's card has it."""
_NOTES = ("trained by the commands of the card of the placer `scored`, each seed from pairs to weights",)
_QUICK_NOTES = ("learned from household alone, where the placer `scored` learned from all pools as well",)


def run(suite: SuiteFolder) -> Found:
    """Rows on all sets of the study `placement`."""
    scale = suite.scale
    learned = [suite.household()]
    if not scale.quick:
        all_pools = {"pool": "all", "num_objects": NUM_OBJECTS}
        learned.append(suite.training_set("all", 800, PAIRS, (100, 256), **all_pools))
    size = scale.capped(PAIRS)
    runs = {
        seed: suite.trained(f"card-{size}", learned, "scored", seed, size, num_epochs=EPOCHS)
        for seed in scale.training_seeds
    }
    sets = [one for one in SETS if not scale.pools or one.pool in scale.pools][: 1 if scale.quick else None]
    rows = []
    for one in sets:
        variant = Variant({"set": one.name, "placer": "scored"}, runs)
        rows += rows_of(suite.trials(suite.test_set(one)), [variant], scale.noises)
    queries = sorted({row["trial"]["queries"] for row in rows})
    title = f"{' or '.join(f'{each:,}' for each in queries)} queries a set"
    return Found(rows, [table_of(title, rows, _QUICK_NOTES if scale.quick else _NOTES)])


TRAINING_SEEDS = DownstreamStudy("training-seeds", "The trained placer by training seed", run)
