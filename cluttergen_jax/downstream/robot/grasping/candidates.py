"""Candidates for grasps of an object: antipodal pairs, and the ways in which the hand gets around them."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.assets import ObjectAsset, add_object
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.antipodal import Pairs, Union, sample_pairs
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import inverse, pose_of, rigid, shift_along

MIN_COVER = 0.012
"""Metres of a pad, along and across the approach, that must lie on an object that has so much."""
MARGIN = 0.004
"""Metres that an object is narrower than the hand opens."""
OBJECT = "object"
_LEAST_WIDTH = 0.001
_SHALLOW = (0.0, 0.005)
"""Metres by which a grasp's points may lie nearer to the finger's tips than the middle of the pads."""
_INSIDE = 5e-4
_STEEPEST_UP = 0.1
_DOWN = np.array([0.0, 0.0, -1.0])
_CLEARANCE = 0.0015
"""Metres between the hand and the object; the arm is where it should be to a millimetre."""
_PLANE = "plane"
_GROUND_GAP = 0.001
_GROUND_HALF = (0.5, 0.5, 0.05)
_BACK = (0.0, 0.03, 0.06, 0.1)
"""Metres before the grasp at which the hand must be clear of the object too."""


class Candidates(NamedTuple):
    """C ways to hold an object.

    Attributes:
      pose: f64[C, 4, 4], T_object_tool. width: f64[C], metres between the fingers.
      is_low: bool[C], the hand can come there while the object rests on a plane; the others need room below.
    """

    pose: np.ndarray
    width: np.ndarray
    is_low: np.ndarray

    def take(self, index: np.ndarray | slice) -> Candidates:
        """Those at `index`."""
        return Candidates(*(each[index] for each in self))


def candidates_of(
    asset: ObjectAsset,
    number: int,
    num_lines: int,
    rng: np.random.Generator,
    robot: RobotDescription,
) -> Candidates:
    """At most `number` candidates of which the hand is clear where it comes, spread over the object.

    Those that can be had while the object rests on a plane as it does in scenes come first.

    Args:
      num_lines: lines that are cast to find pairs; half as many ways of approach are looked at.
      robot: whose hand it is.
    """
    union = Union(asset.parts)
    gripper = gripper_of(robot)
    pairs = sample_pairs(union, num_lines, rng, 2 * gripper.max_opening - MARGIN)
    found = draw_approaches(union, pairs, max(num_lines // 2, 1), rng, gripper, robot.gripper.pad)
    found = found.take(spread(found.pose, min(len(found.width), 4 * number), rng))
    hand = HandCheck(asset, robot)
    clear = [hand.clear_of(*each) for each in zip(found.pose, found.width, strict=True)]
    of_object, of_plane = np.array(clear, bool).reshape(-1, 2).T
    found = found._replace(is_low=of_object & of_plane)
    order = np.concatenate([np.flatnonzero(found.is_low), np.flatnonzero(of_object & ~of_plane)])
    return found.take(order[:number])


def draw_approaches(
    union: Union,
    pairs: Pairs,
    number: int,
    rng: np.random.Generator,
    gripper: Gripper,
    pad: float,
    down: np.ndarray = _DOWN,
    spread: float | None = None,
) -> Candidates:
    """So many poses of the tool about random pairs, deep enough; half of them come from straight above.

    Nothing is asked of the hand: of some it cannot come there.

    Args:
      pad: metres, half of a pad's length along the approach.
      down: f64[3], unit, where the world's -z is in the object's frame.
      spread: radians, standard deviation of the turns of the other half; None turns them evenly by up to a
        right angle.
    """
    wide = np.flatnonzero(pairs.width >= _LEAST_WIDTH)
    if not wide.size:
        return Candidates(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, bool))
    row = rng.choice(wide, number)
    axis = pairs.axis[row]
    width = pairs.width[row]
    middle = pairs.middle[row]
    below = _downwards(axis, down)
    side = np.cross(axis, below)
    quarter = np.pi / 2
    turned = (
        rng.uniform(-quarter, quarter, number) if spread is None else rng.normal(0, spread, number)
    )
    angle = np.where(np.arange(number) % 2, np.clip(turned, -quarter, quarter), 0.0)
    approach = np.cos(angle)[:, None] * below + np.sin(angle)[:, None] * side
    shallow = rng.choice(_SHALLOW, number)
    first = pairs.first[row] + _INSIDE * axis
    ahead = union.reach(first, approach)
    behind = union.reach(first, -approach)
    depth = np.minimum(ahead, pad - shallow) + np.minimum(behind, pad + shallow)
    across = np.cross(axis, approach)
    left = union.reach(first, across)
    right = union.reach(first, -across)
    cover = np.minimum(left, pad) + np.minimum(right, pad)
    is_deep = (depth >= np.minimum(MIN_COVER, 0.75 * (ahead + behind))) & (
        cover >= np.minimum(MIN_COVER, 0.75 * (left + right))
    )
    keep = is_deep & (approach @ down >= -_STEEPEST_UP)
    turn = np.stack([across, axis, approach], axis=-1)
    # The pads are where the tool's origin is, but for what they move along the approach as they close.
    back = shallow + gripper.depth_of(width)
    pose = rigid(turn, middle - back[:, None] * approach)[keep]
    return Candidates(pose, width[keep], np.zeros(len(pose), bool))


def _downwards(axis: np.ndarray, down: np.ndarray) -> np.ndarray:
    """f64[P, 3]: of the directions across each axis the one that points down the most."""
    below = down - axis * (axis @ down)[:, None]
    length = np.linalg.norm(below, axis=1, keepdims=True)
    # Across an upright axis any direction is as good as another.
    any_side = np.eye(3)[np.argmin(np.abs(down))]
    any_side = any_side - down * (down @ any_side)
    return np.where(
        length > 1e-3, below / np.maximum(length, 1e-3), any_side / np.linalg.norm(any_side)
    )


class HandCheck:
    """Says of which poses the open hand is clear of an object and of the plane that the object rests on.

    Args:
      asset: the object. robot: whose hand it is.
    """

    def __init__(self, asset: ObjectAsset, robot: RobotDescription) -> None:
        spec = hand_spec(ContactConfig(), robot)
        self._gripper = gripper_of(robot)
        for geom in spec.geoms:
            geom.margin = _CLEARANCE
        body = add_object(spec, asset, OBJECT)
        below = -asset.half_extents[2] - _GROUND_GAP - _GROUND_HALF[2]
        body.add_geom(
            name=_PLANE, type=mujoco.mjtGeom.mjGEOM_BOX, size=_GROUND_HALF, pos=(0.0, 0.0, below)
        )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._start = int(self._model.joint(OBJECT).qposadr[0])
        self._plane = self._model.geom(_PLANE).id
        self._is_hand = self._model.geom_bodyid != self._model.body(OBJECT).id

    def clear_of(self, pose: np.ndarray, width: float) -> tuple[bool, bool]:
        """Whether the hand touches neither the object nor the plane at T_object_tool f64[4, 4].

        Nor before, where it comes straight.
        """
        opening = self._gripper.opening_of(np.array(width))
        of_plane = True
        self._data.qpos[: self._start] = self._gripper.joints_of(opening)
        for back in _BACK:
            of_object, is_clear = self._look(pose, back)
            if not of_object:
                return False, False
            of_plane = of_plane and is_clear
        # Fingers that move on arcs come nearer to the plane as they close.
        ahead = float(self._gripper.depth_of(width) - self._gripper.depth_of(2 * opening))
        if of_plane and ahead:
            of_plane = self._look(pose, -ahead)[1]
        return True, of_plane

    def _look(self, pose: np.ndarray, back: float) -> tuple[bool, bool]:
        """Whether the hand, so far before a grasp, is clear of the object, and of the plane."""
        data = self._data
        T_hand_object = shift_along(self._gripper.T_hand_tool, (0.0, 0.0, back)) @ inverse(pose)
        data.qpos[self._start :] = pose_of(T_hand_object)
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        # Parts of a hand may touch each other.
        asked = ~self._is_hand[data.contact.geom].all(1)
        on_plane = (data.contact.geom == self._plane).any(1)
        # The plane's distance is allowed for in where it lies.
        of_plane = not (data.contact.dist < 0)[asked & on_plane].any()
        return bool(on_plane[asked].all()), of_plane


def spread(pose: np.ndarray, number: int, rng: np.random.Generator) -> np.ndarray:
    """i[number]: poses f64[C, 4, 4], each the farthest from those before it.

    Two poses are as far apart as their positions, and as their axes of approach and of closing, where half
    a turn about the approach changes nothing: a right angle counts as much as 10 cm.
    """
    if not len(pose):
        return np.zeros(0, np.int64)
    distance = np.full(len(pose), np.inf)
    chosen = [int(rng.integers(len(pose)))]
    while len(chosen) < number:
        near = pose[chosen[-1]]
        place = np.linalg.norm(pose[:, :3, 3] - near[:3, 3], axis=1)
        approach = np.arccos(np.clip(pose[:, :3, 2] @ near[:3, 2], -1, 1))
        closing = np.arccos(np.clip(np.abs(pose[:, :3, 1] @ near[:3, 1]), 0, 1))
        distance = np.minimum(distance, place + 0.1 * (approach + closing) / (np.pi / 2))
        chosen.append(int(distance.argmax()))
    return np.array(chosen[:number], np.int64)
