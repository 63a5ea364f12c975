"""The physics interface: all that the decision process knows of a simulator."""

from __future__ import annotations

from typing import Protocol

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.types import Array, Settling, Standing


class Physics(Protocol):
    """Releases objects at rest and reports how they settle: SI units, world frame, one scene.

    Both functions are pure and may be called under `jit`, `vmap` (of `vmap`), `cond`, `while_loop` and
    `scan`. Index k is object k of the compiled world. An inactive scene costs nothing and returns its input.

    Attributes:
      config: when an object stands still.
      compiling: what to say before its programs are compiled.
    """

    config: StabilityConfig
    compiling: str

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """One attempt: lets go of the focus object among the placed ones.

        Args:
          poses: f32[K, 7], position and quaternion wxyz of every object; read where placed.
          is_placed: bool[K], the focus object included. The others are taken to lie at rest, as committed
            objects do: an engine may let them sleep until they are touched.
          focus: i32, the current object.
          is_active: bool.
        """
        ...

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """The last check of a finished scene, everything awake (docs/contract.md: staged)."""
        ...
