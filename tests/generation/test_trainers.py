"""Other trainers: environments made from names, and Brax's PPO in them, through Brax's own wrappers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.envs.wrappers.training import VmapWrapper, wrap
from brax.training.acme import running_statistics, specs
from brax.training.acting import generate_unroll
from brax.training.agents.ppo import losses, networks
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
    state, vector = jax.jit(lambda key: (env.step(env.reset(key), BAD), flat.step(flat.reset(key), BAD).obs))(
        jax.random.key(0)
    )
    objects, attempts, rows = 6, 2, 60 // 12 + 1
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
    assert flat.observation_size == vector.size == 3 + 9 * objects + 9 * attempts + 13 * attempts * rows + 16
    assert history["is_tried"].any()
    with pytest.raises(ConfigError, match=r"100 scene points in a flat observation.*Try"):
        FlatObservation(PlacementEnv(rules, ObservationConfig(num_scene_points=100)))


def test_actions_of_other_kinds_propose_the_same_poses():
    env = PlacementEnv(made_up_rules(history_stride=12))
    wide, upright = ActionRange(env, -2.0, 6.0), ActionRange(OnSurface(env, env.rules), -1.0, 1.0)

    def episodes(key):
        state = env.reset(key)
        height = (env.rules.geometry.half_extents[state.obs["focus"], 2] + 0.001) / state.obs["region"][2]
        pairs = (
            (env.step(state, jnp.array([0.25, 1.0, 0.5, 0.0])), wide.step(state, jnp.array([0.0, 9, 2, -7]))),
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


def two_updates(env, num_envs=4, num_steps=8):
    """Brax's pieces put together: parameters and states before and after, and the losses."""
    net = networks.make_ppo_networks(
        env.observation_size, env.action_size, running_statistics.normalize, (16,), (16,)
    )
    keys = jax.random.split(jax.random.PRNGKey(0), 5)
    state = jax.jit(env.reset)(jax.random.split(keys[0], num_envs))
    statistics = running_statistics.init_state(specs.Array((env.observation_size,), jnp.float32))
    params = losses.PPONetworkParams(net.policy_network.init(keys[1]), net.value_network.init(keys[2]))
    adam = optax.adam(1e-3)

    def update(carry, key):
        params, optimizer, statistics, state = carry
        policy = networks.make_inference_fn(net)((statistics, params.policy))
        key_act, key_loss = jax.random.split(key)
        state, data = generate_unroll(env, state, policy, key_act, num_steps, extra_fields=("truncation",))
        data = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), data)
        statistics = running_statistics.update(statistics, data.observation)
        loss = functools.partial(losses.compute_ppo_loss, ppo_network=net)
        (value, _), gradient = jax.value_and_grad(loss, has_aux=True)(params, statistics, data, key_loss)
        changes, optimizer = adam.update(gradient, optimizer)
        return (optax.apply_updates(params, changes), optimizer, statistics, state), value

    first = (params, adam.init(params), statistics, state)
    last, values = jax.jit(lambda carry: jax.lax.scan(update, carry, keys[3:]))(first)
    return first, last, values


@pytest.mark.slow
@pytest.mark.parametrize("wrapping", ["Brax's", "own reset"])
def test_two_updates_of_brax_ppo(wrapping):
    own = made_up_env(auto_reset=wrapping == "own reset")
    env = VmapWrapper(own) if wrapping == "own reset" else wrap(own, own.episode_length)
    first, last, values = two_updates(env)
    assert np.isfinite(values).all()
    assert jax.tree.structure(first) == jax.tree.structure(last)
    for before, after in zip(jax.tree.leaves(first[0]), jax.tree.leaves(last[0]), strict=True):
        assert np.isfinite(after).all()
        assert np.abs(after - before).max() > 1e-4
    assert np.isfinite(last[2].mean).all()


@pytest.mark.slow
def test_brax_own_trainer():
    env, seen = made_up_env(auto_reset=False), []
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
            networks.make_ppo_networks, policy_hidden_layer_sizes=(16,), value_hidden_layer_sizes=(16,)
        ),
        progress_fn=lambda step, figures: seen.append((step, figures)),
    )
    assert seen[-1][0] >= 2048
    assert np.isfinite(float(seen[-1][1]["training/total_loss"]))
    assert float(seen[-1][1]["eval/avg_episode_length"]) <= env.episode_length
    assert ppo.jax is jax
    assert not hasattr(jax, "device_put_replicated")
