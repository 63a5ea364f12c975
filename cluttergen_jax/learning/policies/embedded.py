"""The policies that come with the package. Nothing here reads weights or imports JAX."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.assets.pool import embedded_root
from cluttergen_jax.errors import PoolError

FOR_ANY_POOL = ("guided",)
"""Variants of which one checkpoint serves every pool."""


def list_policies() -> dict[str, Path]:
    """Embedded checkpoints by name, POOL-VARIANT or a variant for any pool, with their folders."""
    root = embedded_root() / "checkpoints"
    folders = sorted(root.iterdir()) if root.is_dir() else []
    return {folder.name: folder for folder in folders if (folder / "record.json").is_file()}


def find_policy(variant: str, pool: str) -> Path:
    """The embedded checkpoint of a variant for a pool; PoolError where there is none."""
    policies = list_policies()
    name = variant if variant in FOR_ANY_POOL else f"{pool}-{variant}"
    if name in policies:
        return policies[name]
    of_pool = "" if variant in FOR_ANY_POOL else f" --pool {pool}"
    raise PoolError(
        f"no checkpoint for method {variant!r} on pool {pool!r}",
        ", ".join(policies) or "none is embedded",
        f"cluttergen train{of_pool} --variant {variant}, then --checkpoint runs/{name}-0/policy",
    )
