"""What a kind of placer learns from, and how: the interface that all heads have."""

from __future__ import annotations

from typing import Any, Protocol

from flax import struct

from cluttergen_jax.downstream.placer.query import PlacementQuery, Placer
from cluttergen_jax.types import Array


class Example(struct.PyTreeNode):
    """One pair: a query and what is known of its answers. L labelled poses, region frame.

    Attributes:
      query: what the placer is given.
      target: f32[4], where the object stands in the scene: x, y, z and yaw.
      candidate: f32[L, 4]; verdict: u8[L], what became of each (`types.Verdict`).
    """

    query: PlacementQuery
    target: Array
    candidate: Array
    verdict: Array


class Head(Protocol):
    """A network, what it learns from a pair, and the placer that acts by it; a frozen value."""

    @property
    def kind(self) -> str:
        """Its name in records and on the command line."""
        ...

    @property
    def config(self) -> Any:
        """Sizes of the network, a frozen dataclass of JSON values."""
        ...

    def prepare(self, example: Example) -> Any:
        """What a gradient step reads of one pair, made once; a pytree, to be mapped."""
        ...

    def init(self, key: Array) -> Any:
        """Fresh weights."""
        ...

    def loss(self, params: Any, examples: Any, key: Array) -> tuple[Array, dict[str, Array]]:
        """What to keep low over a batch of examples, f32, and its parts by name."""
        ...

    def placer(self, params: Any, temperature: float = 1.0) -> Placer:
        """The placer with these weights; temperature: that of its chances, where it tells them."""
        ...
