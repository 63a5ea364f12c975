"""Generalised advantage estimation (Schulman et al., 2016)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.types import Array


def generalised_advantages(
    reward: Array, value: Array, done: Array, last_value: Array, discount: float, gae_lambda: float
) -> tuple[Array, Array]:
    """Advantages and value targets.

    Args:
      reward, value, done: f32[T, N]; done is 1 where the step ended an episode.
      last_value: f32[N], of the observation after the last step.

    Returns:
      f32[T, N] each: sum over l of (discount lambda)^l delta_{t + l}, and that plus the value.
    """
    following = jnp.concatenate([value[1:], last_value[None]])
    delta = reward + discount * (1 - done) * following - value

    def back(after: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        delta, done = now
        advantage = delta + discount * gae_lambda * (1 - done) * after
        return advantage, advantage

    _, advantage = jax.lax.scan(back, jnp.zeros_like(last_value), (delta, done), reverse=True)
    return advantage, advantage + value
