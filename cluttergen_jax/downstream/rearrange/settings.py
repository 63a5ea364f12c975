"""Settings of rearrangement: where objects stand at first, and where they shall go."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.config import LayoutRule, Method, PickOrder

AREA = Rectangle((0.0, 0.0), (0.27, 0.32))
"""All of the usual table that the arm reaches; objects may wait anywhere in it."""
_NEAR = Rectangle((0.0, -0.15), (0.225, 0.125))
_FAR = Rectangle((0.0, 0.15), (0.225, 0.125))
"""The paper's: 0.45 m x 0.25 m about y = +0.15 m."""


@dataclass(frozen=True)
class RearrangeSetting:
    """A kind of rearrangement; all on the usual table, in the world frame, region-centred.

    Attributes:
      name: of the setting.
      num_objects: that shall be moved; num_others: that stand in the target and shall stay.
      start, target: where objects stand at first, and where their layouts are drawn.
      method: how the starting scene is made.
      num_stacked: objects that lie on others at the start, at least; the arm gets at the topmost.
    """

    name: str
    num_objects: int = 5
    num_others: int = 0
    start: Rectangle = _NEAR
    target: Rectangle = _FAR
    method: Method = "clear"
    num_stacked: int = 0

    @property
    def num_slots(self) -> int:
        """Objects in all."""
        return self.num_objects + self.num_others


@dataclass(frozen=True)
class RearrangeOptions:
    """How a rearrangement is done.

    Attributes:
      choose: the rule by which a layout is chosen. layout: its number instead; None goes by the rule.
      num_layouts: from how many unlike ones.
      relook: look again after each move, and try again what went wrong.
      order: "graph", or "lowest" object first as in the paper, whatever is in the way.
      one_grasp: an object has a single grasp, at 0 and 180 degrees, as in the paper.
    """

    choose: LayoutRule = "clearance"
    layout: int | None = None
    num_layouts: int = 10
    relook: bool = True
    order: PickOrder = "graph"
    one_grasp: bool = False


SETTINGS = {
    each.name: each
    for each in (
        RearrangeSetting("paper"),
        RearrangeSetting("occupied", num_others=3),
        RearrangeSetting(
            "blocked",
            start=Rectangle((0.0, 0.0), (0.2, 0.15)),
            target=Rectangle((0.0, 0.0), (0.2, 0.15)),
        ),
        RearrangeSetting(
            "eight",
            num_objects=8,
            start=Rectangle((0.0, -0.16), (0.25, 0.15)),
            target=Rectangle((0.0, 0.16), (0.25, 0.15)),
        ),
        RearrangeSetting(
            "stacked",
            start=Rectangle((0.0, -0.15), (0.15, 0.1)),
            method="drop",
            num_stacked=1,
        ),
    )
}
