"""What is hollow, what fits into it, and in which orientations it goes in.

Of a compiled world, before its first scene: by geometry, and by releases in its physics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_map import VOID
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, rotation_matrix, yaw_quaternion
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import BatchEngine
from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.containers import BELOW_RIM, INNER, MOST_WIDE, draw_contents, is_in
from cluttergen_jax.placement.heightmap import HeightMap
from cluttergen_jax.placement.methods.baselines import costs_of_staying
from cluttergen_jax.placement.orientations import MAX_RESTING
from cluttergen_jax.placement.rules import OWN_SHARE
from cluttergen_jax.placement.search import (
    CLEARANCE,
    Candidates,
    CandidateScores,
    UnderSide,
    lower_onto,
    support_share,
    under_side,
)
from cluttergen_jax.placement.types import Geometry, Hollows, take
from cluttergen_jax.placement.world import (
    World,
    compile_layout,
)
from cluttergen_jax.types import Array, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.placement.problem import ProblemConfig

_CELL = 0.0072
# Along each side of a hollow, and of half a turn, at which it is looked whether an object fits.
_PLACES = 7
_TURNS = 4

_TRIED = 16
"""Draws of objects that fit into others, to know how many there can be."""
_MOST_TRIED = 24
"""Pairs of an object and a container of which ways in are tried, each for about a second."""
_RELEASES = 8
"""Of an object over a container, in each orientation; in a spiral around its middle."""
_GOLDEN = 0.618
# Of half the opening, the least and the most that a release is from its middle.
_NEAREST = 0.03
_FARTHEST = 0.15
_WELL_IN = 0.5
"""What upright stays inside in so many of its releases is mostly released so, with the odds below."""
_UPRIGHT_ODDS = 3.0
_LEAST_TRUST = 0.6
"""In what is lowered into a hollow, as `spread` has it, of the best place that was tried."""


def find_hollows(objects: Sequence[ObjectAsset], geometry: Geometry) -> Hollows:
    """The hollows of a world's K objects, and what fits into them; outside `jit`."""
    center, half = np.swapaxes([_hollow_box(asset) for asset in objects], 0, 1)
    is_container = np.array([hollow_of(asset) is not None for asset in objects])
    fits = np.zeros((len(objects), len(objects)), bool)
    under, sizes, owner = _bodies_of(geometry)
    for index in np.flatnonzero(is_container).tolist():
        at, heights, opening = _over_hollow(objects, geometry, index)
        found = np.asarray(_fit_into(heights, at, (under, sizes), opening))
        np.logical_or.at(fits[:, index], owner, found)
        fits[index, index] = False
    # A bowl in a pot takes the place of many things; it has to where nothing else fits.
    is_leaf = np.logical_not(fits.any(0))
    if fits[is_leaf].any():
        fits[~is_leaf] = False
    hollows = Hollows(center.astype(np.float32), half.astype(np.float32), is_container, fits)
    return jax.tree.map(jnp.asarray, hollows)


def find_ways_in(
    world: World, config: ProblemConfig, geometry: Geometry, pairs: np.ndarray
) -> tuple[Array, Array]:
    """In which orientations objects go into containers; outside `jit`.

    Each is let go alone, over the container and by the rules of attempts, in some turns and places around
    the middle. The weight of an orientation is the square of the share that come to rest inside and held.
    Upright alone where the object fits so, in three of four draws where most of its releases do.

    Args:
      pairs: bool[K, K], row: an object, column: the container; of others the weights are the usual ones.

    Returns:
      f32[K, K, P], log weights; bool[K, K], False for the pairs of which nothing was found that goes in. They
      have weights by the depth that they reach, and the usual ones where they reach none.
    """
    found = geometry.orientations
    hollows = geometry.hollows
    assert found is not None
    assert hollows is not None
    log_weight = np.repeat(np.asarray(found.log_weight)[:, None], len(pairs), axis=1)
    fits = np.asarray(hollows.fits)
    log_weight[pairs & fits] = np.where(np.arange(log_weight.shape[2]) == 0, 0.0, -np.inf)
    goes_in = np.ones(pairs.shape, bool)
    lacking = np.argwhere(pairs & ~fits).tolist()
    trials = _WayTrials(world, config, geometry) if len(lacking) <= _MOST_TRIED else None
    for index, container in lacking:
        which = np.flatnonzero(np.asarray(found.is_one)[index])
        at, heights, opening = _over_hollow(world.objects, geometry, container)
        bodies = take((under_side(found), found.half_extents), (index, which))
        share = np.zeros(len(which))
        if trials is not None:
            share = trials.shares(index, container, which, heights)
            goes_in[index, container] = share.any()
        if not share.any() and passes_through(
            world.objects[index].half_extents, hollows, container
        ):
            share = np.array(_depths_in(heights, at, bodies, opening), np.float64)
        weight = share**2
        if share[0] >= _WELL_IN:
            weight[0] = _UPRIGHT_ODDS * max(weight[1:].sum(), 1.0)
        if weight.any():
            log_weight[index, container] = -np.inf
            with np.errstate(divide="ignore"):
                log_weight[index, container, which] = np.log(weight)
    if trials is not None:
        trials.engine.free()
    return jnp.asarray(log_weight), jnp.asarray(goes_in)


