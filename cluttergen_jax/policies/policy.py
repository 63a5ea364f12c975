"""A trained policy, read from a checkpoint and bound to a world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.agent.checkpoint import read_policy, read_record
from cluttergen_jax.agent.learner import Learner
from cluttergen_jax.assets.pool import embedded_root
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.distributions import ActionDistribution
from cluttergen_jax.networks.ranking import RankerConfig
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.policies.ranked import Ranked, seen_by_ranker
from cluttergen_jax.ranking.learner import RankingLearner
from cluttergen_jax.search import LowestFit
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
        dist = self.distribution(episode)
        return dist.sample(key) if self.is_sampled else dist.mean()

    def draw(self, key: Array, episode: Episode, number: int) -> Array:
        """Many actions for the same attempt, f32[number, 4]."""
        return jax.vmap(self.distribution(episode).sample)(jax.random.split(key, number))

    def distribution(self, episode: Episode) -> ActionDistribution:
        """Over the actions of one attempt."""
        seen = observe(self.rules, episode, _observation_of(self.learner.config))
        dist, _ = self.learner.apply(self.params, jax.tree.map(lambda leaf: leaf[None], seen))
        return jax.tree.map(lambda leaf: leaf[0], dist)


def _observation_of(config: NetworkConfig) -> ObservationConfig:
    return ObservationConfig(num_cells=config.num_cells_read)


def load_policy(path: Path, rules: Rules, is_sampled: bool | None = None) -> Policy | Ranked:
    """A proposer that acts with the weights in `path`.

    Args:
      rules: of the world to act in. It must remember what the policy was trained to look back on.
      is_sampled: draw actions, or take the distribution's mean; by default poses are drawn, and of
        candidates the best is taken.

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
    bound = (geometry.cloud, geometry.half_extents, min(rules.num_slots, geometry.num_objects))
    if "cost_scale" in record["network"]:
        ranking, search = RankingLearner(RankerConfig(**record["network"]), *bound), LowestFit(rules)
        seen = _seen(rules, lambda episode: seen_by_ranker(search, episode))
        return Ranked(search, ranking, read_policy(path, _shapes(ranking, seen)), bool(is_sampled))
    learner = Learner(NetworkConfig(**record["network"]), *bound)
    seen = _seen(rules, lambda episode: observe(rules, episode, _observation_of(learner.config)))
    return Policy(rules, learner, read_policy(path, _shapes(learner, seen)), is_sampled is not False)


def _seen(rules: Rules, look: Callable[[Episode], Any]) -> Any:
    """The shapes of an observation."""
    return jax.eval_shape(lambda: look(rules.begin(jax.random.key(0))))


def _shapes(learner: Learner | RankingLearner, seen: Any) -> Any:
    """Parameters of the right shapes; drawing fresh ones would take longer to compile than acting does."""
    shapes = jax.eval_shape(learner.init, jax.random.key(0), seen)
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)
