"""The test of grasps: a hand closes on an object, lifts it, shakes it and turns it, in MuJoCo.

The hand stays where it is, and the object feels what it would feel in the moving hand: weight and inertia are
forces in the hand's frame (d'Alembert). So many grasps are tested in one batch, with no arm that could do
wrong; what the turn's own rotation adds is left out, a fortieth of the weight.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from cluttergen_jax.assets import ObjectAsset, add_object
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.grasping.candidates import OBJECT, GraspCandidates
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import angle_between, inverse, matrix_of, pose_of

LIFT = 0.15
"""Metres that the object is lifted, in half a second."""
SHAKE = 3.0
"""m/s^2, to and fro in three directions."""
# How far a verified grasp may let the object slip in the hand, metres and radians.
MAX_SLIP = 0.005
MAX_TURN = np.radians(10)

# How far the closing fingers may push it.
MAX_SHIFT = 0.02
MAX_SHIFT_TURN = np.radians(20)

MAX_LOAD = 4.0
"""Times its weight that an object is pulled with in the end, to see how much more a grasp holds."""
# Seconds of each part.
_CLOSE = 0.5
_HOLD = 0.15
_LIFT = 0.5
_SHAKE = 0.1
_TURN = 0.4
_LOAD = 0.4

_TIMESTEP = 1 / 360
"""Seconds. At the arm's 1/960 nearly the same grasps hold, at 2.7 times the cost; 1/240 chatters."""


class GraspCheck(NamedTuple):
    """What became of C grasps.

    Attributes:
      is_held: bool[C], it slipped less than is allowed throughout.
      shift: f64[C], metres that the closing fingers moved the object.
      slip: f64[C], metres that its point between the fingers moved in the hand afterwards, at most.
      turn: f64[C], radians that it turned in the hand.
      margin: f64[C], times its weight that it held, of `MAX_LOAD`; 0 if it is not held.
      held: f64[C, 7], T_tool_object, how it lay in the hand after it was lifted.
    """

    is_held: np.ndarray
    shift: np.ndarray
    slip: np.ndarray
    turn: np.ndarray
    margin: np.ndarray
    held: np.ndarray


class _Course(NamedTuple):
    """T steps of the test.

    Attributes:
      closed: f64[T], 0 open, 1 closed. weight: f64[T], how strongly the object is pulled down, in weights.
      shake: f64[T, 3], m/s^2 of the hand in world axes. angle: f64[T], by which it is turned, radians.
      closed_at: the last step of closing; lifted: the first after it was lifted; loading: the first after the
        turn, T where no load follows.
    """

    closed: np.ndarray
    weight: np.ndarray
    shake: np.ndarray
    angle: np.ndarray
    closed_at: int
    lifted: int
    loading: int


def check_grasps(
    asset: ObjectAsset,
    candidates: GraspCandidates,
    pool: Rollout,
    is_brief: bool = False,
    robot: RobotDescription | None = None,
    is_wide: bool = False,
) -> GraspCheck:
    """Tests candidates in one batch; one that is lost by the time it is lifted is not simulated further.

    Args:
      pool: a thread pool of MuJoCo's.
      is_brief: leave out the shaking and the load; `margin` is then 1 or 0.
      robot: whose hand it is; the Panda's if not given.
      is_wide: the hand comes open as wide as it goes, not as wide as the object asks for.
    """
    contact = ContactConfig()
    robot = robot or find_robot()
    model = _model(asset, contact, robot)
    course = _course(_TIMESTEP, is_brief)
    gripper = gripper_of(robot)
    T_hand_object = gripper.T_hand_tool @ inverse(candidates.pose)
    num = len(candidates.width)
    steps = len(course.closed)
    object_body = model.body(OBJECT).id
    opening = np.full(num, gripper.max_opening) if is_wide else gripper.opening_of(candidates.width)
    come = gripper.control_of(opening)[:, None]
    control = np.zeros((num, steps, model.nu + 6 * model.nbody))
    control[..., 0] = come + course.closed * (gripper.closed - come)
    first = model.nu + 6 * object_body
    control[..., first : first + 3] = asset.mass * _pull(
        T_hand_object, course, contact.gravity, gripper.T_hand_tool[:3, :3]
    )
    start = np.zeros((num, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    address = 1 + int(model.joint(OBJECT).qposadr[0])
    start[:, 1:address] = gripper.joints_of(opening)
    start[:, address : address + 7] = pose_of(T_hand_object)
    data = [mujoco.MjData(model) for _ in range(max(pool.nthread, 1))]
    wanted = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED)
    lifting, later = np.split(control, [course.lifted], axis=1)
    states, _ = pool.rollout(model, data, start, lifting, control_spec=wanted)
    motion = np.empty((num, steps, 7))
    # What is lost by then stays where it is.
    motion[:, : course.lifted] = states[..., address : address + 7]
    motion[:, course.lifted :] = motion[:, course.lifted - 1 : course.lifted]
    point = _points(gripper, candidates.width)
    closed, last = (
        matrix_of(_sound(motion)[:, step]) for step in (course.closed_at, course.lifted - 1)
    )
    is_kept = ~_is_lost(*_slip_and_turn(closed, last[:, None], point))[:, 0] & ~_is_pushed(
        closed, T_hand_object
    )
    if is_kept.any():
        states, _ = pool.rollout(
            model, data, states[is_kept, -1], later[is_kept], control_spec=wanted
        )
        motion[is_kept, course.lifted :] = states[..., address : address + 7]
    return _evaluate(motion, T_hand_object, course, gripper.T_hand_tool, point)


def _points(gripper: Gripper, width: np.ndarray) -> np.ndarray:
    """f64[C, 4, 1]: the points between the pads in the hand's frame, homogeneous."""
    depth = gripper.depth_of(width)[:, None]
    side = gripper.side_of(width)[:, None]
    _, y, z, origin = gripper.T_hand_tool.T
    return (origin + depth * z + side * y)[..., None]


def _model(asset: ObjectAsset, contact: ContactConfig, robot: RobotDescription) -> mujoco.MjModel:
    """A hand and a body that weighs nothing by itself."""
    spec = hand_spec(contact, robot)
    spec.option.timestep = _TIMESTEP
    spec.option.gravity = (0.0, 0.0, 0.0)
    spec.option.cone = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}.get(
        contact.cone, mujoco.mjtCone.mjCONE_PYRAMIDAL
    )
    add_object(spec, asset, OBJECT)
    return spec.compile()


