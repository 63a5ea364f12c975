"""Worlds that the stability network is trained in: varied shapes, supports and crowds."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from cluttergen_jax.assets import ObjectAsset, find_support
from cluttergen_jax.assets.body import BodyConfig, make_object
from cluttergen_jax.assets.modeller.catalog import FAMILIES, make_shape
from cluttergen_jax.config import ContactConfig, StabilityConfig, check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, PoolError, range_text
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.limited import run_all
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import BatchEngine, NumberedEngines, Physics
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.placement import HeightMapper, PlacementConfig, Rules
from cluttergen_jax.placement.problem import region_of
from cluttergen_jax.placement.room import check_number
from cluttergen_jax.placement.world import (
    NUM_COLUMN_SAMPLES,
    World,
    columns_of,
    geometry_of,
    make_world,
    num_runs_of,
    pad_geometry,
)
from cluttergen_jax.progress import Progress, track

HELD_OUT_FAMILIES = (
    "bowl",
    "wine_glass",
    "frying_pan",
    "wooden_spoon",
    "globe",
    "laptop",
    "letter_tray",
    "sticky_notes",
    "spray_bottle",
    "tape_roll",
)
"""Families of the modeller that nothing is trained on, two of each pool, of all sorts: hollow, on a thin
stem, wide with a handle, long and thin, round on a foot, hinged, open trays, a flat block, a tall bottle,
a ring."""

TRAINING_FAMILIES = tuple(family for family in FAMILIES if family not in HELD_OUT_FAMILIES)
"""The other families."""


@dataclass(frozen=True)
class ShapeVariant:
    """One shape of the modeller: a family and the seed of its proportions.

    Attributes:
      family: a key of `FAMILIES`; seed: see `make_shape`.
    """

    family: str
    seed: int

    @property
    def name(self) -> str:
        """As the shape is called."""
        return f"{self.family}-{self.seed}"

    @property
    def key(self) -> str:
        """Of its body in the cache."""
        return cache.shape_key(self.family, self.seed, BodyConfig())


def list_variants(number: int, seed: int, families: Sequence[str]) -> tuple[ShapeVariant, ...]:
    """The first `number` variants: every family with seed `seed`, every family with `seed + 1`, and so on.

    Raises:
      ConfigError: fewer than one, or no family; PoolError: there is no such family.
    """
    if number < 1 or not families:
        raise ConfigError(
            f"{number} variants of {len(families)} families", "at least one of each", "640"
        )
    if unknown := [family for family in families if family not in FAMILIES]:
        raise PoolError(
            f"no family named {unknown[0]!r}", ", ".join(sorted(FAMILIES)), "one of these names"
        )
    rounds = -(-number // len(families))
    every = [ShapeVariant(family, seed + turn) for turn in range(rounds) for family in families]
    return tuple(every[:number])


def variants(
    number: int, seed: int = 0, families: Sequence[str] = TRAINING_FAMILIES, num_processes: int = 0
) -> tuple[ObjectAsset, ...]:
    """Bodies of `list_variants`, from the cache or made now; as sound as imported ones, solo rate unmeasured.

    Bodies are cached as they are finished: what was interrupted takes up where it stopped.

    Args:
      number, seed, families: see `list_variants`; as many of each family if `number` is a multiple.
      num_processes: that make what is missing; 0 takes one for each core.

    Raises:
      ConfigError, PoolError: see `list_variants`.
      AssetError: a body could not be made; the others are in the cache.
    """
    check_workers("num_processes", num_processes)
    wanted = list_variants(number, seed, families)
    found = {variant: cache.load(variant.key, variant.name) for variant in wanted}
    missing = [variant for variant, asset in found.items() if asset is None]
    _make(missing, num_processes or os.cpu_count() or 1)
    found |= {variant: cache.load(variant.key, variant.name) for variant in missing}
    assets = tuple(asset for variant in wanted if (asset := found[variant]) is not None)
    if len(assets) < len(wanted):
        raise AssetError(
            f"variants vanished from {cache.cache_root()} as they were read", hint="a second run"
        )
    return assets


def _make(missing: Sequence[ShapeVariant], num_processes: int) -> None:
    if not missing:
        return
    failures = []
    with Progress("shaping objects", len(missing), "object") as progress:
        for index, reason in run_all(_make_one, missing, num_processes):
            progress.update(note=missing[index].name)
            if reason:
                failures.append(f"{missing[index].name}: {reason}")
    if failures:
        raise AssetError("; ".join(sorted(failures)))


def _make_one(variant: ShapeVariant) -> str:
    """Makes a body and caches it. The empty string, or why it could not be made."""
    try:
        with silent_log():
            cache.store(
                variant.key, make_object(make_shape(variant.family, variant.seed), BodyConfig())
            )
    except (ClutterGenError, OSError) as error:
        return str(error)
    return ""


SET_SIZE = 50
"""Objects of a world; episodes place some of them."""
FURNITURE = ("tray_table", "shelf_desk", "bar_table")
"""Supports beside the cuboid tables: a rim, a riser behind the region, a round top of planks."""
FILL = (0.3, 2.0)
"""Between which fills are drawn: the objects' footprints, as rectangles, over the region's area."""
FEWEST_OBJECTS = 4
MOST_OBJECTS = 40
_SIDES = (0.25, 0.8)
_MOST_DRAWS = 1000


@dataclass(frozen=True)
class TrainingSetting:
    """Where how many objects are placed; the region is the support's own.

    Attributes:
      support: its name; num_objects: slots of an episode.
      fill: of an average draw of objects, see `FILL`.
    """

    support: str
    num_objects: int
    fill: float


@dataclass(frozen=True, eq=False)
class TrainingWorld:
    """One set of objects in one setting.

    Attributes:
      setting: where and how many; world: what is compiled.
      rules: of its episodes, which know what carries what. Those of one setting have arrays of equal shapes,
        and the same physics object where they are judged alike.
      engines: those of its physics, one at a time.
      mapper: of its height maps, for `Search(rules, mapper=mapper)`; of one size in each setting.
    """

    setting: TrainingSetting
    world: World
    rules: Rules
    engines: NumberedEngines
    mapper: HeightMapper

    def start_engine(self, num_threads: int = 0) -> None:
        """From now on the physics that it shares with its maker's worlds simulates this one.

        What the engine before held, some 500 MB of simulations, is given back.

        Args:
          num_threads: of the native engine; 0 takes every core.
        """
        config = self.rules.physics.config
        engine = make_physics(self.world.layout, config, "native", num_threads)
        self.engines.put(cast(BatchEngine, engine))


class WorldMaker:
    """Makes worlds of sets of objects, such that those of one setting share what is compiled.

    Their columns and surfaces are padded to sizes that serve every set, and their height maps are made for
    the largest object of all. Of worlds that are judged alike one has an engine at a time.

    Args:
      sets: K objects each.
      placement: what is asked of episodes; the number of objects is the setting's.

    Raises:
      ConfigError: there is no set, or they differ in size.
    """

    def __init__(
        self,
        sets: Sequence[Sequence[ObjectAsset]],
        placement: PlacementConfig,
    ) -> None:
        sizes = sorted({len(each) for each in sets})
        if len(sizes) != 1 or not sizes[0]:
            raise ConfigError(f"sets of {sizes} objects", "sets of one size", "`object_sets`")
        self.sets = tuple(tuple(each) for each in sets)
        self.placement = placement
        self._physics: dict[StabilityConfig, tuple[NumberedEngines, Physics]] = {}
        objects = list(dict.fromkeys(asset for each in self.sets for asset in each))
        self.radius = max(float(np.linalg.norm(asset.half_extents[:2])) for asset in objects)
        self._columns = {
            asset: columns_of(asset)
            for asset in track(objects, "cutting columns", len(objects), "object")
        }
        self.num_runs = max(
            sum(num_runs_of(self._columns[asset]) for asset in each) for each in self.sets
        )

    def make(
        self, setting: TrainingSetting, set_index: int, stability: StabilityConfig | None = None
    ) -> TrainingWorld:
        """The world of one of the sets in a setting; `start_engine` before it is run.

        Raises:
          PoolError: there is no such support; ConfigError: a set has fewer objects than are asked for.
        """
        objects = self.sets[set_index]
        support = find_support(setting.support)
        check_number(setting.num_objects, len(objects), "of variants")
        stability = stability or StabilityConfig()
        if stability not in self._physics:
            engines = NumberedEngines(len(objects), stability)
            self._physics[stability] = engines, engines.with_number(np.int32(0))
        engines, physics = self._physics[stability]
        world = make_world(objects, support, stability, ContactConfig(), self._columns.__getitem__)
        rules = Rules(
            config=replace(self.placement, num_objects=setting.num_objects),
            physics=physics,
            geometry=pad_geometry(geometry_of(world), NUM_COLUMN_SAMPLES, self.num_runs),
            region=region_of(support.region, support),
        )
        mapper = HeightMapper.of(rules.geometry, rules.region, self.radius)
        return TrainingWorld(setting, world, rules, engines, mapper)


def object_sets(
    objects: Sequence[ObjectAsset], number: int, rng: np.random.Generator, size: int = SET_SIZE
) -> list[tuple[ObjectAsset, ...]]:
    """Sets of `size` different objects, families as equally often in each as can be.

    Raises:
      ConfigError: there are fewer objects.
    """
    if not 1 <= size <= len(objects):
        raise ConfigError(
            f"sets of {size} of {len(objects)} objects",
            range_text(1, len(objects)),
            "more variants",
        )
    families: dict[str, list[ObjectAsset]] = defaultdict(list)
    for asset in objects:
        families[asset.provenance.source].append(asset)
    return [_one_set(list(families.values()), rng, size) for _ in range(number)]


def _one_set(
    families: Sequence[Sequence[ObjectAsset]], rng: np.random.Generator, size: int
) -> tuple[ObjectAsset, ...]:
    """One of each family in an order of its own, then a second of each, and so on."""
    decks = [[family[index] for index in rng.permutation(len(family))] for family in families]
    drawn: list[ObjectAsset] = []
    while len(drawn) < size:
        decks = [decks[index] for index in rng.permutation(len(decks)) if decks[index]]
        drawn += [deck.pop() for deck in decks]
    return tuple(drawn[:size])


def mean_footprint(objects: Sequence[ObjectAsset]) -> float:
    """Square metres: the mean of the objects' bounding rectangles, seen from above."""
    return float(np.mean([4 * asset.half_extents[0] * asset.half_extents[1] for asset in objects]))


