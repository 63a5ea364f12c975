"""What `jax.shard_map` asks of a loop: that what it carries varies over the mesh from the beginning."""

from __future__ import annotations

from typing import Any, TypeVar

import jax

T = TypeVar("T")


def varying_alike(tree: T) -> T:
    """A pytree whose arrays all vary over the axes of a mesh over which any of them does.

    An episode begins with constants, which are the same on every device, and with a key that is not. Outside
    of `jax.shard_map`, and where that does not ask (`check_vma=False`), it is the tree as it is.
    """
    axes = frozenset[str]().union(*map(_axes_of, jax.tree.leaves(tree)))

    def vary(leaf: Any) -> Any:
        missing = tuple(sorted(axes - _axes_of(leaf)))
        return jax.lax.pcast(leaf, missing, to="varying") if missing else leaf

    return jax.tree.map(vary, tree)


def _axes_of(leaf: Any) -> frozenset[str]:
    """The manual axes over which an array varies."""
    kind: Any = jax.typeof(leaf)
    # JAX 0.10.2 moved it.
    return kind.mat.varying if hasattr(kind, "mat") else kind.vma
