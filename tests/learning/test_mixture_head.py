"""The mixture head in the network: heights are read, z lies about what is below, densities are honest."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.placement.env import PlacementEnv
from tests.helpers.problems import made_up_rules

CONFIG = NetworkConfig(
    head="mixture", num_cells=6, num_turns=4, width=16, num_layers=2, object_points=8
)


def made_up(config=CONFIG):
    """Rules of six thin objects, their agent, fresh weights and one observation."""
    rules = made_up_rules()
    agent = make_agent(rules, config)
    env = PlacementEnv(rules, agent.observation)
    observation = jax.jit(env.reset)(jax.random.key(0)).obs
    return rules, agent, jax.jit(agent.init)(jax.random.key(1), observation), observation


@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, turn_symmetry=1, undersides=True)])
@pytest.mark.slow
def test_no_draw_has_a_broken_density(config):
    _, agent, params, observation = made_up(config)
    apply = jax.jit(agent.apply)

    @jax.jit
    def sampled(dist):
        draws = jax.vmap(dist.sample)(jax.random.split(jax.random.key(3), 2000))
        return draws, jax.vmap(dist.log_prob)(draws), dist.entropy()

    # An object as high as the whole range: the window has to give way at both ends.
    for height_range, height in ((0.004, 0.0), (0.05, 0.2)):
        observation["region"] = observation["region"].at[2].set(height_range)
        observation["heights"] = jnp.full((6, 6), height)
        dist = apply(params, jax.tree.map(lambda leaf: leaf[None], observation))[0]
        draws, density, entropy = sampled(dist)
        assert float(draws.min()) > 0
        assert float(draws.max()) < 1
        # The average log-density of draws is minus the entropy; one clipped draw would upset it.
        np.testing.assert_allclose(float(density.mean()), -float(entropy[0]), atol=0.1)
