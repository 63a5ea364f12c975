"""Brax's own PPO in our environment, with a newer JAX than Brax was written for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.brax_env import Env


class _JaxAsBraxKnowsIt:
    """JAX with the function that Brax 0.14 asks for and JAX 0.10 has no more."""

    def __getattr__(self, name: str) -> Any:
        return getattr(jax, name)

    @staticmethod
    def device_put_replicated(tree: Any, devices: Sequence[Any]) -> Any:
        """The tree with a leading axis, one copy a device."""
        return jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)


def train_brax(env: Env, num_timesteps: int, **settings: Any) -> tuple[Any, Any, dict[str, float]]:
    """`brax.training.agents.ppo.train.train` in an environment of `make_env`.

    Args:
      env: made with `auto_reset=False`: Brax brings resets of its own.
      num_timesteps: attempts in all.
      settings: Brax's own, such as `num_envs`, `learning_rate`, `network_factory` or `progress_fn`; its
        `episode_length` is the environment's unless it is given.

    Returns:
      What Brax returns: a function from parameters to a policy, the parameters, and figures.

    Raises:
      ConfigError: the environment resets itself.
    """
    from brax.training.agents.ppo import train as ppo

    if getattr(env, "auto_reset", False):
        raise ConfigError("an environment that resets itself", "make_env(..., auto_reset=False)")
    length = settings.pop("episode_length", None) or env.episode_length
    with _old_jax_in(ppo):
        return ppo.train(environment=env, num_timesteps=num_timesteps, episode_length=length, **settings)


@contextmanager
def _old_jax_in(module: Any) -> Iterator[None]:
    """While it is entered, one module sees a JAX with what JAX has no more; nobody else does."""
    module.jax = jax if hasattr(jax, "device_put_replicated") else _JaxAsBraxKnowsIt()
    try:
        yield
    finally:
        module.jax = jax
