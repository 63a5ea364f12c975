"""The learner on probes with known answers; resuming and seeding bit for bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.learning.ppo.checkpoint import read_state, save_state
from cluttergen_jax.learning.ppo.ppo import PPOConfig, generalised_advantages
from tests.helpers.probes import Bandit, Coin, Constant, Late, Tiny, learner, train
from tests.helpers.trees import same_bits


def value(state, obs):
    return float(Tiny().apply(state.params, jnp.array([obs]))[1][0])


@pytest.mark.slow
def test_constant_reward_has_constant_value():
    state = train(learner(Constant()), 40)
    assert value(state, [0.0, 0.0]) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_value_follows_the_observation():
    state = train(learner(Coin()), 60)
    assert value(state, [0.0, 1.0]) == pytest.approx(1.0, abs=0.1)
    assert value(state, [0.0, 0.0]) == pytest.approx(-1.0, abs=0.1)


@pytest.mark.slow
def test_later_reward_is_discounted():
    state = train(learner(Late()), 60)
    assert value(state, [1.0, 0.0]) == pytest.approx(1.0, abs=0.05)
    assert value(state, [0.0, 0.0]) == pytest.approx(0.9, abs=0.05)


@pytest.fixture(scope="module")
def bandit():
    return train(learner(Bandit()), 60)


def test_beta_bandit_finds_both_optima(bandit):
    dist, _ = Tiny().apply(bandit.params, jnp.array([[0.0, 1.0], [0.0, 0.0]]))
    np.testing.assert_allclose(dist.mean()[:, 0], [0.8, 0.3], atol=0.08)


@pytest.mark.slow
def test_entropy_bonus_keeps_the_policy_wide(bandit):
    wide = train(learner(Bandit(), entropy_cost=0.3), 60)
    seen = jnp.array([[0.0, 1.0]])
    entropies = [float(Tiny().apply(s.params, seen)[0].entropy()[0]) for s in (bandit, wide)]
    assert entropies[0] < entropies[1]


@pytest.mark.slow
def test_minibatches_of_one_size_leave_a_smaller_last_one():
    asked = {"num_envs": 8, "num_steps": 4, "num_epochs": 2, "num_attempts": 64}
    config = PPOConfig(**asked, minibatch_size=10)
    assert (config.steps_of_minibatch, config.num_gradient_steps) == (10, 2 * 2 * 4)
    assert PPOConfig(**asked, minibatch_size=1000).steps_of_minibatch == 32
    state, figures = jax.jit(learner(Bandit(), **asked, minibatch_size=10).update)(
        learner(Bandit(), **asked).start(
            jax.random.key(0), Tiny().init(jax.random.key(1), jnp.zeros((1, 2)))
        )
    )
    # Adam counts its steps: three minibatches of ten and one of two, twice.
    counts = [int(leaf) for leaf in jax.tree.leaves(state.optimizer) if leaf.dtype == jnp.int32]
    assert set(counts) == {8}
    assert np.isfinite(figures["loss"])


@pytest.mark.slow
def test_scaled_rewards_teach_the_same_actions_and_scaled_values():
    scaled = train(learner(Constant(), reward_scale=0.1), 40)
    assert value(scaled, [0.0, 0.0]) == pytest.approx(0.1, abs=0.03)


@pytest.mark.slow
def test_clipped_values_move_less():
    free, clipped = (train(learner(Constant(), value_clip=each), 2) for each in (0.0, 0.001))
    assert abs(value(clipped, [0.0, 0.0])) < abs(value(free, [0.0, 0.0]))


def test_advantages_by_hand():
    # Two steps that end an episode, then one that does not, one environment.
    reward, value_, done = (
        jnp.array(x)[:, None] for x in ([1.0, 2.0, 3.0], [0.5, 0.25, 0.1], [0.0, 1.0, 0.0])
    )
    advantage, target = generalised_advantages(reward, value_, done, jnp.array([4.0]), 0.9, 0.8)
    third = 3 + 0.9 * 4 - 0.1
    second = 2 - 0.25
    first = 1 + 0.9 * 0.25 - 0.5 + 0.9 * 0.8 * second
    np.testing.assert_allclose(advantage[:, 0], [first, second, third], rtol=1e-6)
    np.testing.assert_allclose(target, advantage + value_, rtol=1e-6)


@pytest.mark.slow
def test_resumed_run_is_the_same_run_bit_for_bit(tmp_path):
    ppo = learner(Bandit())
    whole = train(ppo, 6)
    half = train(ppo, 3)
    save_state(tmp_path / "last", half, {"pool": "none"})
    resumed = read_state(tmp_path / "last", half)
    update = jax.jit(ppo.update)
    for _ in range(3):
        resumed, _ = update(resumed)
    assert same_bits(resumed, whole)
