"""Policies of poses: with fewer attempts than they know they act as before, and more are refused."""

import json
from dataclasses import asdict, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.methods import choose_method
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.policy import load_policy
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.spec import SceneSpec
from tests.helpers.problems import trio_problem

NETWORK = NetworkConfig(width=16, num_layers=2)
PLACEMENT = {"max_attempts": 5, "history_stride": 60}


@pytest.fixture(scope="module")
def rules():
    return trio_problem(history_stride=60).rules


@pytest.fixture(scope="module")
def stored(rules, tmp_path_factory):
    """A fresh policy of poses, trained with up to five attempts."""
    folder = tmp_path_factory.mktemp("policy")
    agent = make_agent(rules, NETWORK)
    env = PlacementEnv(rules, agent.observation)
    seen = jax.eval_shape(env.reset, jax.random.key(0)).obs
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), seen)
    params = jax.jit(agent.init)(jax.random.key(0), blank)
    save_policy(folder, params, {"network": asdict(NETWORK), "placement": PLACEMENT})
    return folder


def with_attempts(rules, number):
    """The rules with another number of attempts."""
    return replace(rules, config=replace(rules.config, max_attempts=number))


@pytest.mark.slow
def test_a_policy_acts_with_fewer_attempts_than_it_was_trained_with(rules, stored):
    actions = []
    for its_rules in (with_attempts(rules, 2), rules):
        policy = load_policy(read_checkpoint(stored), its_rules, is_sampled=False)
        failed = jax.jit(its_rules.attempt)(
            its_rules.begin(jax.random.key(9)), jnp.array([0.5, 0.5, 0.99, 0.5])
        )[0]
        actions.append(jax.jit(policy)(jax.random.key(1), failed))
    assert actions[0].shape == (4,)
    # What it is not allowed to try is as empty as what it has not tried yet.
    np.testing.assert_array_equal(*actions)


def test_a_policy_refuses_more_attempts(rules, stored):
    with pytest.raises(ConfigError, match="max_attempts = 7"):
        load_policy(read_checkpoint(stored), with_attempts(rules, 7))


def test_a_method_that_there_is_not_is_named(stored, tmp_path):
    """By whoever asks for it, and by a checkpoint that was trained as it."""
    said = "'beta'.*Did you mean 'beta_free'"
    with pytest.raises(ConfigError, match=said):
        SceneSpec(method="beta")
    record = json.loads((stored / "record.json").read_text())
    record.pop("sha256", None)
    (tmp_path / "record.json").write_text(json.dumps(record | {"variant": "beta"}))
    (tmp_path / "weights.npz").write_bytes((stored / "weights.npz").read_bytes())
    with pytest.raises(ConfigError, match=f"checkpoint of method {said}"):
        choose_method("policy", "dining", tmp_path)
    with pytest.raises(ConfigError, match=said):
        choose_method(None, "dining", tmp_path)
