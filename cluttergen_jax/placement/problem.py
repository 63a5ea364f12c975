"""The composition root: from names and numbers to a compiled world, its physics and its rules.

Where objects are to be inside of others, it finds which are hollow and what fits into them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.height_profile import HeightProfile
from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.assets.support import Rectangle, Ring, SupportAsset, cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.assets.support_map import VOID, check_keep_out, check_region
from cluttergen_jax.config import ContactConfig, StabilityConfig, check_workers
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import NumberedEngines, Physics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.containers import BELOW_RIM, INNER, draw_contents
from cluttergen_jax.placement.heightmap import HeightMap, make_support_map
from cluttergen_jax.placement.methods.baselines import costs_of_staying
from cluttergen_jax.placement.natural import Natural
from cluttergen_jax.placement.orientations import MAX_RESTING, make_orientations
from cluttergen_jax.placement.region import ChangedRegion, KeepOut, Region, find_change, make_region
from cluttergen_jax.placement.related import IN, relate_objects
from cluttergen_jax.placement.room import check_crowding, check_number, check_room, check_surface
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search import (
    Candidates,
    CandidateScores,
    UnderSide,
    lower_onto,
    support_share,
    under_side,
)
from cluttergen_jax.placement.surface_set import SurfaceSet
from cluttergen_jax.placement.types import Geometry, Hollows, Orientations, Start, take
from cluttergen_jax.placement.world import (
    NUM_COLUMN_SAMPLES,
    World,
    columns_of,
    compile_layout,
    geometry_of,
    make_world,
    on_device,
    pad_geometry,
    repeat_objects,
)
from cluttergen_jax.types import Array

SMALLEST_REGION = 0.02

_CELL = 0.0072
# Along each side of a hollow, and of half a turn, at which it is looked whether an object fits.
_PLACES = 7
_TURNS = 4

_TRIED = 16
"""Draws of objects that fit into others, to know how many there can be."""
_LEAST_TRUST = 0.6
"""In what is lowered into a hollow, as `spread` has it, of the best place that was tried."""


@dataclass(frozen=True)
class ProblemConfig:
    """Which objects on which support, judged how.

    Attributes:
      pool: a pool's name or folder.
      objects: names of the pool's objects to use; empty means all of them.
      repeat: allow duplicates when there are fewer than `placement.num_objects`.
      support: a support's name or folder; "table" is the paper's, "table-0.40x0.50" one of that size.
      surface: which of its surfaces objects are placed on; the first one if empty.
      region: the queried region; None takes the support's own.
      polygon: the corners of what of it counts, in the surface's frame, metres; none for all of it.
      shelf: each block of scenes draws so many of these objects for its own; 0 takes all of them for all
        scenes.
      weights: by which they are drawn: conditions and numbers (`assets.facts.weights_of`).
      balance: "label", "licence" or "source", of whose values each comes as often; "" for none.
      change: how it is changed at random in every episode, a name of `changes.REGION_CHANGES`; what is
        drawn stays within the support's own.
      is_piled: objects are let fall into a heap, for which room is judged by volume.
      engine: "auto", "native", "warp" or "jax".
      num_threads: of the native engine; 0 takes every core.
    """

    pool: str = "dining"
    objects: tuple[str, ...] = ()
    repeat: bool = False
    support: str = "table"
    surface: str = ""
    region: Rectangle | None = None
    polygon: Ring = ()
    shelf: int = 0
    weights: tuple[tuple[str, float], ...] = ()
    balance: str = ""
    change: str = "none"
    is_piled: bool = False
    engine: str = "auto"
    num_threads: int = 0
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    stability: StabilityConfig = field(default_factory=StabilityConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)

    def __post_init__(self) -> None:
        check_workers("num_threads", self.num_threads)
        find_change(self.change)


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that is needed to place objects: see `make_problem`."""

    config: ProblemConfig
    world: World
    rules: Rules
    region: Rectangle


def make_problem(
    config: ProblemConfig, standing: Sequence[ObjectAsset] = (), pool: Pool | None = None
) -> Problem:
    """Finds the assets, compiles the world and wires it to an engine.

    Args:
      standing: objects that stand there when an episode begins.
      pool: the one that `config` names, where it is at hand.

    Raises:
      PoolError: a pool, an object or a support cannot be found.
      ConfigError: more objects are asked for than there are, or the region is not on the support.
    """
    if config.shelf:
        raise ConfigError(
            f"a shelf of {config.shelf} objects, or a pool of so many that one is needed",
            "1 to 200 objects here; `generate` and `make_sampler` take any number",
            "fewer `objects`",
        )
    pool = pool or find_pool(config.pool, names=config.objects)
    chosen = [pool[name] for name in config.objects] if config.objects else list(pool.objects)
    support = find_support(config.support).on_surface(config.surface)
    region = config.region or support.region
    check_region(region, support)
    check_number(config.placement.num_objects, len(chosen), config.pool, config.repeat)
    check_surface(chosen, support, config.placement, config.contact, config.region is not None)
    check_room(chosen, support, region, config.placement, config.is_piled)
    check_crowding(chosen, config, support)
    return compose(chosen, support, config, standing)


