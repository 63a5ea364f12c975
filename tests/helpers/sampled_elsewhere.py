"""What a sampler of each method draws with the settings of JAX that a shell has. Prints JSON.

JAX_ENABLE_X64=1 python -m tests.helpers.sampled_elsewhere POOL METHOD...
"""

import hashlib
import json
import sys

import jax
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.region import KeepOut


def drawn(pool: str, method: str) -> str:
    """The digest of a scene of two objects, all its arrays and their types."""
    sample = cg.make_sampler(pool=pool, num_objects=2, method=method, num_threads=1)
    # What a program with numbers of 64 bits hands over.
    box = KeepOut(np.array([[0.2, 0.1]]), np.array([[0.03, 0.03]]), np.array([0.3]))
    key = jax.random.fold_in(new_key(5), 1)
    scene = jax.device_get(jax.jit(lambda key: sample(key, keep_out=box))(key))
    leaves = jax.tree.leaves(scene)
    told = [(str(leaf.dtype), leaf.shape) for leaf in leaves]
    data = b"".join(np.ascontiguousarray(leaf).tobytes() for leaf in leaves)
    return hashlib.sha256(repr(told).encode() + data).hexdigest()


if __name__ == "__main__":
    pool, *methods = sys.argv[1:]
    print(json.dumps({method: drawn(pool, method) for method in methods}))
