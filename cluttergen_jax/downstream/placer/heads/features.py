"""Candidate features: what the partial maps tell of a pose, as numbers and as a small picture around it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.placement import (
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
from cluttergen_jax.types import Array

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
