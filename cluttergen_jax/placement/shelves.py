"""Worlds of a pool that is too large for one: each holds some objects that are drawn from it, a shelf.

All of them have arrays of one size, or of one of a few sizes, so that what is compiled for one shelf serves
the others.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.facts import ObjectFacts, weights_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.assets.support_map import check_keep_out, check_region
from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import engine_of, make_physics
from cluttergen_jax.physics.host import BatchEngine, NumberedEngines
from cluttergen_jax.placement.problem import (
    Problem,
    ProblemConfig,
    Setup,
    WorldSizes,
    compose,
    doors_of,
    keep_out_of,
)
from cluttergen_jax.placement.region import KeepOut
from cluttergen_jax.placement.room import (
    ROOM,
    check_crowding,
    check_number,
    check_room,
    check_surface,
    split_by_room,
)
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.types import Start
from cluttergen_jax.placement.world import World, columns_of
from cluttergen_jax.types import Array

_KEPT_WORLDS = 2
_KEPT_COLUMNS = 512
_SHELF = 3
"""Folded into the key of a block's first scene, for the block's shelf. `Rules.begin` folds it in for that
scene's first orientation, too, where these are drawn."""


def shelf_key(seed: int, block: int) -> Array:
    """The key of the shelf of a bank's block: `draw_shelf` of it gives the objects of the block's scenes."""
    return jax.random.fold_in(jax.random.fold_in(new_key(seed), block * BLOCK_SIZE), _SHELF)


def draw_shelf(
    key: Array, size: int, weights: np.ndarray, groups: Sequence[str] | None = None
) -> tuple[int, ...]:
    """Different objects of a pool, by their numbers, in the pool's order.

    Args:
      key: one PRNG key, consumed.
      size: how many.
      weights: f64[N], 0 or more, by object: they are drawn one after another, each with a chance in
        proportion (Plackett-Luce).
      groups: of each object. Where it is given, each group has as many objects as any other, while it has
        some.

    Raises:
      ConfigError: fewer objects have a weight above 0.
    """
    allowed = np.flatnonzero(weights > 0)
    if size > len(allowed):
        raise ConfigError(
            f"a shelf of {size} of {len(allowed)} objects",
            range_text(1, len(allowed), "objects with weights above 0"),
            "a smaller one",
        )
    noise = np.asarray(jax.random.gumbel(key, (len(weights),)), np.float64)
    with np.errstate(divide="ignore"):
        rank = np.where(weights > 0, np.log(weights) + noise, -np.inf)
    order = np.argsort(-rank, kind="stable")[: len(allowed)]
    if groups is not None:
        # The rounds in which objects come: the first of each group, then the second of each, and so on.
        seen: dict[str, int] = {}
        rounds = []
        for index in order.tolist():
            rounds.append(seen.get(groups[index], 0))
            seen[groups[index]] = rounds[-1] + 1
        order = order[np.argsort(rounds, kind="stable")]
    return tuple(sorted(order[:size].tolist()))


