"""The head `scored`: candidates of a search on the partial maps, each with the chance that it will stand."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.downstream.fitting import blank_params, config_of, embedded_checkpoints
from cluttergen_jax.downstream.placer.map_search import best_apart, draw, join
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS, Example, PlacementQuery, Proposals
from cluttergen_jax.downstream.words import PlacerHead
from cluttergen_jax.errors import ConfigError, PoolError, closest
from cluttergen_jax.geometry import Array
from cluttergen_jax.learning import read_policy, read_record
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import (
    CLEARANCE,
    VOID,
    Candidates,
    HeightMap,
    base_share,
    cells_under,
    crowding,
    lower_onto,
    mean_under,
    support_share,
    touching,
)

NUM_FEATURES = 36
CROP_SIDE = 24
NUM_CHANNELS = 7
UNSEEN = 0.01
"""Metres between what was seen of a cell and what may be there, from which it counts as not seen."""

_CROP_MARGIN = 0.03
_OWN_REACH = 0.008
_NUM_SPARSE = 64
_FINE = 100.0
_COARSE = 10.0
_FINE_MOST = 2.0
_COARSE_MOST = 2.0
MIRRORED = (26, 27)
"""Places of the features that change their sign where x, or y, of the object's frame is mirrored."""


class OwnShape(struct.PyTreeNode):
    """The current object's under-side as a picture in its own frame, S x S points, axis 0 along x.

    Attributes:
      xy: f32[S * S, 2], metres: from side to side of its box, and 3 cm beyond.
      bottom: f32[S * S], metres: its lowest point there, that of the whole object where it is not.
      is_own: bool[S * S].
    """

    xy: Array
    bottom: Array
    is_own: Array


def own_shape(query: PlacementQuery) -> OwnShape:
    """The picture of one query's current object: the nearest of its columns at each point."""
    half = query.half_extents[:2] + _CROP_MARGIN
    line = (np.arange(CROP_SIDE) + 0.5) / CROP_SIDE * 2 - 1
    grid = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    xy = jnp.asarray(grid, jnp.float32) * half
    under = query.under
    distance = sum((xy[:, None, axis] - under.xy[:, axis]) ** 2 for axis in (0, 1))
    distance = jnp.where(under.is_column, distance, jnp.inf)
    nearest = jnp.argmin(distance, axis=1)
    # The sample of a large object's columns is sparse.
    reach = jnp.maximum(_OWN_REACH, 1.5 * jnp.sqrt(4 * half[0] * half[1] / under.xy.shape[0]))
    is_own = jnp.min(distance, axis=1) < reach**2
    lowest = jnp.min(jnp.where(under.is_column, under.bottom, jnp.inf))
    return OwnShape(xy, jnp.where(is_own, under.bottom[nearest], lowest), is_own)


def crops_of(heights: HeightMap, ceilings: HeightMap, shape: OwnShape, pose: Array) -> Array:
    """f32[N, S, S, NUM_CHANNELS]: the maps around poses f32[N, 4], in the object's own frame.

    Of each point: the height of the object's under-side above what was seen and above what may be there,
    both finely (centimetres) and coarsely (decimetres); whether it was not seen; whether there is nothing
    below; whether the object is above it.
    """
    cos = jnp.cos(pose[:, 3])[:, None]
    sin = jnp.sin(pose[:, 3])[:, None]
    x = cos * shape.xy[:, 0] - sin * shape.xy[:, 1] + pose[:, 0, None]
    y = sin * shape.xy[:, 0] + cos * shape.xy[:, 1] + pose[:, 1, None]
    cells = heights.index_of(x, y)
    height = heights.at(cells)
    ceiling = ceilings.at(cells)
    bottom = pose[:, 2, None] + shape.bottom
    is_void = height <= VOID
    channels = []
    for surface in (height, ceiling):
        clearance = jnp.where(is_void, _COARSE_MOST, bottom - surface)
        channels.append(jnp.clip(_FINE * clearance, -_FINE_MOST, _FINE_MOST))
        channels.append(jnp.clip(_COARSE * clearance, -_COARSE_MOST, _COARSE_MOST))
    is_unseen = (ceiling - height > UNSEEN) & ~is_void
    own = jnp.broadcast_to(shape.is_own, is_void.shape)
    channels += [each.astype(jnp.float32) for each in (is_unseen, is_void, own)]
    return jnp.stack(channels, axis=-1).reshape(len(pose), CROP_SIDE, CROP_SIDE, NUM_CHANNELS)


def features_of(query: PlacementQuery, pose: Array) -> Array:
    """f32[N, NUM_FEATURES]: what geometry tells of poses f32[N, 4], scaled so that it is about 1.

    Of the pose on both maps (what was seen, what may be there): its height above the rest, support, gap,
    blocked share, crowding; the shares of its columns over nothing, over what was not seen, and reaching into
    that; the share of its base that touches; how far it is from the region's sides. Of the object: half
    extents, centre of mass, own margin, slope at which it tips, share of the region. Then the height range,
    the region, and how much of it is taken and not seen. Nothing says which object it is.
    """
    candidates = Candidates(pose[:, :2], pose[:, 3])
    columns = jnp.concatenate(
        [_of_pose(query, candidates, pose), _of_maps(query, candidates, pose[:, 2])], axis=1
    )
    scene = _of_scene(query)
    return jnp.concatenate([columns, jnp.broadcast_to(scene, (len(pose), len(scene)))], axis=1)


