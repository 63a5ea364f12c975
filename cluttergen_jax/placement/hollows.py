"""Which objects are hollow, and what fits into them: where it would come to lie if it were lowered in."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support_map import VOID
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.containers import BELOW_RIM, INNER, draw_contents
from cluttergen_jax.placement.heightmap import HeightMap
from cluttergen_jax.placement.methods.baselines import costs_of_staying
from cluttergen_jax.placement.orientations import MAX_RESTING
from cluttergen_jax.placement.search.fit import Candidates, UnderSide, lower_onto, support_share
from cluttergen_jax.placement.search.search import CandidateScores
from cluttergen_jax.placement.types import Geometry, Hollows
from cluttergen_jax.types import Array

_CELL = 0.0072
# Along each side of a hollow, and of half a turn, at which it is looked whether an object fits.
_PLACES = 7
_TURNS = 4

_TRIED = 16
"""Draws of objects that fit into others, to know how many there can be."""
_LEAST_TRUST = 0.6
"""In what is lowered into a hollow, as `spread` has it, of the best place that was tried."""


def find_hollows(objects: Sequence[ObjectAsset], geometry: Geometry) -> Hollows:
    """The hollows of a world's K objects, and what fits into them; outside `jit`."""
    boxes = [_hollow_box(asset) for asset in objects]
    center, half = (np.array([box[part] for box in boxes]) for part in (0, 1))
    is_container = np.array([hollow_of(asset) is not None for asset in objects])
    fits = np.zeros((len(objects), len(objects)), bool)
    reach = max(float(np.linalg.norm(asset.half_extents[:2])) for asset in objects) + 3 * _CELL
    steps = (np.arange(_PLACES) + 0.5) / _PLACES * 2 - 1
    grid = np.stack(np.meshgrid(steps, steps, np.pi * np.arange(_TURNS) / _TURNS), -1).reshape(
        -1, 3
    )
    *bodies, owner = _bodies_of(geometry)
    for index in np.flatnonzero(is_container).tolist():
        at = Candidates(
            jnp.array(grid[:, :2] * half[index, :2] + center[index, :2]), jnp.array(grid[:, 2])
        )
        rim = center[index, 2] + half[index, 2] + objects[index].half_extents[2]
        opening = jnp.array([*np.sort(half[index, :2]), rim])
        heights = _map_of(geometry, index, reach)
        np.logical_or.at(
            fits[:, index], owner, np.asarray(_fit_into(heights, at, tuple(bodies), opening))
        )
        fits[index, index] = False
    # A bowl in a pot takes the place of many things; it has to where nothing else fits.
    is_leaf = np.logical_not(fits.any(0))
    if fits[is_leaf].any():
        fits[~is_leaf] = False
    return jax.tree.map(
        jnp.asarray, Hollows(center.astype(np.float32), half.astype(np.float32), is_container, fits)
    )


def check_contained(
    asked: float, num_objects: int, names: Sequence[str], geometry: Geometry
) -> None:
    """Refuses more objects inside of others than fit into any (ConfigError)."""
    hollows = geometry.hollows
    number = math.ceil(asked)
    assert hollows is not None
    nothing = jnp.zeros(geometry.num_objects, bool)
    keys = jax.random.split(jax.random.key(0), _TRIED)
    drawn = jax.vmap(
        lambda key: draw_contents(key, geometry, nothing, number, num_objects)[0].sum()
    )(keys)
    if (most := int(drawn.max())) < number:
        named = [names[index] for index in np.flatnonzero(hollows.fits.any(0)).tolist()]
        given = f"clutter contained={asked:g} with {num_objects} objects"
        given += f" of which up to {most} fit into others"
        found = (
            f"up to {most}, in {', '.join(named)}"
            if most
            else "objects of which some fit into others"
        )
        raise ConfigError(
            given, found, "more bowls, pots or pans and smaller objects, as of dining+kitchen"
        )


def with_upright_containers(geometry: Geometry) -> Geometry:
    """The same objects, where those into which others fit are always released upright."""
    found = geometry.orientations
    hollows = geometry.hollows
    if found is None or hollows is None:
        return geometry
    upright = jnp.where(jnp.arange(found.log_weight.shape[1]) == 0, 0.0, -jnp.inf)
    holds = jnp.any(hollows.fits, axis=0)[:, None]
    return geometry.replace(
        orientations=found.replace(log_weight=jnp.where(holds, upright, found.log_weight))
    )


def _hollow_box(asset: ObjectAsset) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half extents, object frame, metres; of what is not hollow, of the inner part of its box."""
    hollow = hollow_of(asset)
    if hollow is None:
        return np.zeros(3), asset.half_extents * [INNER, INNER, 1.0]
    low = hollow.points.min(0) - hollow.pitch / 2
    high = hollow.points.max(0) + hollow.pitch / 2
    return (low + high) / 2, (high - low) / 2


def _map_of(geometry: Geometry, index: int, reach: float) -> HeightMap:
    """The heights of one object above the floor on which it stands, in its own frame."""
    surface = np.asarray(geometry.surface)[np.asarray(geometry.surface_owner) == index].reshape(
        -1, 3
    )
    side = 2 * int(np.ceil(reach / _CELL))
    height = np.full((side, side), VOID, np.float32)
    cells = np.clip(np.floor(surface[:, :2] / _CELL).astype(int) + side // 2, 1, side - 2)
    np.maximum.at(height, tuple(cells.T), surface[:, 2] + float(geometry.half_extents[index, 2]))
    corner = jnp.full(2, -side // 2 * _CELL, jnp.float32)
    return HeightMap(jnp.asarray(height), corner, (_CELL, _CELL))


def _bodies_of(geometry: Geometry) -> tuple[UnderSide, Array, np.ndarray]:
    """M under-sides, f32[M, 3] half extents and i[M], whose: of all objects, upright or in resting poses."""
    found = geometry.orientations
    if found is None:
        under = UnderSide(
            geometry.column_xy,
            geometry.column_bottom,
            geometry.is_column,
            geometry.center_of_mass[:, :2],
        )
        return under, geometry.half_extents, np.arange(geometry.num_objects)
    owner, which = np.nonzero(np.asarray(found.is_one)[:, :MAX_RESTING])
    under = UnderSide(
        found.column_xy, found.column_bottom, found.is_column, found.center_of_mass[..., :2]
    )
    under, half = jax.tree.map(lambda leaf: leaf[owner, which], (under, found.half_extents))
    return under, half, owner


@jax.jit
def _fit_into(
    heights: HeightMap, candidates: Candidates, bodies: tuple[UnderSide, Array], opening: Array
) -> Array:
    """bool[M]: which bodies come to lie in a container.

    Args:
      opening: f32[3], metres: half of its sides, the smaller one first, and the height of its rim.
    """

    def fits(body: tuple[UnderSide, Array]) -> Array:
        under, half = body
        fit = lower_onto(under, heights, candidates)
        low = fit.rest + jnp.min(jnp.where(under.is_column, under.bottom, jnp.inf))
        support = support_share(under, heights, candidates, fit.rest)
        nothing = jnp.zeros_like(support)
        scores = CandidateScores(fit, nothing + 1.0, support, nothing, jnp.int32(0))
        trust = jnp.exp(-sum(costs_of_staying(scores)))
        # What is wider stands across it.
        is_narrow = jnp.all(jnp.sort(half[:2]) <= opening[:2])
        return is_narrow & jnp.any((low < opening[2] - BELOW_RIM) & (trust > _LEAST_TRUST))

    return jax.lax.map(fits, bodies)
