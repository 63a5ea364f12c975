"""The guided placer: a uniform draw among the candidates that its stability network trusts."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.learning.policies.checkpoint import Checkpoint
from cluttergen_jax.learning.ppo.checkpoint import read_policy
from cluttergen_jax.placement import Episode, Rules
from cluttergen_jax.placement.candidate_sampler import (
    CandidateConfig,
    CandidateSampler,
    CandidateSet,
)
from cluttergen_jax.placement.methods.baselines import LowestFit, costs_of_staying
from cluttergen_jax.types import Array

NUM_FEATURES = 24
NUM_HEADS = 5
_DEEPEST = -0.05
_HIGHEST = 0.3


@dataclass(frozen=True)
class StabilityNetConfig:
    """Sizes of the stability network.

    Attributes:
      width: of its hidden layers; depth: how many there are.
    """

    width: int = 64
    depth: int = 2


class StabilityPrediction(struct.PyTreeNode):
    """What the network expects of N candidates.

    Attributes:
      stands: f32[N], logit: the attempt would be stable.
      is_robust: f32[N], logit: it would be stable, and stay so under change (`StabilityConfig.robust_tilt`).
      disturbs: f32[N], logit: a placed object would be moved.
      shift: f32[N], decimetres that the object would move in plan as it settles.
      margin: f32[N], its support margin at rest, in units of 5 cm.
    """

    stands: Array
    is_robust: Array
    disturbs: Array
    shift: Array
    margin: Array


class StabilityNet(nn.Module):
    """A perceptron on what geometry tells of a candidate (`features_of`)."""

    config: StabilityNetConfig = StabilityNetConfig()

    @nn.compact
    def __call__(self, features: Array) -> StabilityPrediction:
        """Args: features: f32[..., NUM_FEATURES]."""
        hidden = features
        for _ in range(self.config.depth):
            hidden = nn.relu(nn.Dense(self.config.width)(hidden))
        heads = nn.Dense(NUM_HEADS)(hidden)
        return StabilityPrediction(*(heads[..., index] for index in range(NUM_HEADS)))


def features_of(rules: Rules, episode: Episode, candidates: CandidateSet) -> Array:
    """f32[N, NUM_FEATURES]: what is known of each candidate, scaled so that it is about 1.

    Of the candidate: lift and rest (decimetres), support, gap (centimetres), blocked and hanging shares,
    crowding, the cost of staying and its logarithm; whether it would lie on an object, how many are below
    (thirds), and the margin and the offset of the centre of mass over what would carry it (5 cm). Of the
    object: half extents (decimetres), centre of mass and own margin (5 cm), the slope at which it tips; then
    the objects placed (twenties), the region's height (30 cm) and the logarithm of the object's share of the
    region. Nothing says which object it is, or of which pool.
    """
    scores = candidates.found.scores
    fit = candidates.found.scores.fit
    supporters = candidates.supporters
    body = rules.body(episode)
    cost = sum(costs_of_staying(scores))
    of_candidates = jnp.stack(
        [
            10 * jnp.clip(scores.lift, _DEEPEST, _HIGHEST),
            jnp.clip(scores.support, -1, 1),
            100 * jnp.clip(fit.gap, 0, 0.05),
            fit.blocked,
            fit.hanging,
            scores.crowd,
            10 * jnp.clip(fit.rest, _DEEPEST, _HIGHEST),
            jnp.clip(cost, 0.0, 2.0),
            jnp.log(jnp.clip(cost, 1e-3, 10.0)) / 4,
            supporters.is_on.astype(jnp.float32),
            supporters.level / 3,
            20 * jnp.clip(supporters.margin, -0.05, 0.1),
            20 * supporters.offset,
        ],
        axis=1,
    )
    half = body.half_extents
    center = body.center_of_mass
    height = body.height
    own = jnp.clip(body.own_margin, 0.0, 0.1)
    of_object = jnp.concatenate(
        [
            10 * half,
            20 * center,
            jnp.stack(
                [
                    20 * own,
                    # How far it may lean on flat ground before it tips.
                    own / jnp.maximum(height + center[2], 0.005) / 2,
                    episode.is_placed.sum() / 20,
                    10 * rules.height_range(episode) / 3,
                    jnp.log(4 * half[0] * half[1] / (4 * jnp.prod(episode.region.half_extents)))
                    / 4,
                ]
            ),
        ]
    )
    shape = (of_candidates.shape[0], of_object.shape[0])
    return jnp.concatenate([of_candidates, jnp.broadcast_to(of_object, shape)], axis=1)


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
    """Parameters of the network's shapes, all zero, without tracing how it begins."""
    widths = [NUM_FEATURES, *[network.width] * network.depth, NUM_HEADS]
    layers = {
        f"Dense_{place}": {
            "bias": np.zeros(after, np.float32),
            "kernel": np.zeros((before, after), np.float32),
        }
        for place, (before, after) in enumerate(itertools.pairwise(widths))
    }
    return {"params": layers}


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
    network = checkpoint.sizes(StabilityNetConfig)
    params = read_policy(checkpoint.path, blank_params(network))
    is_robust = rules.physics.config.robust_tilt > 0
    return replace(make_guided(rules, network, params), is_robust=is_robust)
