"""The composition root: from names and numbers to a compiled world, its physics and its rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.height_profile import HeightProfile
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.assets.support_map import check_keep_out, check_region, rim_height
from cluttergen_jax.config import ContactConfig, StabilityConfig, check_workers
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import NumberedEngines
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.physics.protocol import Physics
from cluttergen_jax.placement.config import MAX_SLOTS, PlacementConfig
from cluttergen_jax.placement.region import ChangedRegion, KeepOut, Region, find_change, make_region
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.support_map import SupportMap
from cluttergen_jax.placement.types import Geometry, Start
from cluttergen_jax.placement.world import NUM_COLUMN_SAMPLES, World, columns_of, make_world, repeat_objects

SMALLEST_REGION = 0.02
MOST_CROWDED = 8.0
"""Footprints over the region's area from which a request is refused. Objects overhang and stand on others:
`drop` fills 2 of 16 tables with ten of dining at 1.7, none at 4.2; only a stack of plates gets farther."""
MOST_FULL = 1.0
"""Volume of the smallest objects' hulls over that of what holds them, from which a pile is refused."""
_RUN = 64
_TOUCHING = 1e-4


@dataclass(frozen=True)
class ProblemConfig:
    """Which objects on which support, judged how.

    Attributes:
      pool: a pool's name or folder.
      objects: names of the pool's objects to use; empty means all of them.
      repeat: allow duplicates when there are fewer than `placement.num_objects`.
      support: a support's name or folder; "table" is the paper's, "table-0.40x0.50" one of that size.
      region: the queried region; None takes the support's own.
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
    region: Rectangle | None = None
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


def make_problem(config: ProblemConfig, standing: Sequence[ObjectAsset] = ()) -> Problem:
    """Finds the assets, compiles the world and wires it to an engine.

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
    pool = find_pool(config.pool, names=config.objects)
    chosen = [pool[name] for name in config.objects] if config.objects else list(pool.objects)
    support = find_support(config.support)
    region = config.region or support.region
    check_region(region, support)
    check_number(config.placement.num_objects, len(chosen), config.pool, config.repeat)
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


def check_crowding(objects: Sequence[ObjectAsset], config: ProblemConfig, support: SupportAsset) -> None:
    """Refuses more objects than can be hoped to find room in the region (ConfigError)."""
    region, num_objects = config.region or support.region, config.placement.num_objects
    if config.is_piled and (depth := rim_height(region, support)) > 0:
        _check_volume(objects, num_objects, region, depth)
    elif (crowded := crowding(objects, num_objects, region)) > MOST_CROWDED:
        x, y = region.half_extents
        raise ConfigError(
            f"{num_objects} objects in a region of {2 * x:.2f} x {2 * y:.2f} m: even the "
            f"smallest ones' footprints cover {crowded:.1f} times its area",
            f"{MOST_CROWDED:g} times at most; beyond about once, scenes begin to fail",
            "fewer objects or a larger region",
        )


