"""Pretraining: shapes it never saw are recognised, a stopped run goes on, its weights end up in a policy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.learning.networks.cloud_encoder import CloudEncoder, init_encoder
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.presets import choose_encoder, fit_to_weights
from cluttergen_jax.learning.training.pretrain import PretrainConfig, Pretraining
from cluttergen_jax.learning.training.run import Run, RunConfig, with_encoder
from cluttergen_jax.learning.training.run_folder import RunFolder
from tests.helpers.problems import made_up_rules
from tests.helpers.runs import PPO, recipe

TINY = NetworkConfig(scene_encoder="pointnet", object_points=48, object_features=24)
CONFIG = PretrainConfig(
    TINY,
    families=("bottle", "dinner_plate", "fork"),
    num_shapes=4,
    num_held_out=4,
    num_epochs=20,
    batch_size=6,
    learning_rate=3e-3,
)


def same(one, two):
    return jax.tree.all(jax.tree.map(lambda a, b: bool(np.array_equal(a, b)), one, two))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pretrained") / "run"
    run = Pretraining(CONFIG, folder)
    return folder, run.run(), run._start()


@pytest.mark.slow
def test_unseen_shapes_are_recognised(trained):
    folder, accuracy, _ = trained
    # One in three is chance, and with 12 shapes 7 of them are right by chance once in 15 times.
    assert accuracy >= 0.8
    record = read_record(folder)
    assert (record["encoder"], record["features"], record["held_out_accuracy"]) == (
        "pointnet",
        24,
        accuracy,
    )


def test_weights_end_up_in_both_networks(trained):
    folder, _, state = trained
    network = fit_to_weights(NetworkConfig(scene_encoder="pointnet"), folder)
    assert network.object_features == network.scene_features == 24
    clouds = jnp.ones((2, 8, 3))
    fresh = init_encoder(CloudEncoder(network, 2), jax.random.key(0), clouds, jnp.ones((2, 3)))
    params = {"params": {"encoder": fresh, "actor": jnp.ones(3)}}
    filled = with_encoder(params, folder)["params"]
    for name in ("object_net", "scene_net"):
        half = jax.tree.map(
            lambda leaf: leaf.astype(jnp.float16).astype(jnp.float32), state.params["encoder"]
        )
        assert same(filled["encoder"][name], half)
        assert not same(filled["encoder"][name], fresh[name])
    np.testing.assert_array_equal(filled["actor"], params["params"]["actor"])


@pytest.mark.slow
def test_a_run_begins_and_ends_with_frozen_weights(trained, tmp_path):
    small = NetworkConfig(object_points=8, scene_points=64, history_width=8, num_layers=1, width=8)
    network = choose_encoder(small, "pointnet", str(trained[0]), True)
    rules = made_up_rules(history_stride=12, reward="compressed")
    folder = RunFolder(tmp_path, recipe(rules))
    run = Run(rules, network, PPO, RunConfig(), folder, None, trained[0])
    begun = run.start().params["params"]["encoder"]
    assert same(begun["scene_net"], begun["object_net"])
    half = jax.tree.map(lambda leaf: np.float32(np.float16(leaf)), trained[2].params["encoder"])
    assert same(begun["scene_net"], half)
    assert same(run.train(lambda text: None).params["params"]["encoder"], begun)
