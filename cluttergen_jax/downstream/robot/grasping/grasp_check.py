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

from cluttergen_jax.assets.mjcf import add_object
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.grasping.candidates import OBJECT, T_HAND_TOOL, Candidates
from cluttergen_jax.downstream.robot.model import PANDA, hand_spec
from cluttergen_jax.downstream.transforms import angle_between, inverse, matrix_of, pose_of

LIFT = 0.15
"""Metres that the object is lifted, in half a second."""
SHAKE = 3.0
"""m/s^2, to and fro in three directions."""
MAX_SLIP, MAX_TURN = 0.005, np.radians(10)
"""How far a verified grasp may let the object slip in the hand, metres and radians."""
MAX_SHIFT, MAX_SHIFT_TURN = 0.02, np.radians(20)
"""How far the closing fingers may push it."""
MAX_LOAD = 4.0
"""Times its weight that an object is pulled with in the end, to see how much more a grasp holds."""
_CLOSE, _HOLD, _LIFT, _SHAKE, _TURN, _LOAD = 0.5, 0.15, 0.5, 0.1, 0.4, 0.4
"""Seconds of each part."""


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
      lifted: the first step after it was lifted; loading: of the last part.
    """

    closed: np.ndarray
    weight: np.ndarray
    shake: np.ndarray
    angle: np.ndarray
    lifted: int
    loading: int


def check_grasps(asset: ObjectAsset, candidates: Candidates, pool: Rollout) -> GraspCheck:
    """Tests candidates in one batch; `pool` is a thread pool of MuJoCo's."""
    contact = ContactConfig()
    model, course = _model(asset, contact), _course(PANDA.timestep)
    T_hand_object = T_HAND_TOOL @ inverse(candidates.pose)
    num, steps = len(candidates.width), len(course.closed)
    object_body = model.body(OBJECT).id
    opening = candidates.opening[:, None]
    control = np.zeros((num, steps, model.nu + 6 * model.nbody))
    control[..., 0] = opening + course.closed * (PANDA.grip_target - opening)
    first = model.nu + 6 * object_body
    control[..., first : first + 3] = asset.mass * _pull(T_hand_object, course, contact.gravity)
    start = np.zeros((num, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    address = 1 + int(model.joint(OBJECT).qposadr[0])
    start[:, 1:address] = opening
    start[:, address : address + 7] = pose_of(T_hand_object)
    wanted = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED)
    states, _ = pool.rollout(
        model,
        [mujoco.MjData(model) for _ in range(max(pool.nthread, 1))],
        start,
        control,
        control_spec=wanted,
    )
    return _evaluate(states[..., address : address + 7], T_hand_object, course)


def _model(asset: ObjectAsset, contact: ContactConfig) -> mujoco.MjModel:
    """A hand and a body that weighs nothing by itself."""
    spec = hand_spec(contact)
    spec.option.gravity = (0.0, 0.0, 0.0)
    spec.option.cone = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}.get(
        contact.cone, mujoco.mjtCone.mjCONE_PYRAMIDAL
    )
    add_object(spec, asset, OBJECT)
    return spec.compile()


def _course(step: float) -> _Course:
    parts = np.round(np.array([_CLOSE, _HOLD, _LIFT, 6 * _SHAKE, 2 * _TURN, _LOAD]) / step).astype(int)
    close, hold, lift, shake, turn, load = parts
    ends = np.cumsum(parts)
    total, at = int(ends[-1]), np.arange(ends[-1])
    weight = np.clip((at - close) / max(hold // 2, 1), 0, 1)
    weight[ends[4] :] = np.linspace(1, MAX_LOAD, load)
    motion = np.zeros((total, 3))
    # The first half speeds it up, the second slows it down.
    speed_up = 4 * LIFT / _LIFT**2
    motion[ends[1] : ends[2], 2] = np.where(np.arange(lift) < lift // 2, speed_up, -speed_up)
    each = np.minimum(np.arange(shake) * 6 // shake, 5)
    motion[ends[2] : ends[3]] = SHAKE * (np.eye(3)[each // 2]) * np.where(each % 2, -1, 1)[:, None]
    angle = np.zeros(total)
    angle[ends[3] : ends[4]] = np.pi / 2 * np.minimum(np.linspace(0, 2, turn), np.linspace(2, 0, turn))
    return _Course(np.clip(at / (0.9 * close), 0, 1), weight, motion, angle, int(ends[2]), int(ends[4]))


def _pull(T_hand_object: np.ndarray, course: _Course, gravity: float) -> np.ndarray:
    """f64[C, T, 3]: m/s^2 that pull at the object in the hand's frame.

    The object's frame has the world's axes as long as the hand is not turned; it turns about the tool's x,
    so that what pulled along the approach pulls towards a finger.
    """
    apparent = -course.shake - np.array([0, 0, gravity]) * course.weight[:, None]
    in_hand = np.einsum("cij,tj->cti", T_hand_object[:, :3, :3], apparent)
    cos, sin = np.cos(course.angle), np.sin(course.angle)
    x, y, z = np.moveaxis(in_hand, -1, 0)
    return np.stack([x, cos * y - sin * z, sin * y + cos * z], axis=-1)


def _evaluate(motion: np.ndarray, start: np.ndarray, course: _Course) -> GraspCheck:
    """What the objects' poses f64[C, T, 7] in the hand's frame tell."""
    closed = int(np.flatnonzero(course.weight > 0)[0]) - 1
    is_sound = np.isfinite(motion).all((1, 2))
    motion = np.where(is_sound[:, None, None], motion, np.array([1e3, 0, 0, 1, 0, 0, 0]))
    poses = matrix_of(motion)
    shift = np.linalg.norm(poses[:, closed, :3, 3] - start[:, :3, 3], axis=1)
    pushed = angle_between(poses[:, closed], start)
    # Of the object's point that is between the fingers once they have closed.
    point = (inverse(poses[:, closed]) @ T_HAND_TOOL[:, 3])[:, None, :, None]
    slip = np.linalg.norm((poses[:, closed:] @ point)[..., :3, 0] - T_HAND_TOOL[:3, 3], axis=-1)
    turn = angle_between(poses[:, closed:], poses[:, closed, None])
    is_lost = (slip > MAX_SLIP) | (turn > MAX_TURN)
    before = course.loading - closed
    is_held = is_sound & ~is_lost[:, :before].any(1) & (shift <= MAX_SHIFT) & (pushed <= MAX_SHIFT_TURN)
    lost_at = np.where(is_lost.any(1), is_lost.argmax(1), is_lost.shape[1] - 1) + closed
    margin = np.where(is_held, course.weight[lost_at], 0.0)
    held = pose_of(inverse(T_HAND_TOOL) @ poses[:, course.lifted])
    return GraspCheck(is_held, shift, slip[:, :before].max(1), turn[:, :before].max(1), margin, held)
