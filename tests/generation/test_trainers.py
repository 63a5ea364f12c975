"""Other trainers: environments made from names, and Brax's PPO in them, through Brax's own wrappers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.agents.ppo import networks
from brax.training.agents.ppo import train as ppo

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.wrappers import ActionRange, FlatObservation, OnSurface
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.observation import ObservationConfig
from tests.helpers.problems import made_up_rules

BAD = jnp.array([0.1, 0.5, 0.5, 0.2])


def made_up_env(**settings):
    rules = made_up_rules(max_attempts=2, history_stride=12, reward="compressed")
    return ActionRange(FlatObservation(PlacementEnv(rules, **settings)), -1.0, 1.0)


def test_the_vector_holds_what_the_observation_says():
    rules = made_up_rules(max_attempts=2, history_stride=12)
    env = PlacementEnv(rules, ObservationConfig(num_cells=4))
    flat = FlatObservation(env)
    state, vector = jax.jit(
        lambda key: (env.step(env.reset(key), BAD), flat.step(flat.reset(key), BAD).obs)
    )(jax.random.key(0))
    objects = 6
    attempts = 2
    rows = 60 // 12 + 1
    history = state.obs["history"]
    parts = [
        (3, state.obs["region"]),
        (objects, np.eye(objects)[int(state.obs["focus"])]),
        (objects, state.obs["is_placed"]),
        (7 * objects, state.obs["T_region_object"]),
        (attempts, history["is_tried"]),
        (4 * attempts, history["action"]),
        (3 * attempts, history["region"]),
        (attempts, history["num_steps"] / 60),
        (13 * attempts * rows, history["trajectory"]),
        (16, state.obs["heights"]),
    ]
    assert [np.size(part) for _, part in parts] == [size for size, _ in parts]
    expected = np.concatenate([np.ravel(part).astype(np.float32) for _, part in parts])
    np.testing.assert_allclose(vector, expected, atol=1e-6)
    assert (
        flat.observation_size
        == vector.size
        == 3 + 9 * objects + 9 * attempts + 13 * attempts * rows + 16
    )
    assert history["is_tried"].any()
    with pytest.raises(ConfigError, match=r"100 scene points in a flat observation.*Try"):
        FlatObservation(PlacementEnv(rules, ObservationConfig(num_scene_points=100)))


def test_actions_of_other_kinds_propose_the_same_poses():
    env = PlacementEnv(made_up_rules(history_stride=12))
    wide = ActionRange(env, -2.0, 6.0)
    upright = ActionRange(OnSurface(env, env.rules), -1.0, 1.0)

    def episodes(key):
        state = env.reset(key)
        height = (env.rules.geometry.half_extents[state.obs["focus"], 2] + 0.001) / state.obs[
            "region"
        ][2]
        pairs = (
            (
                env.step(state, jnp.array([0.25, 1.0, 0.5, 0.0])),
                wide.step(state, jnp.array([0.0, 9, 2, -7])),
            ),
            (
                env.step(state, jnp.stack([0.25, 1.0, height, 0.5])),
                upright.step(state, jnp.array([-0.5, 9, 0])),
            ),
        )
        return [[state.obs["history"]["action"][0] for state in pair] for pair in pairs]

    for plain, other in jax.jit(episodes)(jax.random.key(0)):
        np.testing.assert_allclose(plain, other, atol=1e-6)
        assert np.any(np.asarray(plain))
    assert upright.action_size == 3
    with pytest.raises(ConfigError, match=r"action_range = \(1.0, 0.0\)"):
        ActionRange(env, 1.0, 0.0)


@pytest.mark.slow
def test_brax_own_trainer():
    env = made_up_env(auto_reset=False)
    seen = []
    cg.train_brax(
        env,
        num_timesteps=2048,
        num_envs=16,
        unroll_length=8,
        batch_size=16,
        num_minibatches=4,
        num_updates_per_batch=2,
        num_evals=2,
        num_eval_envs=16,
        discounting=0.9,
        network_factory=functools.partial(
            networks.make_ppo_networks,
            policy_hidden_layer_sizes=(16,),
            value_hidden_layer_sizes=(16,),
        ),
        progress_fn=lambda step, figures: seen.append((step, figures)),
    )
    assert seen[-1][0] >= 2048
    assert np.isfinite(float(seen[-1][1]["training/total_loss"]))
    assert float(seen[-1][1]["eval/avg_episode_length"]) <= env.episode_length
    assert ppo.jax is jax
    assert not hasattr(jax, "device_put_replicated")
