"""The guided placer: a uniform draw among the candidates that the stability network trusts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.errors import PoolError
from cluttergen_jax.learning.networks.stability import (
    NUM_FEATURES,
    StabilityNet,
    StabilityNetConfig,
    features_of,
)
from cluttergen_jax.learning.policies.checkpoint import Checkpoint
from cluttergen_jax.learning.ppo.checkpoint import read_policy
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.candidate_sampler import (
    CandidateConfig,
    CandidateSampler,
    CandidateSet,
)
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

KIND = "stability"
"""Of its network, as a checkpoint's record names it."""


class Guided(CandidateSampler, eq=False):
    """A `CandidateSampler` by a network that was fitted to attempts; it knows no objects and no pool.

    Attributes:
      params: the network's weights; network: its sizes.
      is_robust: ask whether a candidate would stand under change, too.
    """

    params: Any = None
    network: StabilityNetConfig = struct.field(pytree_node=False, default=StabilityNetConfig())
    is_robust: bool = struct.field(pytree_node=False, default=False)

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """See `CandidateSampler`."""
        features = features_of(self.search.rules, episode, candidates)
        predicted: Any = StabilityNet(self.network).apply(self.params, features)
        return jax.nn.sigmoid(predicted.is_robust if self.is_robust else predicted.stands)


def blank_params(network: StabilityNetConfig) -> Any:
    """Parameters of the network's shapes, all zero."""
    shapes = jax.eval_shape(StabilityNet(network).init, new_key(0), jnp.zeros((1, NUM_FEATURES)))
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)


def make_guided(
    rules: Rules, network: StabilityNetConfig, params: Any = None, **config: Any
) -> Guided:
    """The placer for one world, with given weights.

    Args:
      config: fields of `CandidateConfig`.
    """
    return Guided(LowestFit(rules), CandidateConfig(**config), params=params, network=network)


def load_guided(checkpoint: Checkpoint, rules: Rules) -> Guided:
    """The placer with the weights of a checkpoint; PoolError where the checkpoint is damaged."""
    try:
        network = StabilityNetConfig(**checkpoint.trained.network)
    except TypeError as error:
        raise PoolError(
            f"{checkpoint.path / 'record.json'} does not say what network it holds ({error})",
            hint="a policy that `cluttergen train --variant guided` of this version left",
        ) from error
    is_robust = rules.physics.config.robust_tilt > 0
    placer = replace(make_guided(rules, network), is_robust=is_robust)
    return replace(placer, params=read_policy(checkpoint.path, blank_params(network)))