def passes_through(half_extents: np.ndarray, hollows: Hollows, container: int) -> bool:
    """Whether an object's two shorter sides, f[3] its half sides, fit through a container's opening.

    What does not may still hang over its rim like a hood, or go in with a narrow end.
    """
    opening = np.sort(np.asarray(hollows.half_extents)[container, :2])
    return bool(np.all(np.sort(half_extents)[:2] <= opening))


class _WayTrials:
    """Releases single objects over single containers, which stand on a table.

    Attributes:
      engine: of that world.
    """

    def __init__(self, world: World, config: ProblemConfig, geometry: Geometry) -> None:
        table = cuboid_table()
        layout = compile_layout(world.names, world.objects, table, config.stability, config.contact)
        stability = replace(config.stability, robust_tilt=0.0)
        self.engine = cast(BatchEngine, make_physics(layout, stability, "native"))
        self._top = layout.top
        self._objects = world.objects
        self._geometry = geometry
        self._least = config.placement.min_margin

    def _is_inside(self, index: int, container: int, poses: np.ndarray) -> bool:
        """Whether an object is in a container as people mean it, at world poses f[K, 7].

        All of it that is below the rim is within the opening, so that it is no hood, and it reaches half way
        down, or has half of its corners below the rim, so that it does not merely hook over that.
        """
        hollows = self._geometry.hollows
        assert hollows is not None
        turn = rotation_matrix(poses[index, 3:])
        other = rotation_matrix(poses[container, 3:])
        points = self._objects[index].vertices @ turn.T + poses[index, :3] - poses[container, :3]
        offset = points @ other - np.asarray(hollows.center)[container]
        half = np.asarray(hollows.half_extents)[container]
        is_below = offset[:, 2] < half[2] - BELOW_RIM
        is_within = np.all(np.abs(offset[is_below, :2]) <= half[:2] + _CELL)
        return bool(is_within and (offset[:, 2].min() <= 0 or is_below.mean() >= _WELL_IN))

    def shares(
        self, index: int, container: int, which: np.ndarray, heights: HeightMap
    ) -> np.ndarray:
        """f64[n]: of releases in orientations `which`, i[n], those that come to rest inside and held."""
        geometry = self._geometry
        hollows = geometry.hollows
        orientations = geometry.orientations
        assert hollows is not None
        assert orientations is not None
        turn = 2 * np.pi * _GOLDEN * np.arange(_RELEASES)
        reach = np.linspace(_NEAREST, _FARTHEST, _RELEASES)[:, None]
        middle = np.asarray(hollows.center)[container]
        half = np.asarray(hollows.half_extents)[container, :2]
        xy = middle[:2] + reach * half * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        at = Candidates(jnp.asarray(xy, jnp.float32), jnp.asarray(turn, jnp.float32))
        rest = jax.vmap(lambda under: lower_onto(under, heights, at).rest)(
            take(under_side(orientations), (index, which))
        )
        number = len(which) * _RELEASES
        poses = np.tile(np.eye(7, dtype=np.float32)[3], (number, geometry.num_objects, 1))
        poses[:, container, 2] = self._top + geometry.half_extents[container, 2]
        poses[:, index, :2] = np.tile(xy, (len(which), 1))
        poses[:, index, 2] = self._top + np.asarray(rest).ravel() + CLEARANCE
        quaternion = np.asarray(orientations.quaternion)[index, which]
        for row in range(number):
            yaw = np.array(yaw_quaternion(turn[row % _RELEASES]))
            poses[row, index, 3:] = product(yaw, quaternion[row // _RELEASES])
        is_placed = np.isin(np.arange(geometry.num_objects), [index, container])
        settling = self.engine.settle_batch(
            poses, np.tile(is_placed, (number, 1)), np.full(number, index), np.ones(number, bool)
        )
        ended = jnp.asarray(settling.poses)
        subjects = Boxes.of(geometry.half_extents[index], ended[:, index])
        boxes = jax.vmap(hollows.boxes)(ended)
        openings = Boxes(boxes.center[:, container], boxes.sides[:, container])
        own = np.asarray(jax.vmap(geometry.own_margins_at)(ended))[:, index]
        is_held = settling.margin[:, index] >= np.minimum(self._least, OWN_SHARE * own)
        is_well = np.asarray(is_in(subjects, openings)) & is_held
        is_well &= settling.verdict == int(Verdict.STABLE)
        for row in np.flatnonzero(is_well).tolist():
            is_well[row] = self._is_inside(index, container, settling.poses[row])
        return np.asarray(is_well.reshape(-1, _RELEASES).mean(1), np.float64)


def check_contained(
    asked: float, num_objects: int, names: Sequence[str], geometry: Geometry
) -> None:
    """Refuses more objects inside of others than fit into any (ConfigError)."""
    hollows = geometry.hollows
    number = math.ceil(asked)
    assert hollows is not None
    nothing = jnp.zeros(geometry.num_objects, bool)
    keys = jax.random.split(jax.random.key(0), _TRIED)

    def num_drawn(key: Array) -> Array:
        is_content, _ = draw_contents(key, geometry, nothing, number, num_objects)
        return is_content.sum()

    most = int(jax.vmap(num_drawn)(keys).max())
    if most >= number:
        return
    allowed = "objects of which some fit into others"
    if most:
        named = [names[index] for index in np.flatnonzero(hollows.fits.any(0)).tolist()]
        allowed = f"up to {most}, in {', '.join(named)}"
    raise ConfigError(
        f"clutter contained={asked:g} with {num_objects} objects of which up to {most} fit into others",
        allowed,
        "more bowls, pots or pans and smaller objects, as of dining+kitchen",
    )


def with_upright_containers(geometry: Geometry) -> Geometry:
    """The same objects, where those into which others fit are always released upright."""
    found = geometry.orientations
    hollows = geometry.hollows
    if found is None or hollows is None:
        return geometry
    upright = jnp.where(jnp.arange(found.log_weight.shape[1]) == 0, 0.0, -jnp.inf)
    holds = jnp.any(hollows.fits, axis=0)[:, None]
    log_weight = jnp.where(holds, upright, found.log_weight)
    return geometry.replace(orientations=found.replace(log_weight=log_weight))


def _hollow_box(asset: ObjectAsset) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half extents, object frame, metres; of what is not hollow, of the inner part of its box."""
    hollow = hollow_of(asset)
    if hollow is None:
        return np.zeros(3), asset.half_extents * [INNER, INNER, 1.0]
    low = hollow.points.min(0) - hollow.pitch / 2
    high = hollow.points.max(0) + hollow.pitch / 2
    return (low + high) / 2, (high - low) / 2


def _over_hollow(
    objects: Sequence[ObjectAsset], geometry: Geometry, index: int
) -> tuple[Candidates, HeightMap, Array]:
    """Places over an object's hollow, its heights, and f32[4], metres: half of the opening's sides, the
    smaller one first, and the heights of its rim and of its floor."""
    center, half = _hollow_box(objects[index])
    reach = max(float(np.linalg.norm(asset.half_extents[:2])) for asset in objects) + 3 * _CELL
    steps = (np.arange(_PLACES) + 0.5) / _PLACES * 2 - 1
    turns = np.pi * np.arange(_TURNS) / _TURNS
    grid = np.stack(np.meshgrid(steps, steps, turns), -1).reshape(-1, 3)
    at = Candidates(jnp.array(grid[:, :2] * half[:2] + center[:2]), jnp.array(grid[:, 2]))
    middle = center[2] + objects[index].half_extents[2]
    opening = jnp.array([*np.sort(half[:2]), middle + half[2], middle - half[2]])
    return at, _map_of(geometry, index, reach), opening


def _map_of(geometry: Geometry, index: int, reach: float) -> HeightMap:
    """The heights of one object above the floor on which it stands, in its own frame."""
    is_own = np.asarray(geometry.surface_owner) == index
    surface = np.asarray(geometry.surface)[is_own].reshape(-1, 3)
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
        return under_side(geometry), geometry.half_extents, np.arange(geometry.num_objects)
    owner, which = np.nonzero(np.asarray(found.is_one)[:, :MAX_RESTING])
    under, half = take((under_side(found), found.half_extents), (owner, which))
    return under, half, owner


@jax.jit
def _fit_into(
    heights: HeightMap, candidates: Candidates, bodies: tuple[UnderSide, Array], opening: Array
) -> Array:
    """bool[M]: which bodies come to lie in a container.

    Args:
      opening: f32[4], see `_over_hollow`.
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


@jax.jit
def _depths_in(
    heights: HeightMap, candidates: Candidates, bodies: tuple[UnderSide, Array], opening: Array
) -> Array:
    """f32[M]: how deep bodies reach into a container, of its depth; 0 for those that are not in it.

    Args:
      opening: f32[4], see `_over_hollow`.
    """
    rim = opening[2]

    def depth_of(body: tuple[UnderSide, Array]) -> Array:
        under, half = body
        low = lower_onto(under, heights, candidates).rest + under.lowest
        is_narrow = jnp.all(jnp.sort(half[:2]) <= MOST_WIDE * opening[:2])
        is_in = is_narrow & (low < rim - BELOW_RIM)
        share = jnp.clip((rim - low) / (rim - opening[3]), 0.0, 1.0)
        return jnp.max(jnp.where(is_in, share, 0.0))

    return jax.lax.map(depth_of, bodies)