class ShelfWorlds:
    """Problems of as many objects each, which share what is compiled.

    Args:
      config: of each; `config.shelf` is the number of objects.
      support: the table.
      radius: metres, of the largest object seen from above.
      keep_out: where no object may come to lie.
      read: gives an object again by its name, for a world that is compiled once more.

    Raises:
      ConfigError: the engine is not native.
    """

    def __init__(
        self,
        config: ProblemConfig,
        support: SupportAsset,
        radius: float,
        keep_out: KeepOut,
        read: Callable[[str], ObjectAsset],
    ) -> None:
        if (engine := engine_of(config.engine, config.stability)) != "native":
            raise ConfigError(
                f"engine {engine!r} with a shelf of objects, each of which it would compile anew",
                "the native engine",
                "engine='native', or up to 200 `objects` and no `shelf`",
            )
        self.config = config
        self.support = support
        self.keep_out = keep_out
        self._read = read
        doors = doors_of(support, config.placement)
        num_doors = 0 if doors is None else len(doors.names)
        engines = NumberedEngines(config.shelf, config.stability, self._make_engine, num_doors)
        self._sizes = WorldSizes(engines, radius, lru_cache(_KEPT_COLUMNS)(columns_of))
        self._names: list[tuple[str, ...]] = []
        self._worlds: OrderedDict[int, World] = OrderedDict()
        self._lock = threading.Lock()

    def setup(self, objects: Sequence[ObjectAsset]) -> Setup:
        """The problem of these objects, as many as a shelf has."""
        problem = self._compose(objects)
        with self._lock:
            number = len(self._names)
            self._names.append(tuple(asset.name for asset in objects))
        self._keep(number, problem.world)
        problem = replace(problem, rules=problem.rules.replace(engine=jnp.int32(number)))
        return Setup(problem, self.keep_out, Start.empty(self.config.shelf))

    def _compose(self, objects: Sequence[ObjectAsset]) -> Problem:
        return compose(objects, self.support, self.config, sizes=self._sizes)

    def _keep(self, number: int, world: World) -> None:
        with self._lock:
            self._worlds[number] = world
            while len(self._worlds) > _KEPT_WORLDS:
                self._worlds.popitem(last=False)

    def _make_engine(self, number: int) -> BatchEngine:
        """The engine of a problem, whose world is compiled again if it is no longer at hand."""
        world = self._worlds.get(number)
        if world is None:
            world = self._compose([self._read(name) for name in self._names[number]]).world
            self._keep(number, world)
        config = self.config
        engine = make_physics(world.layout, config.stability, "native", config.num_threads)
        return cast(BatchEngine, engine)


