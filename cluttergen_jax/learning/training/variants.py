"""Bodies of varied shapes of the modeller: what the stability network is trained on, and tested with."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

from cluttergen_jax.assets.body import BodyConfig, make_object
from cluttergen_jax.assets.modeller.catalog import FAMILIES, make_shape
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import check_workers
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, PoolError
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.limited import run_all
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.progress import Progress

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