def _of_maps(query: PlacementQuery, candidates: Candidates, z: Array) -> Array:
    """f32[N, 14]: of the seen surfaces, then of those that may be there."""
    found = []
    sparse = query.under.first(_NUM_SPARSE)
    for surface in (query.heights, query.ceilings):
        fit = lower_onto(query.under, surface, candidates)
        support = support_share(query.under, surface, candidates, fit.rest)
        above = z - fit.rest
        found += [
            jnp.clip(_FINE * above, -3.0, 3.0),
            jnp.clip(_COARSE * above, -3.0, 3.0),
            jnp.clip(support, -1.0, 1.0),
            _FINE * jnp.clip(fit.gap, 0.0, 0.05),
            jnp.log(jnp.clip(_FINE * fit.gap, 1e-2, 10.0)) / 4,
            fit.blocked,
            mean_under(sparse, occupancy_around(surface), candidates),
        ]
    return jnp.stack(found, axis=1)


def occupancy_around(surface: HeightMap) -> HeightMap:
    """How much of the surroundings of each cell is not bare top, 0 to 1, whatever the map's size.

    What is beyond the support counts as bare: maps of several worlds are padded with such cells.
    """
    return crowding(surface.replace(height=jnp.maximum(surface.height, 0.0)))


def _of_pose(query: PlacementQuery, candidates: Candidates, pose: Array) -> Array:
    """f32[N, 9]."""
    under = query.under
    z = pose[:, 2]
    cells = cells_under(under, query.heights, candidates)
    height = query.heights.at(cells)
    ceiling = query.ceilings.at(cells)
    is_void = height <= VOID
    hidden = jnp.where(is_void, 0.0, ceiling - height)
    bottom = z[:, None] + under.bottom
    total = jnp.maximum(under.is_column.sum(), 1)

    def share(values: Array) -> Array:
        return jnp.where(under.is_column, values, 0.0).sum(1) / total

    unseen = query.heights.replace(height=_unseen(query))
    inside = (query.region_half_extents - jnp.abs(pose[:, :2])) * _COARSE
    touches = touching(under, query.heights, candidates, z)
    return jnp.stack(
        [
            10 * jnp.clip(z - query.half_extents[2], -0.05, 0.3),
            share(is_void),
            share(hidden > UNSEEN),
            share(ceiling > bottom + 0.002),
            _COARSE * share(jnp.clip(hidden, 0.0, 0.2)),
            mean_under(under.first(_NUM_SPARSE), crowding(unseen), candidates),
            base_share(under, touches),
            jnp.clip(inside[:, 0], -0.2, 1.0),
            jnp.clip(inside[:, 1], -0.2, 1.0),
        ],
        axis=1,
    )


def _unseen(query: PlacementQuery) -> Array:
    """f32[W, H]: 1 where something may be that was not seen."""
    heights = query.heights.height
    ceilings = query.ceilings.height
    return ((ceilings - heights > UNSEEN) & (heights > VOID)).astype(jnp.float32)


def _of_scene(query: PlacementQuery) -> Array:
    """f32[13]: of the object (9), and of the scene."""
    half = query.half_extents
    center = query.center_of_mass
    own = jnp.clip(query.own_margin, 0.0, 0.1)
    region = query.region_half_extents
    is_there = query.heights.height > VOID
    total = jnp.maximum(is_there.sum(), 1)
    return jnp.stack(
        [
            *(10 * half),
            *(20 * center),
            20 * own,
            own / jnp.maximum(half[2] + center[2], 0.005) / 2,
            jnp.log(half[0] * half[1] / jnp.prod(region)) / 4,
            10 * query.height_range / 3,
            3 * region[0],
            3 * region[1],
            ((query.heights.height > 0.003) & is_there).sum() / total,
        ]
    )


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
        first = join(draw(keys[1], query, config.num_uniform), many)
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


KIND = "placer"
"""Of a checkpoint, as its record names it."""
HEADS = get_args(PlacerHead)
_HINT = "the folder `placer` of a run of `cluttergen placer train`"


def head_of_name(head: str) -> ScoredHead:
    """The untrained head of that name, of the usual sizes.

    Raises:
      ConfigError: there is no such head.
    """
    if head not in HEADS:
        raise ConfigError(f"head {head!r}", ", ".join(HEADS), "head='scored'", closest(head, HEADS))
    return ScoredHead()


def embedded_placers() -> dict[str, Path]:
    """The trained placers that come with the package, by the name of their head."""
    return embedded_checkpoints("placers")


def placer_folder(placer: str | Path) -> Path | None:
    """Where a trained placer is: that of a name that comes with the package, a folder of its own, or a run's.

    None if it is neither a name nor a folder.
    """
    if not str(placer):
        return None
    path = embedded_placers().get(str(placer), Path(placer))
    inner = path / "placer"
    if (inner / "record.json").is_file():
        return inner
    return path if path.is_dir() else None


def load_placer(path: Path) -> ScoredPlacer:
    """The placer in a folder.

    Raises:
      PoolError: there is none, it is damaged, of another kind or head, or of sizes that this version does
        not know.
    """
    try:
        record = read_record(path)
    except PoolError as error:
        raise PoolError(error.given, hint=_HINT) from error
    kind = record.get("kind", "pose")
    if kind != KIND:
        raise PoolError(f"{path} holds a network of kind {kind!r}, and no placer", hint=_HINT)
    if record.get("head") not in HEADS:
        given = f"{path} holds a placer with the head {record.get('head')!r}"
        raise PoolError(given, ", ".join(HEADS), _HINT)
    hint = "a placer that `cluttergen placer train` of this version left"
    head = ScoredHead(config_of(ScoredConfig, record, path, hint))
    temperature = record.get("temperature", 1.0)
    if not isinstance(temperature, int | float) or not 0 < temperature < 1e3:
        raise PoolError(
            f"{path / 'record.json'}: temperature {temperature!r}", "a positive number", _HINT
        )
    return head.placer(read_policy(path, blank_params(head)), float(temperature))