@dataclass(frozen=True)
class WorldSizes:
    """What worlds have in common that share what is compiled.

    Attributes:
      physics: their engines.
      radius: metres, that of the largest object of any of them, seen from above.
      cut: makes an asset's columns.
    """

    physics: NumberedEngines
    radius: float
    cut: Callable[[ObjectAsset], HeightProfile]


def compose(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    config: ProblemConfig,
    standing: Sequence[ObjectAsset] = (),
    sizes: WorldSizes | None = None,
) -> Problem:
    """`make_problem` for assets that have been read already; the region may reach beyond the support.

    Args:
      standing: objects that stand there when an episode begins; they are the last ones of the world.
      sizes: of worlds that share what is compiled; whose engine it is then has to be entered in the rules.
    """
    wanted = config.placement.num_objects
    check_number(wanted, len(objects), config.pool, config.repeat)
    if (clutter := config.placement.clutter) is not None:
        clutter.check(wanted + len(standing))
    if wanted > len(objects):
        objects = repeat_objects(objects, wanted)
    objects, related = relate_objects(objects, config.placement, config.repeat)
    if related is not None and len(support.asked) > 1:
        given = "`relations` with several surfaces, between which objects are spread"
        raise ConfigError(given, "one `surface`", f"surface={support.asked[0][0].name!r}")
    region = config.region or support.region
    if min(region.half_extents) * 2 < SMALLEST_REGION:
        raise ConfigError(
            f"a region of {region}", f"sides from {SMALLEST_REGION} m", "a larger `region`"
        )
    cut = columns_of if sizes is None else sizes.cut
    world = make_world([*objects, *standing], support, config.stability, config.contact, cut)
    orientations = _orientations_of(world, config, cut)
    geometry = geometry_of(world, orientations)
    asked = None if clutter is None else clutter.contained
    if asked is not None or (related is not None and bool(jnp.any(related.kind == IN))):
        geometry = geometry.replace(hollows=find_hollows(world.objects, geometry))
    if asked:
        if sizes is None:
            check_contained(asked, wanted, world.names, geometry)
        geometry = with_upright_containers(geometry)
    physics: Physics | NumberedEngines
    if sizes is None:
        physics = make_physics(world.layout, config.stability, config.engine, config.num_threads)
    else:
        physics = sizes.physics
        runs = geometry.surface if orientations is None else orientations.surface
        geometry = pad_geometry(geometry, NUM_COLUMN_SAMPLES, _round_up(len(runs)))
    rules = Rules(
        config=config.placement,
        physics=physics,
        geometry=geometry,
        region=region_of(_largest_region(region, config.change, support), support),
        num_started=len(standing),
        map_radius=None if sizes is None else sizes.radius,
        related=related,
    )
    if config.placement.natural:
        asked_sense = (config.placement.sense, config.placement.seat)
        rules = rules.replace(natural=Natural.of(world.objects, *asked_sense))
    if support.named and len(support.asked) > 1:
        rules = _on_surfaces(rules, region, support, world)
    if config.change != "none":
        change = find_change(config.change)
        drawn = ChangedRegion(change, region, support.region, *plane_of(support))
        rules = rules.replace(draw_region=drawn)
    if config.placement.overhang != "any":
        rules = rules.replace(support_map=make_support_map(geometry))
    if config.polygon:
        rules = rules.replace(polygon=on_device(np.array(config.polygon)))
    return Problem(config, world, rules, region)


def _orientations_of(
    world: World, config: ProblemConfig, cut: Callable[[ObjectAsset], HeightProfile]
) -> Orientations | None:
    """In which a world's objects are released; None where all are upright."""
    kind = config.placement.poses
    if kind == "upright":
        return None
    layout = world.layout
    if world.support.named:
        # Resting poses are those on a level table with room above it.
        table = cuboid_table()
        layout = compile_layout(world.names, world.objects, table, config.stability, config.contact)
    return make_orientations(world.objects, layout, config.stability, kind, cut)


def _on_surfaces(rules: Rules, region: Rectangle, support: SupportAsset, world: World) -> Rules:
    """The rules for several surfaces of a support, with a region as large as the largest of theirs."""
    each_alone = [support.on_surface(each.name) for each, _ in support.asked]
    regions = [region_of(each.region, each) for each in each_alone]
    is_upright = rules.config.poses == "upright"
    half = np.max([each.region.half_extents for each in each_alone], axis=0).tolist()
    return rules.replace(
        region=region_of(replace(region, half_extents=tuple(half)), support),
        surfaces=SurfaceSet.of(support, world.objects, regions, is_upright),
    )


def _round_up(number: int) -> int:
    """The next power of two, or one and a half times one: few sizes for many numbers."""
    power = 1 << (number - 1).bit_length()
    return power * 3 // 4 if number <= power * 3 // 4 else power