def _check_volume(objects: Sequence[ObjectAsset], num_objects: int, region: Rectangle, depth: float) -> None:
    """Refuses a pile whose smallest objects' hulls alone are larger than what holds them."""
    hulls = [ConvexHull(np.concatenate([part.vertices for part in asset.parts])).volume for asset in objects]
    sizes = np.sort(np.tile(hulls, -(-num_objects // len(hulls))).reshape(-1, len(hulls)), axis=1).ravel()
    room = 4 * float(np.prod(region.half_extents)) * depth * MOST_FULL
    filled = np.cumsum(sizes[:num_objects])
    if filled[-1] > room:
        raise ConfigError(
            f"a pile of {num_objects} objects, of which even the smallest fill "
            f"{1000 * filled[-1]:.1f} litres, in {1000 * room / MOST_FULL:.1f} litres",
            f"up to {int((filled <= room).sum())} of these objects",
            "fewer or smaller objects, or a larger support, such as tote or bin-0.60x0.40x0.25",
        )


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
    region = config.region or support.region
    if min(region.half_extents) * 2 < SMALLEST_REGION:
        raise ConfigError(f"a region of {region}", f"sides from {SMALLEST_REGION} m", "a larger `region`")
    cut = columns_of if sizes is None else sizes.cut
    world = make_world([*objects, *standing], support, config.stability, config.contact, cut)
    physics: Physics | NumberedEngines
    geometry = geometry_of(world)
    if sizes is None:
        physics = make_physics(world.layout, config.stability, config.engine, num_threads=config.num_threads)
    else:
        physics = sizes.physics
        geometry = pad_geometry(geometry, NUM_COLUMN_SAMPLES, _round_up(len(geometry.surface)))
    rules = Rules(
        config=config.placement,
        physics=physics,
        geometry=geometry,
        region=region_of(_largest_region(region, config.change, support), support),
        num_started=len(standing),
        map_radius=None if sizes is None else sizes.radius,
        draw_region=None
        if config.change == "none"
        else ChangedRegion(find_change(config.change), region, support.region, support.top),
        support_map=None if config.placement.overhang == "any" else SupportMap.of(geometry),
    )
    return Problem(config, world, rules, region)


def _round_up(number: int) -> int:
    """The next power of two, or one and a half times one: few sizes for many numbers."""
    power = 1 << (number - 1).bit_length()
    return power * 3 // 4 if number <= power * 3 // 4 else power


def check_number(wanted: int, available: int, pool: str, repeat: bool = False) -> None:
    """Refuses more objects than there are (ConfigError)."""
    if wanted > available and not repeat:
        raise ConfigError(
            f"{wanted} objects asked for, {available} chosen of pool {pool!r}",
            f"1 to {available}, or more (up to {MAX_SLOTS}) where objects may stand there more than once",
            "fewer objects, the pool 'all' with its 50, or repeat=True (of generate and evaluate)",
        )


def crowding(objects: Sequence[ObjectAsset], num_objects: int, region: Rectangle) -> float:
    """The area that the smallest `num_objects` objects cover at least, seen from above, over the region's."""
    plans = [np.concatenate([part.vertices for part in asset.parts])[:, :2] for asset in objects]
    areas = sorted(float(ConvexHull(points).volume) for points in plans)
    # Of objects that may stand there more than once, all are there before any comes again.
    rounds, rest = divmod(num_objects, len(areas))
    return (rounds * sum(areas) + sum(areas[:rest])) / (4 * float(np.prod(region.half_extents)))


def _largest_region(base: Rectangle, change: str, support: SupportAsset) -> Rectangle:
    """The region that a world is made for: its maps have to hold the largest that is drawn."""
    expansion = find_change(change).expansion
    half = [min(side + expansion, max(support.region.half_extents)) for side in base.half_extents]
    return replace(base, half_extents=(half[0], half[1])) if expansion else base


def region_of(rectangle: Rectangle, support: SupportAsset) -> Region:
    """A rectangle on a support's top as the decision process sees it."""
    given = (rectangle.center, rectangle.half_extents, rectangle.yaw, support.top)
    return make_region(*on_device(tuple(map(np.array, given))))


def keep_out_of(boxes: Sequence[Rectangle]) -> KeepOut:
    """Rectangles that objects must stay out of, as the decision process sees them."""
    return on_device(
        KeepOut(
            center=np.array([box.center for box in boxes]).reshape(-1, 2),
            half_extents=np.array([box.half_extents for box in boxes]).reshape(-1, 2),
            yaw=np.array([box.yaw for box in boxes]),
        )
    )


def on_device(arrays: Any) -> Any:
    """A pytree of NumPy arrays as JAX's, f64 as f32.

    They are moved as they are: `jnp.asarray` would compile a program for each shape.
    """
    narrowed = jax.tree.map(lambda a: a.astype(np.float32) if a.dtype == np.float64 else a, arrays)
    return jax.device_put(narrowed)


def geometry_of(world: World) -> Geometry:
    """The world's objects as arrays, columns padded to the longest."""
    most = max(len(columns.sample) for columns in world.columns)

    def pad(arrays: list[np.ndarray]) -> np.ndarray:
        return np.stack([np.pad(a, [(0, most - len(a))] + [(0, 0)] * (a.ndim - 1)) for a in arrays])

    runs = [_surface_runs(columns) for columns in world.columns]
    owner = np.repeat(np.arange(len(runs), dtype=np.int32), [len(run) for run in runs])
    boxes = [(*box.center, *box.half_extents, box.yaw) for box in world.support.boxes]
    found = Geometry(
        half_extents=np.stack([asset.half_extents for asset in world.objects]),
        center_of_mass=world.layout.center_of_mass,
        own_margin=np.array([_own_margin(asset) for asset in world.objects]),
        cloud=np.stack([asset.cloud for asset in world.objects]),
        column_xy=pad([columns.xy[columns.sample] for columns in world.columns]),
        column_bottom=pad([columns.bottom[columns.sample] for columns in world.columns]),
        is_column=pad([np.ones(len(columns.sample), bool) for columns in world.columns]),
        surface=np.concatenate(runs),
        surface_owner=owner,
        boxes=np.array(boxes),
        top=np.array(world.support.top),
    )
    return on_device(found)


def pad_geometry(geometry: Geometry, num_columns: int, num_runs: int) -> Geometry:
    """The same objects in longer arrays: columns that are none, and runs of surface that come again.

    Raises:
      ValueError: they are longer already.
    """
    columns = num_columns - geometry.is_column.shape[1]
    runs = num_runs - len(geometry.surface)
    if min(columns, runs) < 0:
        raise ValueError(f"{-columns} columns or {-runs} runs of surface too many")
    again = jnp.minimum(jnp.arange(num_runs), len(geometry.surface) - 1)
    return geometry.replace(
        column_xy=jnp.pad(geometry.column_xy, ((0, 0), (0, columns), (0, 0))),
        column_bottom=jnp.pad(geometry.column_bottom, ((0, 0), (0, columns))),
        is_column=jnp.pad(geometry.is_column, ((0, 0), (0, columns))),
        surface=geometry.surface[again],
        surface_owner=geometry.surface_owner[again],
    )


def _own_margin(asset: ObjectAsset) -> float:
    """Metres: the support margin of an object that stands in its own frame on a flat table."""
    vertices = np.concatenate([part.vertices for part in asset.parts])
    bottom = vertices[vertices[:, 2] < vertices[:, 2].min() + _TOUCHING]
    return support_margin(bottom[:, :2] - asset.center_of_mass[:2])


def num_runs_of(columns: HeightProfile) -> int:
    """In how many runs an object's upper surface stands in `Geometry.surface`."""
    return -(-len(columns.surface) // _RUN)


def _surface_runs(columns: HeightProfile) -> np.ndarray:
    """f64[M, 64, 3]: an object's grown upper surface, padded with its first point."""
    padding = np.repeat(columns.surface[:1], -len(columns.surface) % _RUN, axis=0)
    return np.concatenate([columns.surface, padding]).reshape(-1, _RUN, 3)


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
) -> Setup:
    """Compiles the problem, around objects that stand there already if there are any.

    Args:
      assets: objects and a support that are at hand, in place of those that `config` names.

    Raises:
      ConfigError: a box cannot meet the region, or `make_problem` refuses.
      PoolError: something cannot be found or read.
    """
    objects, poses = standing or ((), np.zeros((0, 7), np.float32))
    problem = compose(*assets, config, objects) if assets else make_problem(config, objects)
    check_keep_out(keep_out, problem.region)
    return Setup(problem, keep_out_of(keep_out), start_of(problem.world, poses))


def start_of(world: World, poses: np.ndarray) -> Start:
    """The start of episodes in a world whose last N objects stand at `poses` f32[N, 7]."""
    is_placed = np.arange(world.num_objects) >= world.num_objects - len(poses)
    everyone = np.tile(np.eye(7)[3], (world.num_objects, 1))
    everyone[is_placed] = poses
    return on_device(Start(everyone, is_placed))