def _smaller_shelf(num_objects: int, most: int) -> str:
    """A hint: a shelf of fewer than all `most` objects that drawing can choose, with objects enough."""
    half = max(most // 2, 1)
    if num_objects < most:
        return f"shelf={max(num_objects, half)}"
    return f"num_objects={half}, shelf={half}"


def _large_ones(
    facts: Sequence[ObjectFacts], support: SupportAsset, region: Rectangle
) -> list[str]:
    """The names of objects whose box may be too large for the region, or for what hangs over it."""
    free = max((surface.free_height for surface, _ in support.asked), default=math.inf)
    short = 2 * min(region.half_extents)
    return [
        each.name for each in facts if math.hypot(*each.size) > short or each.size[2] + ROOM > free
    ]


def _with_room(
    pool: Pool, config: ProblemConfig, support: SupportAsset, region: Rectangle
) -> tuple[Pool, tuple[str, ...]]:
    """The pool without what no container holds and was not asked for by name, and notes."""
    large = [pool[name] for name in _large_ones(pool.facts, support, region)]
    kept, notes = split_by_room(large, config.named, support, region, config)
    if not notes:
        return pool, ()
    left_out = {each.name for each in large} - {each.name for each in kept}
    return pool.select([name for name in pool.names if name not in left_out]), notes


class Shelves:
    """Problems of objects that are drawn from a pool.

    Args:
      pool: the objects.
      config: of the problems; `config.shelf`, `weights` and `balance` say how objects are drawn.
      support: the table.
      keep_out: see `placement.problem.make_setup`.

    Raises:
      ConfigError: the engine is not native, the pool is smaller than a shelf, the smallest objects of all
        cover the region many times, or a condition of a weight fits nothing.
    """

    def __init__(
        self,
        pool: Pool,
        config: ProblemConfig,
        support: SupportAsset,
        keep_out: Sequence[Rectangle] = (),
    ) -> None:
        region = config.region or support.region
        check_region(region, support)
        pool, self._notes = _with_room(pool, config, support, region)
        self.pool = pool
        self.config = config
        self._weights = weights_of(pool.facts, config.weights)
        self._groups = (
            [getattr(each, config.balance) for each in pool.facts] if config.balance else None
        )
        most = int((self._weights > 0).sum())
        if not 1 <= config.shelf <= most:
            raise ConfigError(
                f"shelf = {config.shelf} with {most} objects to draw",
                range_text(1, most, "objects with weights above 0"),
                "fewer weights of 0",
            )
        is_uneven = len(np.unique(self._weights[self._weights > 0])) > 1 or self._groups is not None
        if config.shelf == most and is_uneven:
            raise ConfigError(
                f"a shelf of all {most} objects, of which none is left to draw by "
                f"`{'weights' if self._groups is None else 'balance'}`",
                f"a shelf of {range_text(1, most - 1, 'fewer objects than can be drawn')}",
                _smaller_shelf(config.placement.num_objects, most),
            )
        check_keep_out(keep_out, region)
        check_number(config.placement.num_objects, config.shelf, config.pool)
        doors = doors_of(support, config.placement)
        self._check_sizes(support if doors is None else doors.open, region)
        sides = 2 if config.placement.poses == "upright" else 3
        sizes = [0.5 * float(np.linalg.norm(each.size[:sides])) for each in pool.facts]
        self._worlds = ShelfWorlds(
            config, support, max(sizes), keep_out_of(keep_out), pool.__getitem__
        )
        self._numbers = {name: number for number, name in enumerate(pool.names)}
        self._latest: tuple[tuple[str, ...], Setup] | None = None

    def _check_sizes(self, support: SupportAsset, region: Rectangle) -> None:
        """Refuses objects that no draw can place: too large for the region, too tall for what hangs over it.

        Only those whose box looks too large are read (ConfigError).
        """
        config = self.config
        drawn = [
            each for each, weight in zip(self.pool.facts, self._weights, strict=True) if weight > 0
        ]
        objects = [self.pool[name] for name in _large_ones(drawn, support, region)]
        check_surface(objects, support, config.placement, config.contact, config.region is not None)
        check_room(objects, support, region, config.placement, config.is_piled)

    @classmethod
    def of(
        cls, config: ProblemConfig, keep_out: Sequence[Rectangle] = (), pool: Pool | None = None
    ) -> Shelves:
        """Those of the pool (where it is at hand), objects and support that a config names.

        Raises:
          PoolError: there is none.
        """
        pool = pool or find_pool(config.pool, names=config.objects)
        if config.objects:
            pool = pool.select(config.objects)
        return cls(pool, config, find_support(config.support).on_surface(config.surface), keep_out)

    def draw(self, key: Array) -> tuple[str, ...]:
        """The names of the objects of a shelf, drawn with a key."""
        chosen = draw_shelf(key, self.config.shelf, self._weights, self._groups)
        return tuple(self.pool.names[index] for index in chosen)

    def numbers(self, names: Sequence[str]) -> np.ndarray:
        """i32[N]: objects of the pool by their numbers in it."""
        return np.array([self._numbers[name] for name in names], np.int32)

    def names_of_block(self, seed: int, block: int) -> tuple[str, ...]:
        """The names of the objects of a bank's block; sets of objects are drawn from the first block's."""
        return self.draw(shelf_key(seed, 0 if self.config.placement.sets else block))

    def block(self, seed: int, block: int) -> Setup:
        """The problem of the scenes of a bank's block."""
        return self.setup(self.names_of_block(seed, block))

    def setup(self, names: tuple[str, ...]) -> Setup:
        """The problem of these objects, as many as a shelf has (PoolError: one is damaged)."""
        if self._latest is None or self._latest[0] != names:
            objects = [self.pool[name] for name in names]
            if self._latest is None:
                check_crowding(objects, self.config, self._worlds.support)
            setup = self._worlds.setup(objects)
            problem = replace(setup.problem, notes=self._notes)
            self._latest = names, replace(setup, problem=problem)
        return self._latest[1]
