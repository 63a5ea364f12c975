"""Evaluation of a policy in training: success by the whole last check over fresh episodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.policies.policy import TrainedPolicy, make_policy
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import make_physics
from cluttergen_jax.placement.baselines import make_proposer
from cluttergen_jax.placement.problem import Problem
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout
from cluttergen_jax.placement.rules import Proposer, Rules
from cluttergen_jax.proportions import wilson

_FRESH = 0x5EED
"""Folded into the seed's key, so that no episode of training comes back."""


@dataclass(frozen=True, eq=False)
class Evaluator:
    """Success of weights, judged as sampling and saving judge: with the whole last check.

    Attributes:
      problem: the one that is trained on; its last check may be shorter.
      network: the network's sizes.
      num_episodes: how many fresh episodes.
      is_sampled: draw actions, as `generate` does; else take the mean.
      seed: of the episodes.
    """

    problem: Problem
    network: NetworkConfig
    num_episodes: int = 256
    is_sampled: bool = True
    seed: int = 0

    @cached_property
    def rules(self) -> Rules:
        """Those of training with an engine that makes the whole last check."""
        config = self.problem.config
        whole = replace(config.stability, stand_full_steps=StabilityConfig().stand_full_steps)
        physics = make_physics(self.problem.world.layout, whole, config.engine, config.num_threads)
        return replace(self.problem.rules, physics=physics)

    @cached_property
    def _policy(self) -> TrainedPolicy:
        return make_policy(self.rules, self.network, None, self.is_sampled)

    @cached_property
    def _rollout(self) -> Rollout:
        return Rollout()

    def __call__(self, params: Any) -> dict[str, Any]:
        """Success with its 95 % interval, and how it was found: JSON values.

        Args:
          params: the weights; they are evaluated at half precision, as they are stored.
        """
        params = jax.tree.map(lambda leaf: np.float32(np.float16(leaf)), params)
        return {
            **self._success(replace(self._policy, params=params)),
            "action": "sampled" if self.is_sampled else "mean",
            "last_check_steps": self.rules.physics.config.stand_full_steps,
        }

    def random(self) -> dict[str, Any]:
        """The success of `random` in as many episodes of the same world: what a policy has to beat."""
        return self._success(make_proposer("random", self.rules))

    def _success(self, proposer: Proposer) -> dict[str, Any]:
        key = jax.random.fold_in(new_key(self.seed), _FRESH)
        width = min(BLOCK_SIZE, self.num_episodes)
        scenes = self._rollout.run_all(BlockSampler(self.rules, proposer), key, self.num_episodes, width)
        found = scenes.is_success
        low, high = wilson(int(found.sum()), len(found))
        return {
            "success": float(found.mean()),
            "low95": low,
            "high95": high,
            "filled": float(scenes.is_filled.mean()),
            "episodes": len(found),
        }