def _largest_region(base: Rectangle, change: str, support: SupportAsset) -> Rectangle:
    """The region that a world is made for: its maps have to hold the largest that is drawn."""
    expansion = find_change(change).expansion
    half = [min(side + expansion, max(support.region.half_extents)) for side in base.half_extents]
    return replace(base, half_extents=(half[0], half[1])) if expansion else base


def region_of(rectangle: Rectangle, support: SupportAsset) -> Region:
    """A rectangle on a support's top as the decision process sees it."""
    top, surface = plane_of(support)
    given = [rectangle.center, rectangle.half_extents, rectangle.yaw, top]
    if surface is not None:
        given.append(surface)
    return make_region(*on_device([np.array(each) for each in given]))


def plane_of(support: SupportAsset) -> tuple[float, tuple[float, ...] | None]:
    """Where rectangles on a support lie: `top` and `surface` of `make_region`."""
    if not support.named or support.chosen.is_level:
        return support.top, None
    return 0.0, tuple(support.chosen.pose.tolist())


def keep_out_of(boxes: Sequence[Rectangle]) -> KeepOut:
    """Rectangles that objects must stay out of, as the decision process sees them."""
    found = KeepOut(
        center=np.array([box.center for box in boxes]).reshape(-1, 2),
        half_extents=np.array([box.half_extents for box in boxes]).reshape(-1, 2),
        yaw=np.array([box.yaw for box in boxes]),
    )
    return on_device(found)


Standing = tuple[Sequence[ObjectAsset], np.ndarray]
"""Objects that stand there when an episode begins, and their world poses f32[N, 7], metres, wxyz."""


@dataclass(frozen=True, eq=False)
class Setup:
    """A compiled problem, with what every episode begins with.

    Attributes:
      problem: the world, its rules and its queried region.
      keep_out: where no object may come to lie.
      start: what stands there already.
    """

    problem: Problem
    keep_out: KeepOut
    start: Start


def make_setup(
    config: ProblemConfig,
    keep_out: Sequence[Rectangle] = (),
    standing: Standing | None = None,
    assets: tuple[Sequence[ObjectAsset], SupportAsset] | None = None,
    pool: Pool | None = None,
) -> Setup:
    """Compiles the problem, around objects that stand there already if there are any.

    Args:
      assets: objects and a support that are at hand, in place of those that `config` names.
      pool: the one that `config` names, where it is at hand.

    Raises:
      ConfigError: a box cannot meet the region, or `make_problem` refuses.
      PoolError: something cannot be found or read.
    """
    objects, poses = standing or ((), np.zeros((0, 7), np.float32))
    problem = compose(*assets, config, objects) if assets else make_problem(config, objects, pool)
    check_keep_out(keep_out, problem.region)
    return Setup(problem, keep_out_of(keep_out), start_of(problem.world, poses))


def start_of(world: World, poses: np.ndarray) -> Start:
    """The start of episodes in a world whose last N objects stand at `poses` f32[N, 7]."""
    is_placed = np.arange(world.num_objects) >= world.num_objects - len(poses)
    everyone = np.tile(np.eye(7)[3], (world.num_objects, 1))
    everyone[is_placed] = poses
    return on_device(Start(everyone, is_placed))


def find_hollows(objects: Sequence[ObjectAsset], geometry: Geometry) -> Hollows:
    """The hollows of a world's K objects, and what fits into them; outside `jit`."""
    center, half = np.swapaxes([_hollow_box(asset) for asset in objects], 0, 1)
    is_container = np.array([hollow_of(asset) is not None for asset in objects])
    fits = np.zeros((len(objects), len(objects)), bool)
    reach = max(float(np.linalg.norm(asset.half_extents[:2])) for asset in objects) + 3 * _CELL
    steps = (np.arange(_PLACES) + 0.5) / _PLACES * 2 - 1
    turns = np.pi * np.arange(_TURNS) / _TURNS
    grid = np.stack(np.meshgrid(steps, steps, turns), -1).reshape(-1, 3)
    under, sizes, owner = _bodies_of(geometry)
    for index in np.flatnonzero(is_container).tolist():
        xy = grid[:, :2] * half[index, :2] + center[index, :2]
        at = Candidates(jnp.array(xy), jnp.array(grid[:, 2]))
        rim = center[index, 2] + half[index, 2] + objects[index].half_extents[2]
        opening = jnp.array([*np.sort(half[index, :2]), rim])
        heights = _map_of(geometry, index, reach)
        found = np.asarray(_fit_into(heights, at, (under, sizes), opening))
        np.logical_or.at(fits[:, index], owner, found)
        fits[index, index] = False
    # A bowl in a pot takes the place of many things; it has to where nothing else fits.
    is_leaf = np.logical_not(fits.any(0))
    if fits[is_leaf].any():
        fits[~is_leaf] = False
    hollows = Hollows(center.astype(np.float32), half.astype(np.float32), is_container, fits)
    return jax.tree.map(jnp.asarray, hollows)


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
