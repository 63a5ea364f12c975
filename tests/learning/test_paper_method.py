"""The paper's method learns from attempts alone: one Beta a coordinate, height and all, in random order."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo.ppo import PPO
from cluttergen_jax.learning.training.presets import make_settings
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.problem import ProblemConfig, compose
from tests.helpers.worlds import box

SEEN = NetworkConfig(
    head="beta_free",
    object_points=8,
    object_features=8,
    token_width=32,
    num_heads=2,
    num_layers=3,
    width=64,
)
"""Small, and told of poses: what a point cloud is worth is asked elsewhere."""


def successes(num_objects, side, num_updates, network=SEEN, **ppo):
    """f64[num_updates], the share of the environments whose latest episode succeeded."""
    settings = make_settings("paper_cpu", "beta_free")
    placement = replace(settings.placement, num_objects=num_objects, max_attempts=1)
    objects = [box(f"box-{k}", (0.05, 0.05, 0.02 + 0.005 * k)) for k in range(num_objects)]
    config = ProblemConfig(placement=placement, stability=settings.stability)
    problem = compose(objects, cuboid_table(side, side), config)
    agent = make_agent(problem.rules, network)
    env = PlacementEnv(problem.rules, agent.observation)
    given = {"num_envs": 64, "num_steps": 25, "minibatch_size": 400, "anneals": False}
    learner = PPO(env, agent.apply, replace(settings.ppo, **given | ppo), None, agent.encode)
    params = agent.init(jax.random.key(0), jax.eval_shape(env.reset, jax.random.key(0)).obs)
    state = jax.jit(learner.start)(jax.random.key(1), params)
    update = jax.jit(learner.update)
    found = []
    for _ in range(num_updates):
        state, figures = update(state)
        found.append(float(figures["env/success"]))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_one_object_is_placed_beside_another():
    """Two boxes of 10 cm on a table of 20 cm: the second has one side of the first at most."""
    found = successes(2, 0.2, 60)
    assert found[:3].mean() < 0.5
    assert found[-5:].mean() > 0.95


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_five_objects_find_room():
    """On a table of 35 cm, one attempt each, in random order: one Beta must read where the others are."""
    found = successes(5, 0.35, 80)
    assert found[:3].mean() < 0.1
    assert found[-5:].mean() > 0.8
