"""Evaluations while training: the whole last check, fresh episodes, weights as they are stored."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.training.run import Evaluator
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.problem import ProblemConfig, compose
from tests.helpers.runs import SMALL
from tests.helpers.worlds import trio


@pytest.fixture(scope="module")
def problem():
    """Two objects to place, judged as in training: the last check has its first stage only."""
    stability = StabilityConfig(stop_when_decided=True)
    stability = replace(stability, stand_full_steps=stability.stand_steps)
    placement = PlacementConfig(num_objects=2, max_attempts=10, history_stride=60)
    return compose(trio(), cuboid_table(), ProblemConfig(placement=placement, stability=stability))


@pytest.fixture(scope="module")
def params(problem):
    agent = make_agent(problem.rules, SMALL)
    env = PlacementEnv(problem.rules, agent.observation)
    seen = jax.eval_shape(env.reset, jax.random.key(0)).obs
    return jax.device_get(agent.init(jax.random.key(0), seen))


@pytest.fixture(scope="module")
def evaluator(problem):
    return Evaluator(problem, SMALL, num_episodes=12)


@pytest.mark.slow
def test_says_how_good_weights_are_and_how_that_was_found(evaluator, params, problem):
    found = evaluator(params)
    assert found["episodes"] == 12
    assert found["action"] == "sampled"
    assert found["low95"] <= found["success"] <= found["high95"]
    assert found["success"] <= found["filled"]
    assert (found["success"] * 12) % 1 == pytest.approx(0)
    # The whole last check, though training makes only its first stage.
    assert found["last_check_steps"] == StabilityConfig().stand_full_steps
    assert problem.config.stability.stand_full_steps < found["last_check_steps"]
    assert evaluator(params) == found


def test_weights_count_as_they_are_stored(evaluator, params):
    stored = jax.tree.map(lambda leaf: np.float32(np.float16(leaf)), params)
    assert evaluator(stored) == evaluator(params)
