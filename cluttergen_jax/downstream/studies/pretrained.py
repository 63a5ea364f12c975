"""The study `pretrained`: the paper's network from scratch, and with encoders that know shapes already."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from cluttergen_jax.downstream.placer.heads.regression import RegressionConfig
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.downstream.studies.trained import Variant, rows_of, table_of
from cluttergen_jax.learning.training.pretrain import PretrainConfig, Pretraining, small

_QUICK: dict[str, Any] = {"num_shapes": 1, "num_held_out": 1, "num_epochs": 1}
_NOTES = (
    "pretrained: both encoders begin with weights of `cluttergen pretrain --encoder pointnet "
    "--features 256`, which tell the modeller's 50 families apart, and are trained along",
    "random: no placer, it looks at nothing; for comparison",
)


def run(suite: SuiteFolder) -> Found:
    """The head `regression`, preset `cpu`, on the same pairs."""
    scale, pairs = suite.scale, suite.household()
    size = scale.capped(5000)
    variants = []
    for name, weights in (("from scratch", None), ("pretrained", _encoder(suite))):
        runs = {
            seed: suite.trained(
                f"{name.replace(' ', '-')}-{size}", pairs, "regression", seed, size, encoder_weights=weights
            )
            for seed in scale.training_seeds
        }
        variants.append(Variant({"encoders": name, "pairs": f"{size:,}"}, runs))
    variants.append(Variant({"encoders": "random", "pairs": "-"}, "random"))
    rows = rows_of(suite.trials(suite.test_set()), variants, scale.noises)
    title = f"{rows[0]['trial']['queries']} queries of household, head regression"
    return Found(rows, [table_of(title, rows, _NOTES)])


def _encoder(suite: SuiteFolder) -> Path:
    """Weights of an encoder of the head's sizes."""
    sizes = RegressionConfig()
    network = replace(
        small(sizes.encoder),
        object_features=sizes.features,
        scene_features=sizes.features,
        object_points=sizes.object_points,
        num_centroids=sizes.num_centroids,
        group_size=sizes.group_size,
    )
    config = PretrainConfig(network, **(_QUICK if suite.scale.quick else {}))
    folder = suite.folder / "runs" / f"encoder-{sizes.encoder}"
    Pretraining(config, folder).run()
    return folder


PRETRAINED = DownstreamStudy("pretrained", "The paper's network with encoders that know shapes", run)