def _course(step: float, is_brief: bool) -> _Course:
    seconds = np.array([_CLOSE, _HOLD, _LIFT, 6 * _SHAKE, 2 * _TURN, _LOAD])
    seconds[[3, 5]] *= not is_brief
    parts = np.round(seconds / step).astype(int)
    close, hold, lift, shake, turn, load = parts
    ends = np.cumsum(parts)
    total = int(ends[-1])
    at = np.arange(ends[-1])
    weight = np.clip((at - close) / max(hold // 2, 1), 0, 1)
    weight[ends[4] :] = np.linspace(1, MAX_LOAD, load)
    motion = np.zeros((total, 3))
    # The first half speeds it up, the second slows it down.
    speed_up = 4 * LIFT / _LIFT**2
    motion[ends[1] : ends[2], 2] = np.where(np.arange(lift) < lift // 2, speed_up, -speed_up)
    each = np.minimum(np.arange(shake) * 6 // shake, 5)
    motion[ends[2] : ends[3]] = SHAKE * (np.eye(3)[each // 2]) * np.where(each % 2, -1, 1)[:, None]
    angle = np.zeros(total)
    angle[ends[3] : ends[4]] = (
        np.pi / 2 * np.minimum(np.linspace(0, 2, turn), np.linspace(2, 0, turn))
    )
    closed = np.clip(at / (0.9 * close), 0, 1)
    return _Course(closed, weight, motion, angle, int(close), int(ends[2]), int(ends[4]))


def _pull(
    T_hand_object: np.ndarray, course: _Course, gravity: float, R_hand_tool: np.ndarray
) -> np.ndarray:
    """f64[C, T, 3]: m/s^2 that pull at the object in the hand's frame.

    The object's frame has the world's axes as long as the hand is not turned; it turns about the tool's x,
    so that what pulled along the approach pulls towards a finger.
    """
    apparent = -course.shake - np.array([0, 0, gravity]) * course.weight[:, None]
    in_tool = np.einsum("cij,tj->cti", R_hand_tool.T @ T_hand_object[:, :3, :3], apparent)
    cos = np.cos(course.angle)
    sin = np.sin(course.angle)
    x, y, z = np.moveaxis(in_tool, -1, 0)
    return np.stack([x, cos * y - sin * z, sin * y + cos * z], axis=-1) @ R_hand_tool.T


def _evaluate(
    motion: np.ndarray,
    start: np.ndarray,
    course: _Course,
    T_hand_tool: np.ndarray,
    point: np.ndarray,
) -> GraspCheck:
    """What the objects' poses f64[C, T, 7] in the hand's frame tell; point: f64[C, 4, 1], as `_points`."""
    closed_at = course.closed_at
    poses = matrix_of(_sound(motion))
    closed = poses[:, closed_at]
    slip, turn = _slip_and_turn(closed, poses[:, closed_at:], point)
    is_lost = _is_lost(slip, turn)
    before = course.loading - closed_at
    is_held = (
        np.isfinite(motion).all((1, 2)) & ~is_lost[:, :before].any(1) & ~_is_pushed(closed, start)
    )
    lost_at = np.where(is_lost.any(1), is_lost.argmax(1), is_lost.shape[1] - 1) + closed_at
    margin = np.where(is_held, course.weight[lost_at], 0.0)
    held = pose_of(inverse(T_hand_tool) @ poses[:, course.lifted])
    return GraspCheck(
        is_held,
        _shift(closed, start),
        slip[:, :before].max(1),
        turn[:, :before].max(1),
        margin,
        held,
    )


def _sound(motion: np.ndarray) -> np.ndarray:
    """f64[C, T, 7]: poses, far away where the simulation has failed."""
    is_sound = np.isfinite(motion).all((1, 2))
    return np.where(is_sound[:, None, None], motion, np.array([1e3, 0, 0, 1, 0, 0, 0]))


def _shift(closed: np.ndarray, start: np.ndarray) -> np.ndarray:
    return np.linalg.norm(closed[:, :3, 3] - start[:, :3, 3], axis=1)


def _is_pushed(closed: np.ndarray, start: np.ndarray) -> np.ndarray:
    """bool[C]: the closing fingers moved the object, f64[C, 4, 4] each, too far."""
    return (_shift(closed, start) > MAX_SHIFT) | (angle_between(closed, start) > MAX_SHIFT_TURN)


def _slip_and_turn(
    closed: np.ndarray, poses: np.ndarray, point: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """f64[C, T] each: metres and radians by which poses f64[C, T, 4, 4] are off from `closed` f64[C, 4, 4].

    The slip is that of the object's point f64[C, 4, 1] between the fingers once they have closed.
    """
    moved = poses @ (inverse(closed) @ point)[:, None]
    slip = np.linalg.norm(moved[..., :3, 0] - point[:, None, :3, 0], axis=-1)
    return slip, angle_between(poses, closed[:, None])


def _is_lost(slip: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return (slip > MAX_SLIP) | (turn > MAX_TURN)
