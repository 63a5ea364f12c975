"""Trees of arrays compared."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np


def same_bits(one, two) -> bool:
    """Whether two trees of arrays are equal, NaN to NaN and key to key."""

    def data(leaf):
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if is_key else leaf)

    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    return all(
        np.array_equal(data(a), data(b), equal_nan=data(a).dtype.kind == "f") for a, b in pairs
    )
