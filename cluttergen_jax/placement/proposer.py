"""Whatever chooses where an object goes: a baseline, a policy, a person."""

from __future__ import annotations

from typing import Protocol

from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array


class Proposer(Protocol):
    """Proposes poses for the object in hand; pure, one episode at a time."""

    def __call__(self, key: Array, episode: Episode) -> Array:
        """An action f32[4] in [0, 1] (docs/contract.md) for `episode`, drawn with `key`."""
        ...
