"""The embedded pools: the modeller's families made into measured bodies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cluttergen_jax.assets.modeller.catalog import POOLS, make_shape
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.importing.solo import measured_object

LICENCE = "Apache-2.0"


def build_pool(name: str, seed: int | None = None, note: Callable[[str], None] = lambda _: None) -> Pool:
    """One of the modeller's pools, every object measured. Equal arguments give equal bytes.

    Args:
      name: a key of the catalog's `POOLS`.
      seed: None for the canonical proportions.
      note: told of each object when it is done.
    """
    objects = []
    for family in POOLS[name]:
        asset = measured_object(make_shape(family, seed))
        note(f"{name}/{asset.name}: {len(asset.parts)} parts, solo {asset.quality.solo_rate}")
        objects.append(asset)
    return Pool(name, tuple(objects), licence=LICENCE)


def build_scenes(folder: Path, note: Callable[[str], None] = print) -> None:
    """Writes every pool of the modeller below `folder`, replacing what is there."""
    for name in POOLS:
        write_pool(folder / name, build_pool(name, note=note), overwrite=True)
