"""The head `scored`: candidates of a search on the partial maps, each with the chance that it will stand."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.downstream.placer.heads.features import (
    CROP_SIDE,
    MIRRORED,
    NUM_CHANNELS,
    NUM_FEATURES,
    OwnShape,
    crops_of,
    features_of,
    own_shape,
)
from cluttergen_jax.downstream.placer.map_search import best_apart, draw
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS, Example, PlacementQuery, Proposals
from cluttergen_jax.placement import CLEARANCE, Candidates, HeightMap, lower_onto
from cluttergen_jax.types import Array, Verdict

_PATCH = 4
_AUXILIARY = 0.3
"""Weight of the outputs that nobody acts upon: they make the hidden layers learn what matters."""
_NUM_COARSE = 24
_GAP_SCALE = 0.01
_DOUBT_COST = 0.5
_LIFTED = 0.005
_STEP = 0.01
_TURN = 0.2
_INSIDE = 0.002


@dataclass(frozen=True)
class ScoredConfig:
    """Sizes of the network, and how many candidates it is asked about.

    Attributes:
      patch_width: of what is made of each of the 6 x 6 patches of a picture; width: of the layers that join
        them with the features.
      num_uniform: candidates uniform over region and turn.
      num_drawn, num_finalists: the cheapest of many others.
      num_refined, num_near: of the best, so many are varied a little, so many times.
    """

    patch_width: int = 32
    width: int = 96
    num_uniform: int = 64
    num_drawn: int = 768
    num_finalists: int = 64
    num_refined: int = 8
    num_near: int = 6


class ScoreNet(nn.Module):
    """A perceptron on a candidate's features and on the picture around it, patch by patch.

    A candidate's picture is in its object's own frame, so that nothing is gained by looking for the same
    thing everywhere in it: a layer for patches and one for all of them do in less time what convolutions did.
    """

    config: ScoredConfig = ScoredConfig()

    @nn.compact
    def __call__(self, features: Array, crops: Array) -> Array:
        """f32[N, 3], logits: it stands, it disturbs, it overlaps or does not come to rest.

        Args:
          features: f32[N, NUM_FEATURES]; crops: f32[N, S, S, NUM_CHANNELS] (`features`).
        """
        number = len(crops)
        side = CROP_SIDE // _PATCH
        patches = crops.reshape(number, side, _PATCH, side, _PATCH, NUM_CHANNELS)
        patches = patches.transpose(0, 1, 3, 2, 4, 5).reshape(number, side * side, -1)
        seen = nn.relu(nn.Dense(self.config.patch_width)(patches)).reshape(number, -1)
        joined = [nn.relu(nn.Dense(self.config.width)(each)) for each in (seen, features)]
        hidden = nn.relu(nn.Dense(self.config.width)(jnp.concatenate(joined, axis=1)))
        return nn.Dense(3)(hidden)


class ScoredPlacer(struct.PyTreeNode, eq=False):
    """Proposes those candidates of a search that the network thinks most likely to stand.

    Attributes:
      params: the network's weights; config: its sizes, and those of the search.
      temperature: f32, by which logits are divided: 1, or what makes the chances those of the validation
        split.
    """

    params: Any
    config: ScoredConfig = struct.field(pytree_node=False, default=ScoredConfig())
    temperature: Any = 1.0

    def __call__(self, key: Array, query: PlacementQuery) -> Proposals:
        config = self.config
        keys = jax.random.split(key, 3)
        shape = own_shape(query)
        many = cheapest(query, draw(keys[0], query, config.num_drawn), config.num_finalists)
        first = concatenate_candidates(draw(keys[1], query, config.num_uniform), many)
        pose = lower_candidates(query, first)
        logit = self.logits(query, shape, pose)
        best = jax.lax.top_k(logit, config.num_refined)[1]
        varied = lower_candidates(query, near(keys[2], query, first.take(best), config.num_near))
        pose = jnp.concatenate([pose, varied])
        logit = jnp.concatenate([logit, self.logits(query, shape, varied)])
        best = best_apart(-logit, pose[:, :2], NUM_PROPOSALS)
        return Proposals(pose[best], jax.nn.sigmoid(logit[best] / self.temperature))

    def logits(self, query: PlacementQuery, shape: OwnShape, pose: Array) -> Array:
        """f32[N]: how likely poses f32[N, 4] are to stand; shape: of the query (`own_shape`)."""
        found: Any = ScoreNet(self.config).apply(
            self.params,
            features_of(query, pose),
            crops_of(query.heights, query.ceilings, shape, pose),
        )
        return found[:, 0]


def cheapest(query: PlacementQuery, candidates: Candidates, number: int) -> Candidates:
    """Those that would lie low and flat on what was seen, and little higher on what may be there."""
    sparse = query.under.first(_NUM_COARSE)
    seen = lower_onto(sparse, query.heights, candidates)
    doubt = lower_onto(sparse, query.ceilings, candidates).rest - seen.rest
    cost = seen.rest + (seen.gap / _GAP_SCALE) ** 2 + seen.hanging + _DOUBT_COST * doubt
    return candidates.take(jax.lax.top_k(-cost, number)[1])


def near(key: Array, query: PlacementQuery, candidates: Candidates, number: int) -> Candidates:
    """So many candidates around each of the given ones, within the region."""
    noise = jax.random.normal(key, (number, len(candidates.yaw), 3))
    half = jnp.maximum(query.region_half_extents - _INSIDE, 0.0)
    xy = jnp.clip(candidates.xy + _STEP * noise[..., :2], -half, half)
    return Candidates(xy.reshape(-1, 2), (candidates.yaw + _TURN * noise[..., 2]).reshape(-1))


def concatenate_candidates(*parts: Candidates) -> Candidates:
    """All of them."""
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *parts)


def lower_candidates(query: PlacementQuery, candidates: Candidates) -> Array:
    """f32[N, 4]: x, y, z and turn, `CLEARANCE` above first contact with what was seen."""
    z = lower_onto(query.under, query.heights, candidates).rest + CLEARANCE
    return jnp.column_stack([candidates.xy, z, candidates.yaw])


class ScoredExample(struct.PyTreeNode):
    """What the network learns from one pair of L labelled poses.

    Attributes:
      heights, ceilings: the maps; shape: of the object; half_height: f32, its own, metres.
      pose: f32[L, 4]; features: f32[L, NUM_FEATURES]; verdict: u8[L].
    """

    heights: HeightMap
    ceilings: HeightMap
    shape: OwnShape
    half_height: Array
    pose: Array
    features: Array
    verdict: Array

    @property
    def is_on(self) -> Array:
        """bool[L], where it would be let go above other objects."""
        return self.pose[..., 2] > self.half_height[..., None] + _LIFTED


@dataclass(frozen=True)
class ScoredHead:
    """Learns by cross-entropy from the verdicts of physics on the candidates of each pair."""

    config: ScoredConfig = field(default_factory=ScoredConfig)
    kind = "scored"

    def prepare(self, example: Example) -> ScoredExample:
        query = example.query
        return ScoredExample(
            heights=query.heights,
            ceilings=query.ceilings,
            shape=own_shape(query),
            half_height=query.half_extents[2],
            pose=example.candidate,
            features=features_of(query, example.candidate),
            verdict=example.verdict,
        )

    def init(self, key: Array) -> Any:
        crops = jnp.zeros((1, CROP_SIDE, CROP_SIDE, NUM_CHANNELS))
        return ScoreNet(self.config).init(key, jnp.zeros((1, NUM_FEATURES)), crops)

    def loss(
        self, params: Any, examples: ScoredExample, key: Array
    ) -> tuple[Array, dict[str, Array]]:
        """See `checkpoint.Head`; every pair is mirrored along x and y of its object as a coin falls."""
        is_mirrored = jax.random.bernoulli(key, shape=(2, len(examples.verdict)))
        logits = self._logits(params, examples, is_mirrored)
        verdict = examples.verdict.reshape(-1)
        wrong = {
            "stands": verdict == int(Verdict.STABLE),
            "disturbs": verdict == int(Verdict.DISPLACED),
            "overlaps": (verdict == int(Verdict.PENETRATING)) | (verdict == int(Verdict.UNSETTLED)),
        }
        losses = {
            name: optax.sigmoid_binary_cross_entropy(logits[:, number], label * 1.0).mean()
            for number, (name, label) in enumerate(wrong.items())
        }
        total = losses["stands"] + _AUXILIARY * (losses["disturbs"] + losses["overlaps"])
        return total, losses

    def scores(self, params: Any, examples: ScoredExample) -> Array:
        """f32[B, L]: the logits of the labelled poses."""
        nothing = jnp.zeros((2, len(examples.verdict)), bool)
        return self._logits(params, examples, nothing)[:, 0].reshape(examples.verdict.shape)

    def _logits(self, params: Any, examples: ScoredExample, is_mirrored: Array) -> Array:
        crops = jax.vmap(_crops)(examples)
        features = examples.features
        for axis in (0, 1):
            flip = is_mirrored[axis]
            crops = jnp.where(flip[:, None, None, None, None], jnp.flip(crops, axis + 2), crops)
            sign = jnp.where(flip, -1.0, 1.0)
            features = features.at[..., MIRRORED[axis]].multiply(sign[:, None])
        found: Any = ScoreNet(self.config).apply(
            params, features.reshape(-1, NUM_FEATURES), crops.reshape(-1, *crops.shape[2:])
        )
        return found

    def placer(self, params: Any, temperature: float = 1.0) -> ScoredPlacer:
        return ScoredPlacer(params, self.config, np.float32(temperature))


def _crops(example: ScoredExample) -> Array:
    return crops_of(example.heights, example.ceilings, example.shape, example.pose)