def draw_settings(rng: np.random.Generator, number: int, footprint: float) -> list[TrainingSetting]:
    """Settings whose fill is uniform in `FILL`: one in each of `number` equal steps of it.

    Each piece of `FURNITURE` is there once, in at most half of them; the others are cuboid tables.

    Args:
      footprint: square metres, of an average object (`mean_footprint`).

    Raises:
      ConfigError: no setting can be that full with objects of that size.
    """
    low, high = FILL
    fills = low + (high - low) * (rng.permutation(number) + rng.uniform(size=number)) / number
    left = [float(fill) for fill in fills]
    settings = []
    for name in FURNITURE[: number // 2]:
        for fill in left:
            if setting := _setting(name, fill, footprint):
                settings.append(setting)
                left.remove(fill)
                break
    return settings + [_cuboid_setting(rng, fill, footprint) for fill in left]


def _cuboid_setting(rng: np.random.Generator, fill: float, footprint: float) -> TrainingSetting:
    """The first drawn table that such a number of objects fills."""
    for _ in range(_MOST_DRAWS):
        width, depth = rng.uniform(*_SIDES, size=2)
        if setting := _setting(f"table-{width:.2f}x{depth:.2f}", fill, footprint):
            return setting
    raise ConfigError(
        f"tables filled {fill:.2f} times by objects of {footprint:.4f} m^2",
        f"footprints such that {FEWEST_OBJECTS} to {MOST_OBJECTS} objects do so",
        "objects of usual sizes, about 0.02 m^2",
    )


def _setting(support: str, fill: float, footprint: float) -> TrainingSetting | None:
    """The support filled so far, or None where that takes too few or too many objects."""
    area = 4 * float(np.prod(find_support(support).region.half_extents))
    num_objects = round(fill * area / footprint)
    if not FEWEST_OBJECTS <= num_objects <= MOST_OBJECTS:
        return None
    return TrainingSetting(support, num_objects, num_objects * footprint / area)
