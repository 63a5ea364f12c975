"""What a person holds, and what they are told: lowerings, attempts and last checks."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.placement.rollout.replay import Attempt
from cluttergen_jax.placement.types import SupportGraph
from cluttergen_jax.types import Array, Verdict

_ON_TOP = 0.002


@dataclass(frozen=True)
class Held:
    """Where the current object is held: a pose in the region frame, in which it is let go.

    Attributes:
      x, y, z: metres, of the object's origin; z above the support's top. yaw: radians, from the region's x.
      is_lowered: it was lowered to first contact, and not moved since.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    is_lowered: bool = False


@dataclass(frozen=True)
class Lowered:
    """How the current object touches what is below it.

    Attributes:
      lift: metres higher than on the bare top.
      hanging: share of its under-side beyond the support's edge.
    """

    lift: float
    hanging: float

    @property
    def is_on_top(self) -> bool:
        """Whether it touches the support itself."""
        return self.lift < _ON_TOP


@dataclass(frozen=True, eq=False)
class Drop:
    """One attempt by hand, and what its verdict rests on.

    Attributes:
      attempt: as replays show one.
      mover: the placed object that was moved the most for its limits; None if nothing else stands there.
      shift, turn: metres and radians by which it was moved.
      penetration: metres, the deepest overlap. margin: metres, the new object's support margin.
    """

    attempt: Attempt
    mover: int | None
    shift: float
    turn: float
    penetration: float
    margin: float


@dataclass(frozen=True)
class Check:
    """The last check of a filled scene.

    Attributes:
      verdict: STABLE, or why the scene does not stand.
      mover: the object that moved the farthest; drift: how far, metres.
    """

    verdict: Verdict
    mover: int
    drift: float


@dataclass(frozen=True, eq=False)
class Before:
    """What `HandScene.undo` goes back to."""

    poses: Array
    is_placed: Array
    support_graph: SupportGraph
    held: Held
