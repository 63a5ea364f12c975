"""A trained policy, read from a checkpoint and bound to a world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.agent.checkpoint import read_policy, read_record
from cluttergen_jax.agent.learner import Learner
from cluttergen_jax.assets.pool import embedded_root
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.networks.actor_critic import NetworkConfig
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


def list_policies() -> dict[str, Path]:
    """Embedded checkpoints by name, POOL-VARIANT, with their folders."""
    root = embedded_root() / "checkpoints"
    folders = sorted(root.iterdir()) if root.is_dir() else []
    return {folder.name: folder for folder in folders if (folder / "record.json").is_file()}


def find_policy(variant: str, pool: str) -> Path:
    """The embedded checkpoint of a variant for a pool.

    Raises:
      PoolError: there is none; the message lists those that exist.
    """
    policies = list_policies()
    name = f"{pool}-{variant}"
    if name in policies:
        return policies[name]
    raise PoolError(
        f"no checkpoint for method {variant!r} on pool {pool!r}",
        ", ".join(policies) or "none is embedded",
        f"python train.py --pool {pool} --variant {variant}, then --checkpoint runs/{name}-0/policy",
    )


@dataclass(frozen=True, eq=False)
class Policy:
    """A proposer that draws from a trained actor, or takes its mean."""

    rules: Rules
    learner: Learner
    params: Any
    is_sampled: bool

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.proposer.Proposer`."""
        seen = observe(self.rules, episode, ObservationConfig())
        dist, _ = self.learner.apply(self.params, jax.tree.map(lambda leaf: leaf[None], seen))
        return (dist.sample(key) if self.is_sampled else dist.mean())[0]


def load_policy(path: Path, rules: Rules, is_sampled: bool = True) -> Policy:
    """A proposer that acts with the weights in `path`.

    Args:
      rules: of the world to act in. It must remember what the policy was trained to look back on.
      is_sampled: draw actions; else take the mean.

    Raises:
      PoolError: the checkpoint is missing or damaged.
      ConfigError: the world's history is not what the policy reads.
    """
    record = read_record(path)
    wanted, given = record["placement"], rules.config
    for name in ("max_attempts", "history_stride"):
        if wanted[name] != getattr(given, name):
            raise ConfigError(
                f"{name} = {getattr(given, name)} with a policy trained with {wanted[name]}",
                f"{name} = {wanted[name]}",
                "the settings that the policy was trained with",
            )
    geometry = rules.geometry
    most = min(rules.num_slots, geometry.num_objects)
    learner = Learner(NetworkConfig(**record["network"]), geometry.cloud, geometry.half_extents, most)
    key = jax.random.key(0)
    seen = jax.eval_shape(lambda: observe(rules, rules.begin(key), ObservationConfig()))
    # Only the parameters' shapes are needed: drawing them would take longer to compile than acting does.
    like = jax.tree.map(
        lambda leaf: np.zeros(leaf.shape, leaf.dtype), jax.eval_shape(learner.init, key, seen)
    )
    return Policy(rules, learner, read_policy(path, like), is_sampled)
