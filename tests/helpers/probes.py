"""Probe environments with known values, and a tiny network for them."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp
from brax.envs.base import Env, State

from cluttergen_jax.learning.networks.distributions import Beta
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig
from cluttergen_jax.types import Array


class Probe(Env):
    """A base: an episode of `length` steps that sees the step's number and a coin."""

    length = 1

    def reset(self, rng: Array) -> State:
        key, coin = jax.random.split(rng)
        return self._state(
            key, jnp.int32(0), jax.random.bernoulli(coin), jnp.float32(0), jnp.float32(0)
        )

    def step(self, state: State, action: Array) -> State:
        key, coin = jax.random.split(state.info["key"])
        reward = self.pays(state.info["step"], state.info["coin"], action)
        step = state.info["step"] + 1
        is_over = step >= self.length
        step = jnp.where(is_over, 0, step)
        return self._state(
            key, step, jax.random.bernoulli(coin), reward, is_over.astype(jnp.float32)
        )

    def pays(self, step: Array, coin: Array, action: Array) -> Array:
        raise AssertionError("a probe says what it pays")

    def _state(self, key: Array, step: Array, coin: Array, reward: Array, done: Array) -> State:
        obs = jnp.stack([step.astype(jnp.float32), coin.astype(jnp.float32)])
        info = {"key": key, "step": step, "coin": coin, "truncation": jnp.float32(0)}
        return State(None, obs, reward, done, {}, info)

    @property
    def observation_size(self) -> int:
        return 2

    @property
    def action_size(self) -> int:
        return 1

    @property
    def backend(self) -> str:
        return "none"


class Constant(Probe):
    """Pays 1 in one step: the value is 1."""

    def pays(self, step, coin, action):
        return jnp.float32(1)


class Coin(Probe):
    """Pays 1 for heads and -1 for tails: the value is what is seen."""

    def pays(self, step, coin, action):
        return 2 * coin.astype(jnp.float32) - 1


class Late(Probe):
    """Pays 1 at the second of two steps: the value of the first is the discount."""

    length = 2

    def pays(self, step, coin, action):
        return (step == 1).astype(jnp.float32)


class Bandit(Probe):
    """Pays most for 0.8 on heads and for 0.3 on tails."""

    def pays(self, step, coin, action):
        return 1 - jnp.abs(action[0] - jnp.where(coin, 0.8, 0.3))


class Tiny(nn.Module):
    """Two small networks over the probe's observation."""

    @nn.compact
    def __call__(self, x: Array):
        raw = nn.Dense(2, kernel_init=nn.initializers.zeros)(nn.tanh(nn.Dense(32)(x)))
        value = nn.Dense(1)(nn.tanh(nn.Dense(32)(x)))
        return Beta.from_raw(raw[..., None, :]), value[..., 0]


def learner(env: Probe, **config) -> PPO:
    """PPO on a probe."""
    defaults = {
        "num_envs": 64,
        "num_steps": 8,
        "num_minibatches": 4,
        "num_epochs": 4,
        "learning_rate": 5e-3,
        "entropy_cost": 0.0,
        "discount": 0.9,
        "num_attempts": 64 * 8 * 60,
    }
    return PPO(env, Tiny().apply, PPOConfig(**defaults | config))


def train(ppo: PPO, num_updates: int, seed: int = 0):
    """The state after some updates from scratch."""
    return trainer(ppo)(num_updates, seed)


def trainer(ppo: PPO):
    """`train` of one learner, compiled once for any number of trainings."""
    init = jax.jit(Tiny().init)
    start = jax.jit(ppo.start)
    update = jax.jit(ppo.update)

    def train(num_updates: int, seed: int = 0):
        state = start(jax.random.key(seed + 1), init(jax.random.key(seed), jnp.zeros((1, 2))))
        for _ in range(num_updates):
            state, _ = update(state)
        return state

    return train
