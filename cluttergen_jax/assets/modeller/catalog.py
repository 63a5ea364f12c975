"""All families and pools of the modeller in one place."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from cluttergen_jax.assets.modeller.dining import DINING
from cluttergen_jax.assets.modeller.draw import Family
from cluttergen_jax.assets.modeller.household import HOUSEHOLD
from cluttergen_jax.assets.modeller.kitchen import KITCHEN
from cluttergen_jax.assets.modeller.office import OFFICE
from cluttergen_jax.assets.modeller.study import STUDY
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import PoolError

# Each pool's families are gathered in a dict of its own file; this one only joins them.
_POOLS: Mapping[str, Mapping[str, Family]] = {
    "dining": DINING,
    "kitchen": KITCHEN,
    "study": STUDY,
    "office": OFFICE,
    "household": HOUSEHOLD,
}

FAMILIES: dict[str, Family] = {name: family for pool in _POOLS.values() for name, family in pool.items()}
POOLS: dict[str, tuple[str, ...]] = {pool: tuple(families) for pool, families in _POOLS.items()}


def make_shape(family: str, seed: int | None = None) -> Shape:
    """An object of a family.

    Args:
      family: a key of `FAMILIES`.
      seed: None for the canonical proportions; equal seeds give equal shapes, named `family-seed`.

    Raises:
      PoolError: there is no such family.
    """
    if family not in FAMILIES:
        raise PoolError(f"no family named {family!r}", ", ".join(sorted(FAMILIES)), "one of these names")
    if seed is None:
        return FAMILIES[family](None)
    shape = FAMILIES[family](np.random.default_rng(seed))
    return dataclasses.replace(shape, name=f"{shape.name}-{seed}")
