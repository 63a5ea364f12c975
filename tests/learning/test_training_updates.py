"""Compiled updates: the same bits however many a call makes, and none after one that is not finite."""

import jax
import jax.numpy as jnp
import pytest

from cluttergen_jax.learning.training.run import Updates, num_updates
from tests.helpers.probes import Bandit, Tiny, learner
from tests.helpers.trees import same_bits

NOTHING, OBSERVATION, REWARD, LARGE, LAST = range(5)


class Sick(Bandit):
    """A bandit that falls ill in its third step, in the way that its state says."""

    length = 4

    def _state(self, key, step, coin, reward, done):
        state = super()._state(key, step, coin, reward, done)
        return state.replace(info=state.info | {"illness": jnp.int32(NOTHING)})

    def step(self, state, action):
        illness = state.info["illness"]
        is_now = state.info["step"] == 2
        after = super().step(state, action)
        nan = jnp.float32(jnp.nan)
        large = jnp.float32(1e30)
        reward = jnp.where(is_now & (illness == REWARD), nan, after.reward)
        reward = jnp.where(is_now & (illness == LARGE), large, reward)
        is_seen = is_now & (illness == OBSERVATION)
        is_seen |= (state.info["step"] == 3) & (illness == LAST)
        return after.replace(
            reward=reward,
            obs=jnp.where(is_seen, nan, after.obs),
            info=after.info | {"illness": illness},
        )


@pytest.fixture(scope="module")
def sick():
    """Updates of up to three at once, and a state to begin with: rollouts are whole episodes."""
    ppo = learner(Sick(), num_envs=4, num_steps=4, num_minibatches=2, num_epochs=2)
    state = jax.jit(ppo.start)(jax.random.key(1), Tiny().init(jax.random.key(0), jnp.zeros((1, 2))))
    return Updates(ppo, state, 3), state


def ill(state, illness):
    env = state.env
    return state.replace(
        env=env.replace(info=env.info | {"illness": jnp.full((4,), illness, jnp.int32)})
    )


@pytest.mark.slow
def test_three_at_once_are_one_by_one(sick):
    updates, state = sick
    at_once, rows, is_finite = updates(state, 3)
    one_by_one = state
    singly = []
    for _ in range(3):
        one_by_one, row, _ = updates(one_by_one, 1)
        singly += row
    assert same_bits(at_once, one_by_one)
    assert len(rows) == 3
    assert rows == singly
    assert is_finite
    assert not same_bits(at_once.params, state.params)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("illness", "where"),
    [
        (OBSERVATION, "_roll_out"),
        (LAST, "_roll_out"),
        (REWARD, "_roll_out"),
        (LARGE, "checked_update"),
    ],
)
def test_an_update_that_is_not_finite_is_the_last_and_its_place_is_named(sick, illness, where):
    updates, state = sick
    after, rows, is_finite = updates(ill(state, illness), 3)
    assert not is_finite
    assert len(rows) == 1
    assert int(after.num_updates) == 1
    found = updates.where_not_finite(ill(state, illness), len(rows))
    assert found.startswith(f"{where} (learning/ppo/ppo.py:")
    assert not jax.config.jax_debug_nans


def test_number_of_updates_follows_their_time():
    assert num_updates(None, 10, 4.0) == 1
    assert num_updates(100.0, 10, 4.0) == 1
    assert num_updates(1.5, 10, 4.0) == 2
    assert num_updates(1e-6, 10, 4.0) == 10
    assert num_updates(0.0, 3, 4.0) == 3
