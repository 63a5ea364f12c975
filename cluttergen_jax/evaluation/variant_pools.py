"""Pools of the modeller's variants: of families that nothing was trained on, and as many of the others."""

from __future__ import annotations

from cluttergen_jax.assets.pool import Pool, find_pool
from cluttergen_jax.learning.training.variants import HELD_OUT_FAMILIES, TRAINING_FAMILIES, variants

VARIANT_POOLS = {"held_out_families": HELD_OUT_FAMILIES, "training_families": TRAINING_FAMILIES}
"""Names of pools that no folder holds, and the families that their objects are of."""
NUM_VARIANTS = 40
"""Objects of each."""
FIRST_SEED = 5000
"""Of the variants: far from those that networks are trained on."""


def find_any_pool(name: str) -> Pool:
    """The pool of that name or path; one of variants is made at first, and its bodies are cached.

    Raises:
      PoolError: nothing is called so, or its files are damaged.
      AssetError: a variant could not be made.
    """
    if name not in VARIANT_POOLS:
        return find_pool(name)
    return Pool(name, variants(NUM_VARIANTS, FIRST_SEED, VARIANT_POOLS[name]), licence="Apache-2.0")
