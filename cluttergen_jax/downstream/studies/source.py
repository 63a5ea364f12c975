"""The study `source`: placers by how the scenes that they learned from came about."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.downstream.placer.pairs.store import PairSet
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import Variant, rows_of, table_of

SCENES = {"guided": 105, "clear": 105, "random": 180}
"""Of which about 100 stand: `random` fails more often."""
PAIRS, HAND_PAIRS, HAND_SCENES = 1000, 200, 20
_NOTES = (
    "each learns from its own scenes alone: every tenth of them chooses the epoch",
    "generated: 20 scenes by `guided`, where the paper has 200 pairs of 20 scenes that a person made "
    "(Human-200); nobody has made any here. That row is made by `cluttergen view --place --pool household "
    "--num-objects 10 --out hand`, twenty scenes, and then `cluttergen evaluate --suite downstream --only "
    "source --bank hand`",
)


def run(suite: SuiteFolder) -> Found:
    """The head `scored` by source, and by few pairs as a person would make them."""
    scale, sets = suite.scale, []
    for method, scenes in list(SCENES.items())[: 1 if scale.quick else None]:
        pairs = suite.training_set(f"household-{method}", scenes, PAIRS, method=method)
        sets.append((method, scale.capped(PAIRS), pairs))
    few = suite.training_set("household-few", HAND_SCENES, HAND_PAIRS, method="guided")
    sets.append(("generated", scale.capped(HAND_PAIRS), few))
    if scale.bank is not None:
        hand = suite.hand_set(Path(scale.bank), scale.capped(HAND_PAIRS))
        sets.append(("by hand", scale.capped(HAND_PAIRS), hand))
    variants = [_variant(suite, head, *each) for head in scale.chosen("scored") for each in sets]
    rows = rows_of(suite.trials(suite.test_set()), variants, scale.noises)
    title = f"{rows[0]['trial']['queries']} queries of household, by the scenes learned from"
    return Found(rows, [table_of(title, rows, _NOTES)])


def _variant(suite: SuiteFolder, head: str, source: str, size: int, pairs: PairSet) -> Variant:
    name = f"{source.replace(' ', '-')}-{head}-{size}"
    runs = {seed: suite.trained(name, pairs, head, seed, size) for seed in suite.scale.training_seeds}
    standing = pairs.split("train")["num_scenes"]
    labels = {"scenes by": source, "head": head, "pairs": f"{size:,}", "of scenes": str(standing)}
    return Variant(labels, runs)


SOURCE = DownstreamStudy("source", "Placers by the scenes that they learned from", run)
