"""The policies that are at hand: the package's, a checkout's and pulled ones. Nothing here imports JAX."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.assets import embedded_root, user_root
from cluttergen_jax.errors import PoolError

FOR_ANY_POOL = ("guided",)
"""Variants of which one checkpoint serves every pool."""


def pulled_root() -> Path:
    """Where `pull_policies` puts checkpoints: `$CLUTTERGEN_HOME/checkpoints`, else in the XDG data home."""
    return user_root().parent / "checkpoints"


def list_policies() -> dict[str, Path]:
    """Checkpoints by name, POOL-VARIANT or a variant for any pool, with their folders.

    Those of ablations are not in the package: they lie in a checkout, or were pulled.
    """
    scenes = embedded_root()
    found = checkpoints_in(pulled_root(), scenes / "ablations", scenes / "checkpoints")
    return dict(sorted(found.items()))


def checkpoints_in(*roots: Path) -> dict[str, Path]:
    """The folders with a checkpoint in these folders, by their own names; of equal names the last one's."""
    there = [folder for root in roots if root.is_dir() for folder in sorted(root.iterdir())]
    return {folder.name: folder for folder in there if (folder / "record.json").is_file()}


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
        f"cluttergen train{of_pool} --variant {variant}, then --checkpoint runs/{name}-0/policy; the "
        "repository has those of ablations: cluttergen pull scenes/ablations --hub CHECKOUT",
    )
