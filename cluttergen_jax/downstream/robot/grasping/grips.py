"""Ways for a hand to take an object where it stands, the best first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.gripper import Gripper
from cluttergen_jax.downstream.transforms import angle_between, inverse, matrix_of

_LEVER = 10.0
"""What a metre from the line between the fingers to the object's middle takes from a grasp's worth."""
FIRM = 0.04
"""Metres of it up to which an object hardly swings in the hand."""
_SWING = 6.0
"""What a radian takes from it by which the object turned in the hand: as that closed and lifted it, and in
the test. Over five seconds of holding it mostly turns as far as until it was lifted (reports/measured.md)."""
_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


class Grip(NamedTuple):
    """How a hand takes an object.

    Attributes:
      T_object_tool: f64[4, 4], before the fingers close; T_tool_object: f64[4, 4], once it is lifted.
      width: metres between the fingers; opening: that each of them is from the middle before it closes.
      lever: metres in plan from the line between them to the object's middle, about which it swings.
    """

    T_object_tool: np.ndarray
    T_tool_object: np.ndarray
    width: float
    opening: float
    lever: float


def rank_grasps(grasps: Grasps, T_world_object: np.ndarray, gripper: Gripper) -> Iterator[Grip]:
    """Grasps, each also by half a turn about its approach where that makes no difference to the hand.

    Those that come from above, hold well and in which the object turns little in the hand are first.
    """
    pose = matrix_of(grasps.pose)
    held = matrix_of(grasps.held)
    worth, levers = _worth(grasps, T_world_object)
    for index in np.argsort(-worth, kind="stable"):
        for turn in (np.eye(4), _FLIP) if gripper.is_even else (np.eye(4),):
            width = float(grasps.width[index])
            lever = float(levers[index])
            opening = float(gripper.opening_of(width))
            yield Grip(pose[index] @ turn, turn @ held[index], width, opening, lever)


def _worth(grasps: Grasps, T_world_object: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[G], a grasp's worth: more if it comes from above and holds well; f64[G], its lever (`Grip`)."""
    turned = T_world_object[:3, :3] @ matrix_of(grasps.pose)[:, :3]
    down = -turned[:, 2, 2]
    levers = _levers(turned)
    # A centimetre of slip or of shift counts as much as half a turn from straight down.
    worth = down + 0.25 * grasps.margin - 100 * (grasps.shift + grasps.slip)
    turned_by = grasps.turn + angle_between(inverse(matrix_of(grasps.pose)), matrix_of(grasps.held))
    return worth - (_SWING * turned_by + _LEVER * levers), levers


def _levers(pose: np.ndarray) -> np.ndarray:
    """f64[G]: metres in plan from the line between the fingers to the object's middle, about which it swings.

    Args:
      pose: f64[G, 3, 4], T_object_tool, turned into world axes.
    """
    axis = pose[:, :2, 1]
    at = pose[:, :2, 3]
    return np.abs(axis[:, 0] * at[:, 1] - axis[:, 1] * at[:, 0])


def first_grasp(grasps: Grasps) -> Grasps:
    """The one that `rank_grasps` has first where the object stands upright."""
    if not len(grasps):
        return grasps
    worth, _ = _worth(grasps, np.eye(4))
    best = [int(worth.argmax())]
    columns = ("pose", "held", "width", "shift", "slip", "turn", "margin", "is_low")
    return replace(grasps, **{name: getattr(grasps, name)[best] for name in columns})
