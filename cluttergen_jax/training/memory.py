"""The memory that a run will need, counted from shapes before anything is compiled."""

from __future__ import annotations

import bisect
import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.agent.ppo import PPO
from cluttergen_jax.errors import ConfigError

_GB = 1e9
_BASE = 9e8
"""Bytes that compiling takes on a host and keeps (0.81 to 0.85 GB in all presets)."""


@dataclass(frozen=True)
class Memory:
    """Bytes, by what needs them.

    Attributes:
      rollout: the environments' state (before, now, next) and the transitions of one update.
      minibatch: one minibatch and what its gradient remembers.
      weights: the weights and Adam's two moments, before and now, the gradient and the step.
      engine: the simulations.
      programs: the rest of the process; nothing on an accelerator.
    """

    rollout: int
    minibatch: int
    weights: int
    engine: int
    programs: int = 0

    @property
    def total(self) -> int:
        """All of it."""
        return sum(dataclasses.astuple(self))

    def __str__(self) -> str:
        parts = ", ".join(
            f"{field.name} {amount(getattr(self, field.name))}" for field in dataclasses.fields(self)
        )
        return f"{amount(self.total)}: {parts}"


@dataclass(frozen=True)
class Needs:
    """What a learner takes in memory, by the number of its environments.

    Attributes:
      config: the learner's numbers.
      env, transition, remembered: bytes of one environment's state, of one transition, and of what the
        network's gradient remembers of one.
      weights: bytes of the weights.
      engine: bytes that the engine takes for so many scenes.
      num_devices: that the environments are divided among.
    """

    config: PPOConfig
    env: int
    transition: int
    remembered: int
    weights: int
    engine: Callable[[int], int]
    num_devices: int = 1

    @staticmethod
    def of(ppo: PPO, params: Any, engine: Callable[[int], int], num_devices: int = 1) -> Needs:
        """Counted from shapes; `params` may be the weights or their shapes."""
        env = jax.eval_shape(ppo.env.reset, jax.eval_shape(lambda: jax.random.key(0)))
        scalars = 4
        transition = _bytes(env.obs) + 4 * (ppo.env.action_size + scalars)
        remembered = _remembered(ppo, params, env.obs)
        return Needs(ppo.config, _bytes(env), transition, remembered, _bytes(params), engine, num_devices)

    def memory(self, num_envs: int) -> Memory:
        """Of each device, for so many environments in all."""
        config, here = self.config, num_envs // self.num_devices
        minibatch = -(-num_envs * config.num_steps // (config.num_minibatches * self.num_devices))
        # Minibatches are drawn from all environments: of several devices, each then holds all transitions.
        kept = here + (num_envs if self.num_devices > 1 else 0)
        return Memory(
            rollout=3 * here * self.env + config.num_steps * kept * self.transition,
            minibatch=minibatch * (self.transition + self.remembered),
            weights=8 * self.weights,
            engine=self.engine(here),
            programs=int(_BASE) if jax.default_backend() == "cpu" else 0,
        )

    def fitting(self, limit: int) -> int:
        """The largest number of environments, up to the config's, that divides evenly and fits; 0 if none."""
        config = self.config
        possible = [
            num
            for num in range(self.num_devices, config.num_envs + 1, self.num_devices)
            if num * config.num_steps % config.num_minibatches == 0
        ]
        return ([0, *possible])[bisect.bisect(possible, limit, key=lambda num: self.memory(num).total)]


def check_memory(needs: Needs, limit: int | None = None) -> str:
    """A sentence on what a run needs and what there is.

    Args:
      limit: bytes that there are; None asks the device, or the host where the device is its processor.

    Raises:
      ConfigError: it will not fit; the message names the number of environments that would.
    """
    config, limit = needs.config, free_bytes() if limit is None else limit
    memory = needs.memory(config.num_envs)
    if memory.total <= limit:
        return f"{memory} (free: {amount(limit)})"
    fitting = needs.fitting(limit)
    smaller = f"num_envs={fitting}, which needs {amount(needs.memory(fitting).total)}"
    raise ConfigError(
        f"{config.num_envs} environments of {config.num_steps} steps need {memory}",
        f"{amount(limit)}, which is free",
        smaller if fitting else "a smaller network or more memory: not one environment would fit",
    )


def _remembered(ppo: PPO, params: Any, observation: Any) -> int:
    """Bytes that the network's gradient remembers for each transition, from the shapes of two batches."""

    def remembered(num: int) -> int:
        batch = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((num, *leaf.shape), leaf.dtype), observation)
        return _bytes(jax.eval_shape(lambda p, b: jax.vjp(lambda q: ppo.apply(q, b), p)[1], params, batch))

    return max(remembered(3) - remembered(2), 0)


def free_bytes() -> int:
    """Bytes that a run may take: of the accelerator, or of this machine (and its control group)."""
    stats = jax.local_devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0))
    return min(_available(), _left_in_group())


def _available() -> int:
    """What the kernel says can be had without swapping; all there is, where it does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _left_in_group() -> int:
    """What a container's limit leaves."""
    folder = Path("/sys/fs/cgroup")
    try:
        return int((folder / "memory.max").read_text()) - int((folder / "memory.current").read_text())
    except (OSError, ValueError):
        return 1 << 62


def _bytes(tree: Any) -> int:
    total = 0
    for leaf in jax.tree.leaves(tree):
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        total += leaf.size * (8 if is_key else leaf.dtype.itemsize)
    return total


def amount(num_bytes: float) -> str:
    """A number of bytes for people."""
    return f"{num_bytes / _GB:.1f} GB" if num_bytes >= _GB else f"{num_bytes / 1e6:.0f} MB"
