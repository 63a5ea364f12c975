"""Grasps of one object by itself, held and failed ones, with what decides: contacts, friction, touch, a test.

Of formats that label objects: ACRONYM, Contact-GraspNet, GraspNet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mujoco.rollout import Rollout
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets import ObjectAsset, object_hash
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.candidates import (
    MARGIN,
    GraspCandidates,
    HandCheck,
    PointPairs,
    Union,
    draw_approaches,
    sample_pairs,
)
from cluttergen_jax.downstream.robot.grasping.grasp_check import check_grasps
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.transforms import rigid

_NUM_LINES = 6000
_SIDES = 16
"""Directions that count as below, one after the other: the hand comes from all around."""
_MOVED = 0.25
"""Share of candidates that are moved by chance, so that near failures are among them."""
# Standard deviations of that, metres and radians.
_SHIFT = 0.01
_TURN = np.radians(20)

_ROUNDS = 4
_AT_ONCE = 128
_LINES_AT_ONCE = 20_000
_ARC_STEPS = 16
"""Widths at which fingers are looked at that close on arcs."""


class FingerContacts(NamedTuple):
    """What two fingers meet that close along lines, L of them.

    Attributes:
      points: f64[L, 2, 3], of the finger on the axis's side, then of the other.
      normals: f64[L, 2, 3], outward.
      friction: f64[L], the sliding coefficient with which both contacts can be pressed towards each other;
        inf where nothing is met.
    """

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray

    @property
    def is_pair(self) -> np.ndarray:
        """bool[L]: both fingers meet the object."""
        return np.isfinite(self.friction)

    @property
    def width(self) -> np.ndarray:
        """f64[L]: metres between the contacts."""
        return np.linalg.norm(self.points[:, 0] - self.points[:, 1], axis=1)


class ObjectLabels(NamedTuple):
    """G grasps of one object, object frame, failures among them.

    Attributes:
      pose: f64[G, 4, 4], T_object_tool. pads: the same with the middle of the open pads as its origin; of a
        suction cup of its rim.
      points, normals: f64[G, 2, 3], where the closing fingers meet the object, as of `FingerContacts`; of a
        suction cup twice the middle of its rim.
      friction: f64[G], the coefficient that the contacts need; inf without two.
      is_force_closure: bool[G], the object's own friction is enough for them. Of a cup: its rim seals.
      is_free: bool[G], the open hand touches the object neither there nor on its straight way there.
      is_held: bool[G], it was free and held what the test asks for (`grasp_check`, `suction`).
      shift, slip, turn, margin: f64[G], as of `GraspCheck`; nan where it was not tested.
    """

    pose: np.ndarray
    pads: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    is_force_closure: np.ndarray
    is_free: np.ndarray
    is_held: np.ndarray
    shift: np.ndarray
    slip: np.ndarray
    turn: np.ndarray
    margin: np.ndarray


def can_hold(asset: ObjectAsset, robot: RobotDescription) -> bool:
    """Whether fingers can be put about an object anywhere: a quick look, which the test may not bear out."""
    widest = 2 * gripper_of(robot).max_opening - MARGIN
    pairs = sample_pairs(Union(asset.parts), _NUM_LINES, _rng(asset, 0), widest)
    return len(pairs.width) > 0


def sliding_friction(asset: ObjectAsset) -> float:
    """The sliding coefficient between an object and a hand."""
    return ContactConfig().friction[0] if asset.friction is None else asset.friction


def pads_of(pose: np.ndarray, width: np.ndarray | float, gripper: Gripper) -> np.ndarray:
    """f64[G, 4, 4]: the middle between pads that are metres f64[G] apart, of tools at f64[G, 4, 4]."""
    moved = pose.copy()
    moved[:, :3, 3] += np.broadcast_to(gripper.depth_of(width), len(pose))[:, None] * pose[:, :3, 2]
    moved[:, :3, 3] += np.broadcast_to(gripper.side_of(width), len(pose))[:, None] * pose[:, :3, 1]
    return moved


def closing_contacts(
    union: Union, middle: np.ndarray, axis: np.ndarray, reach: float
) -> FingerContacts:
    """What fingers meet that close along lines about points f64[L, 3], from `reach` metres on either side.

    Args:
      axis: f64[L, 3], unit.
    """
    parts = []
    for first in range(0, len(middle), _LINES_AT_ONCE):
        rows = slice(first, first + _LINES_AT_ONCE)
        parts.append(_close_along(union, middle[rows], axis[rows], reach))
    if not parts:
        return FingerContacts(np.zeros((0, 2, 3)), np.zeros((0, 2, 3)), np.zeros(0))
    return FingerContacts(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _close_along(
    union: Union, middle: np.ndarray, axis: np.ndarray, reach: float
) -> FingerContacts:
    number = len(middle)
    far = np.full((number, 2), -np.inf)
    normals = np.zeros((number, 2, 3))
    every = np.arange(number)
    for side, sign in enumerate((1.0, -1.0)):
        crossing = union.cast(middle, sign * axis)
        # The outermost face within reach is the one that a finger meets.
        leave = np.where(crossing.leave <= reach, crossing.leave, -np.inf)
        part = leave.argmax(1)
        far[:, side] = leave[every, part]
        is_met = np.isfinite(far[:, side])
        normals[is_met, side] = union.normals(crossing, part[is_met], every[is_met])
    # The two faces may lie on one side of the middle, but the material is between them.
    is_pair = np.isfinite(far).all(1)
    is_pair[is_pair] = far[is_pair].sum(1) > 0
    far = np.where(is_pair[:, None], far, 0.0)
    points = np.stack([middle + far[:, :1] * axis, middle - far[:, 1:] * axis], axis=1)
    facing = np.stack([(normals[:, 0] * axis).sum(1), -(normals[:, 1] * axis).sum(1)], axis=1)
    least = np.clip(facing.min(1), 1e-6, 1.0)
    friction = np.where(
        is_pair & (facing.min(1) > 0), np.sqrt(np.maximum(1 - least**2, 0)) / least, np.inf
    )
    return FingerContacts(points, normals, friction)


def _closed_contacts(union: Union, pose: np.ndarray, gripper: Gripper) -> FingerContacts:
    """What the fingers meet of a hand at T_object_tool f64[G, 4, 4], which may close on arcs."""
    widest = 2 * gripper.max_opening
    step = widest / _ARC_STEPS
    found = closing_contacts(
        union, pads_of(pose, widest, gripper)[:, :3, 3], pose[:, :3, 1], widest / 2
    )
    if not (np.ptp(gripper.depth) or gripper.side_of(0.0) != gripper.side_of(widest)):
        return found
    is_met = found.is_pair & (found.width >= widest - step)
    for width in widest - step * np.arange(1, _ARC_STEPS + 1):
        middle = pads_of(pose, width, gripper)[:, :3, 3]
        near = closing_contacts(union, middle, pose[:, :3, 1], widest / 2)
        # As the fingers come in from outside, the first that is as wide as they are is met.
        is_new = ~is_met & near.is_pair & (near.width >= width - step)
        for old, new in zip(found, near, strict=True):
            old[is_new] = new[is_new]
        is_met |= is_new
    found.friction[~is_met] = np.inf
    return found


def label_object(
    asset: ObjectAsset, number: int, seed: int, robot: RobotDescription, pool: Rollout
) -> ObjectLabels:
    """So many grasps of an object for the hand of a robot, from all around, each tested if the hand is free.

    The hand is open as wide as it goes; three quarters are drawn about antipodal points, the rest are such
    ones moved by chance. An object that fits nowhere between the fingers has none (G is 0).

    Args:
      pool: MuJoCo's threads; their number changes nothing.
    """
    rng = _rng(asset, seed)
    gripper = gripper_of(robot)
    widest = 2 * gripper.max_opening
    union = Union(asset.parts)
    pose, is_free = _draw_poses(asset, union, number, robot, rng)
    pads = pads_of(pose, widest, gripper)
    contacts = _closed_contacts(union, pose, gripper)
    is_held = np.zeros(len(pose), bool)
    measured = {name: np.full(len(pose), np.nan) for name in ("shift", "slip", "turn", "margin")}
    tested = np.flatnonzero(is_free)
    for first in range(0, len(tested), _AT_ONCE):
        rows = tested[first : first + _AT_ONCE]
        candidates = GraspCandidates(pose[rows], contacts.width[rows], np.zeros(len(rows), bool))
        test = check_grasps(asset, candidates, pool, robot=robot, is_wide=True)
        is_held[rows] = test.is_held
        for name, values in measured.items():
            values[rows] = getattr(test, name)
    return ObjectLabels(
        pose,
        pads,
        contacts.points,
        contacts.normals,
        contacts.friction,
        contacts.friction <= sliding_friction(asset),
        is_free,
        is_held,
        **measured,
    )


def _draw_poses(
    asset: ObjectAsset, union: Union, number: int, robot: RobotDescription, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`number` poses T_object_tool f64[G, 4, 4] or none, and of which the open hand is free, bool[G].

    Most are not free: so many are drawn `_ROUNDS` times at most, until half of what is kept is.
    """
    gripper = gripper_of(robot)
    pairs = sample_pairs(union, _NUM_LINES, rng, 2 * gripper.max_opening - MARGIN)
    hand = HandCheck(asset, robot)
    found: list[np.ndarray] = []
    free: list[bool] = []
    while len(found) < _ROUNDS and 2 * sum(free) < number:
        drawn = _draw_round(union, pairs, number, robot, rng)
        if not len(drawn):
            break
        found.append(drawn)
        free += [hand.clear_of(each, 2 * gripper.max_opening)[0] for each in drawn]
    if not found:
        return np.zeros((0, 4, 4)), np.zeros(0, bool)
    is_free = np.array(free)
    others = rng.permutation(np.flatnonzero(~is_free))[: number - min((number + 1) // 2, sum(free))]
    kept = rng.permutation(np.flatnonzero(is_free))[: number - len(others)]
    chosen = rng.permutation(np.concatenate([kept, others]))
    return np.concatenate(found)[chosen], is_free[chosen]


def _draw_round(
    union: Union,
    pairs: PointPairs,
    number: int,
    robot: RobotDescription,
    rng: np.random.Generator,
) -> np.ndarray:
    """f64[number, 4, 4], or none where no pair of points has an approach."""
    gripper = gripper_of(robot)
    found: list[np.ndarray] = []
    for _ in range(_SIDES):
        down = rng.normal(size=3)
        down /= np.linalg.norm(down)
        # Many of these are not deep enough.
        share = -(-4 * number // _SIDES)
        drawn = draw_approaches(union, pairs, share, rng, gripper, robot.gripper.pad, down)
        found.append(drawn.pose)
    pose = np.concatenate(found)
    if not len(pose):
        return pose
    pose = pose[np.resize(rng.permutation(len(pose)), number)]
    num_moved = round(_MOVED * number)
    turn = Rotation.from_rotvec(rng.normal(0, _TURN, (num_moved, 3))).as_matrix()
    pose[:num_moved] = pose[:num_moved] @ rigid(turn, rng.normal(0, _SHIFT, (num_moved, 3)))
    return pose


def _rng(asset: ObjectAsset, seed: int) -> np.random.Generator:
    """An object's own numbers, whatever bank it is in."""
    return np.random.default_rng([seed, int(object_hash(asset)[:12], 16), 86])
