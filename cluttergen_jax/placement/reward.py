"""The reward of an attempt: the paper's, that of its published code, and one that is kinder to a critic."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.types import Array, Settling

_CODE_LAST_BONUS = 1000.0


def reward_of(
    settling: Settling, is_stable: Array, ordinal: Array, is_last: Array, config: PlacementConfig
) -> Array:
    """The reward of one attempt, f32.

    "paper": -c sum_t (|v_t| + |a_t|) + n R0 1[stable], n the object's ordinal from 1 (paper, equation 1).
    "code": -c sum_t |v_t|_1 + R0 1[stable], and 1,000 more for the last object (its published code).
    "compressed": 1[stable] - log(1 + c sum_t (|v_t| + |a_t|)) / 10. The paper's penalty on a failed attempt
      is 69 in the median and up to 1,600; its logarithm keeps the order and spares the critic.

    Args:
      ordinal: i32, 1 for the first object.
    """
    stable = is_stable.astype(jnp.float32)
    if config.reward == "paper":
        return -config.motion_cost * settling.motion_sum + ordinal * config.success_reward * stable
    if config.reward == "code":
        bonus = config.success_reward + _CODE_LAST_BONUS * is_last
        return -config.motion_cost * settling.speed_sum + bonus * stable
    return stable - jnp.log1p(config.motion_cost * settling.motion_sum) / 10
