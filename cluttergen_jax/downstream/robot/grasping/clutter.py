"""Grasps in clutter: poses of a hand in a finished scene, which are free, and which lift something."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.assets import VISUAL_GROUP, ObjectAsset, object_hash, populated_spec
from cluttergen_jax.downstream.episodes.robot_parts import bodies_of_tree
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.candidates import (
    BACK,
    CLEARANCE,
    MARGIN,
    STEEPEST_UP,
    PointPairs,
    Union,
    draw_approaches,
    sample_pairs,
)
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import (
    IMPRATIO,
    copy_options,
    hand_spec,
    remove_drawings,
)
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of, rigid, shift_along
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera, cast_rays

LIFT = 0.10
"""Metres that the hand rises once it has closed."""
RAISED = 0.8
"""Share of `LIFT` by which an object has to have come up in the end."""
FINGER_DEPTH = 0.045
"""Metres from the root of the fingers to the middle of their pads."""
ROUNDS = 16
"""How often candidates of a scene are drawn at most."""
_NUM_LINES = 1500
TIMESTEP = 1 / 360
# Seconds of each part of a lift.
_CLOSE = 0.5
_RISE = 0.5
_HOLD = 0.2

_EMPTY = 0.002
"""Metres between the fingers up to which they have closed on nothing."""
_AT_ONCE = 6
_PREFIX = "hand/"
_CARRIAGE = "carriage"
# N/m and N s/m of what lifts the hand: it sags by half a millimetre under a kilogram.
_GAIN = 2e4
_DAMPING = 400.0

_UPWARDS = ((0.0, 0.0, 1.0),)
# As VGN has them: metres before the grasp from which the hand comes, by which it goes back, and of a step;
# metres a second; radians from straight down from which it goes back upwards; share of the widest opening.
_START = 0.05
_BACK_BY = 0.10
_STEP_LENGTH = 0.002
_SPEED = 0.10
_STEEP = np.pi / 3
_LEAST_GAP = 0.1

_SPREAD = np.radians(35)
"""Of antipodal candidates: most that come flatly are blocked."""
_AWAY = np.array([0.0, 0.0, 100.0, 1.0, 0.0, 0.0, 0.0])


class Source(StrEnum):
    """How a candidate was drawn.

    ANTIPODAL: about two points of an object that the fingers can press towards each other. SURFACE: along the
    normal of any point of an object's surface, open as wide as the hand goes.
    """

    ANTIPODAL = "antipodal"
    SURFACE = "surface"


class LiftEnd(StrEnum):
    """What became of a lift.

    LIFTED: an object came up with the hand. EMPTY: the fingers closed on nothing. LOST: they closed on
    something that did not come up. DIVERGED: the simulation failed. BLOCKED: the open hand touched something
    before it closed, where that ends an attempt (`rounds.GraspRule`).
    """

    LIFTED = "lifted"
    EMPTY = "empty"
    LOST = "lost"
    DIVERGED = "diverged"
    BLOCKED = "blocked"


class ClutterGrasps(NamedTuple):
    """C poses of the hand in a scene.

    Attributes:
      pose: f64[C, 4, 4], T_world_tool: z is the approach, y the direction in which the fingers close.
      width: f64[C], metres between the points that the fingers press on; of `SURFACE` the widest there is.
      target: i64[C], the number of the object that is meant.
      is_antipodal: bool[C], the source.
    """

    pose: np.ndarray
    width: np.ndarray
    target: np.ndarray
    is_antipodal: np.ndarray

    def take(self, index: np.ndarray) -> ClutterGrasps:
        """Those at `index`."""
        return ClutterGrasps(*(each[index] for each in self))


class LabelledGrasps(NamedTuple):
    """What is kept of the candidates of a scene.

    Attributes:
      grasps: C of them. blocked_by: str[C], the body that the open hand touches; "" where it is free.
      num_drawn, num_free: of all that were drawn.
    """

    grasps: ClutterGrasps
    blocked_by: np.ndarray
    num_drawn: int
    num_free: int


class Lift(NamedTuple):
    """What became of one lift.

    Attributes:
      end: how it ended. raised: the number of the object that came up, -1 for none.
      width: metres between the fingers in the end. moved: metres that another object moved, at most.
    """

    end: LiftEnd
    raised: int
    width: float
    moved: float


def label_grasps(
    scene: Scene, still: StillScene, number: int, rng: np.random.Generator
) -> LabelledGrasps:
    """Draws candidates for a scene and looks which of them are free; half of each source where there are.

    In clutter most are not free. So `number` of them are drawn again and again, `ROUNDS` times at most, until
    half of what is kept is free; of those that are not as many are kept as there is room for.
    """
    parts: list[ClutterGrasps] = []
    blockers: list[str] = []
    while len(parts) < ROUNDS and 2 * blockers.count("") < number:
        parts.append(draw_grasps(scene, still.robot, number, rng))
        blockers += [
            still.blocker(*each) for each in zip(parts[-1].pose, parts[-1].width, strict=True)
        ]
    drawn = _joined_grasps(parts)
    blocked_by = np.array(blockers)
    is_free = blocked_by == ""
    free = rng.permutation(np.flatnonzero(is_free))[: (number + 1) // 2]
    others = rng.permutation(np.flatnonzero(~is_free))[: number - len(free)]
    chosen = np.sort(np.concatenate([free, others]))
    return LabelledGrasps(drawn.take(chosen), blocked_by[chosen], len(is_free), int(is_free.sum()))


def draw_grasps(
    scene: Scene, robot: RobotDescription, number: int, rng: np.random.Generator
) -> ClutterGrasps:
    """Candidates for a scene, spread evenly over its objects; half of each source.

    None of them was tested. The hand never comes from below.

    Args:
      robot: whose hand it is.
      number: C, fewer where antipodal ones are rare.
    """
    whole = _joined_grasps(
        [_draw_for(scene, index, robot, rng, number) for index in range(len(scene.names))]
    )
    chosen = [
        rng.permutation(np.flatnonzero(whole.is_antipodal == is_antipodal))[:share]
        for is_antipodal, share in ((True, (number + 1) // 2), (False, number // 2))
    ]
    return whole.take(np.sort(np.concatenate(chosen)))


def _joined_grasps(parts: Sequence[ClutterGrasps]) -> ClutterGrasps:
    return ClutterGrasps(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _draw_for(
    scene: Scene, index: int, robot: RobotDescription, rng: np.random.Generator, number: int
) -> ClutterGrasps:
    """The share of one object, of each source."""
    share = -(-number // len(scene.names))
    gripper = gripper_of(robot)
    widest = 2 * gripper.max_opening - MARGIN
    union, pairs = _lines(scene.objects[index], widest)
    T = matrix_of(scene.poses[index])
    # Many of these are not deep enough.
    found = draw_approaches(
        union, pairs, 4 * share, rng, gripper, robot.gripper.pad, -T[2, :3], _SPREAD
    )
    chosen = rng.permutation(len(found.width))[:share]
    seen = T @ _surface_poses(union, share, T[:3, :3], rng)
    return ClutterGrasps(
        np.concatenate([T @ found.pose[chosen], seen]),
        np.concatenate([found.width[chosen], np.full(len(seen), widest)]),
        np.full(len(chosen) + len(seen), index),
        np.arange(len(chosen) + len(seen)) < len(chosen),
    )


def _surface_poses(
    union: Union, number: int, turn: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """f64[C, 4, 4]: T_object_tool along the normals of points that do not face down.

    The root of the fingers is between 5 mm below the surface and 5 mm more than they are long above it, as
    VGN draws it (Breyer et al., CoRL 2020).
    """
    points, normals = union.surface_points(4 * number, rng)
    is_up = (normals @ turn.T)[:, 2] > -STEEPEST_UP
    points = points[is_up][:number]
    normals = normals[is_up][:number]
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    x = np.cross(helper, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    angle = rng.uniform(0, np.pi, (len(points), 1))
    y = np.cos(angle) * np.cross(-normals, x) - np.sin(angle) * x
    depth = rng.uniform(-0.1, 1.1, (len(points), 1)) * (FINGER_DEPTH + 0.005)
    turns = np.stack([np.cross(y, -normals), y, -normals], axis=-1)
    return rigid(turns, points + normals * (depth - FINGER_DEPTH))


@lru_cache(maxsize=1024)
def _lines(asset: ObjectAsset, widest: float) -> tuple[Union, PointPairs]:
    """An object's union of parts and its antipodal pairs: by its content alone."""
    union = Union(asset.parts)
    rng = np.random.default_rng(int(object_hash(asset)[:12], 16))
    return union, sample_pairs(union, _NUM_LINES, rng, widest)


class _HandScene:
    """A scene and a hand that can be put anywhere in it.

    Args:
      spec: of `_spec_with_hand`. robot: whose hand it is.
    """

    def __init__(self, spec: mujoco.MjSpec, robot: RobotDescription) -> None:
        self.robot = robot
        self._gripper = gripper_of(robot)
        self._model = model = spec.compile()
        self._data = mujoco.MjData(model)
        self._carriage = model.body(_CARRIAGE).id
        self._hand = model.body(_PREFIX + robot.gripper.body).id
        self._is_hand = bodies_of_tree(model, self._carriage)
        joints = [model.joint(index) for index in range(model.njnt)]
        # In the order of its own model.
        self._fingers = [
            int(joint.qposadr[0]) for joint in joints if joint.name.startswith(_PREFIX)
        ]

    def _put(self, pose: np.ndarray, opening: float) -> None:
        """The tool at T_world_tool f64[4, 4], each pad so many metres from the middle."""
        found = pose_of(pose @ inverse(self._gripper.T_hand_tool))
        self._model.body_pos[self._carriage] = found[:3]
        self._model.body_quat[self._hand] = found[3:]
        self._data.qpos[self._fingers] = self._gripper.joints_of(opening)


class StillScene(_HandScene):
    """A scene that stands still, for looks: what the open hand would touch, and what cameras see.

    Args:
      scene: its objects and what carries them.
      robot: whose hand it is.
    """

    def __init__(self, scene: Scene, robot: RobotDescription) -> None:
        spec = _spec_with_hand(scene, robot, visual=True)
        for joint in [each for each in spec.joints if each.name in scene.names]:
            spec.delete(joint)
        for geom in spec.geoms:
            geom.margin = 0.0
        hand = spec.body(_PREFIX + robot.gripper.body)
        for geom in hand.find_all(mujoco.mjtObj.mjOBJ_GEOM):
            geom.margin = CLEARANCE
        super().__init__(spec, robot)
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[VISUAL_GROUP] = 1

    def blocker(self, pose: np.ndarray, width: float, way: Sequence[float] = BACK) -> str:
        """The body that the open hand touches at T_world_tool f64[4, 4], or on its straight way there.

        Args:
          way: metres before the pose at which it is looked at; (0,) for the pose alone.

        Returns:
          Its name; "" where the hand is free.
        """
        opening = float(self._gripper.opening_of(width))
        for back in way:
            self._put(shift_along(pose, (0.0, 0.0, -back)), opening)
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            bodies = self._model.geom_bodyid[self._data.contact.geom]
            others = bodies[self._is_hand[bodies].sum(1) == 1]
            if len(others):
                first = others[0]
                return str(self._model.body(first[~self._is_hand[first]][0]).name)
        return ""

    def depth(self, camera: Camera) -> np.ndarray:
        """f32[H, W]: metres along the optical axis, without noise; inf where nothing is."""
        self._put(matrix_of(_AWAY), 0.0)
        mujoco.mj_kinematics(self._model, self._data)
        return cast_rays(self._model, self._data, camera, self._groups)[0]


class LiftScene(_HandScene):
    """A scene in which a hand closes and rises by `LIFT`; everything is awake.

    Args:
      scene: its objects and what carries them.
      robot: whose hand it is.
    """

    _ways: tuple[tuple[float, float, float], ...] = _UPWARDS

    def __init__(self, scene: Scene, robot: RobotDescription) -> None:
        super().__init__(_spec_with_hand(scene, robot, visual=False, ways=self._ways), robot)
        # What diverges is to be seen, not begun anew.
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._bodies = [self._model.body(name).id for name in scene.names]
        self._is_object = np.isin(np.arange(self._model.nbody), self._bodies)
        # The carriage's motors were added first.
        self._up = len(self._ways) - 1
        self._grip = len(self._ways)

    def lift(self, pose: np.ndarray, width: float) -> Lift:
        """Closes the hand at T_world_tool f64[4, 4] and lifts what it holds."""
        model = self._model
        data = self._data
        mujoco.mj_resetData(model, data)
        gripper = self._gripper
        opening = float(gripper.opening_of(width))
        self._put(pose, opening)
        come = float(gripper.control_of(opening))
        mujoco.mj_forward(model, data)
        start = data.xpos[self._bodies].copy()
        for step in range(0, round(_CLOSE / TIMESTEP), _AT_ONCE):
            share = min(1.0, step * TIMESTEP / (0.9 * _CLOSE))
            data.ctrl[self._grip] = come + share * (gripper.closed - come)
            mujoco.mj_step(model, data, _AT_ONCE)
        if not np.isfinite(data.qpos).all():
            return Lift(LiftEnd.DIVERGED, -1, 0.0, np.inf)
        if self._is_empty():
            return Lift(LiftEnd.EMPTY, -1, self._gap(), self._largest_shift(start, -1))
        for step in range(0, round((_RISE + _HOLD) / TIMESTEP), _AT_ONCE):
            share = min(1.0, step * TIMESTEP / _RISE)
            data.ctrl[self._up] = LIFT * share**2 * (3 - 2 * share)
            mujoco.mj_step(model, data, _AT_ONCE)
        if not np.isfinite(data.qpos).all():
            return Lift(LiftEnd.DIVERGED, -1, 0.0, np.inf)
        rise = data.xpos[self._bodies, 2] - start[:, 2]
        highest = int(rise.argmax())
        if rise[highest] < RAISED * LIFT or self._is_empty():
            return Lift(LiftEnd.LOST, -1, self._gap(), self._largest_shift(start, -1))
        return Lift(LiftEnd.LIFTED, highest, self._gap(), self._largest_shift(start, highest))

    def poses(self) -> np.ndarray:
        """f64[K, 7]: T_world_object as the last lift left them."""
        data = self._data
        return np.concatenate([data.xpos[self._bodies], data.xquat[self._bodies]], axis=1)

    def _gap(self) -> float:
        return 2 * self._gripper.measure(self._data.qpos[self._fingers])

    def _is_empty(self) -> bool:
        """Whether the fingers nearly meet and touch no object: what is thin is held so, too."""
        bodies = self._model.geom_bodyid[self._data.contact.geom]
        touches = self._is_hand[bodies].any(1) & self._is_object[bodies].any(1)
        return self._gap() < _EMPTY and not touches.any()

    def _largest_shift(self, start: np.ndarray, held: int) -> float:
        shift = np.linalg.norm(self._data.xpos[self._bodies] - start, axis=1)
        return float(
            np.delete(shift, held).max(initial=0.0) if held >= 0 else shift.max(initial=0.0)
        )


class ApproachScene(LiftScene):
    """A scene in which a hand comes as VGN's does (`execute_grasp` of its simulation); everything is awake.

    It starts wide open, 5 cm back, comes straight, stops where it touches anything and closes there; then it
    goes back by 10 cm, upwards where the approach is more than 60 degrees from straight down.
    """

    _ways = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def approach(self, pose: np.ndarray) -> Lift:
        """Comes to T_world_tool f64[4, 4], closes, and goes back.

        An object counts as lifted if the hand touches it in the end and is open by more than a tenth of the
        widest.
        """
        model = self._model
        data = self._data
        mujoco.mj_resetData(model, data)
        gripper = self._gripper
        self._put(shift_along(pose, (0.0, 0.0, -_START)), gripper.max_opening)
        come = float(gripper.control_of(gripper.max_opening))
        data.ctrl[self._grip] = come
        mujoco.mj_forward(model, data)
        start = data.xpos[self._bodies].copy()
        if self._touches(self._is_hand):
            return Lift(LiftEnd.BLOCKED, -1, self._gap(), 0.0)
        way = _START * pose[:3, 2]
        if self._move_to(way, stops=True):
            # It stands where it touched, not where it was on its way to.
            data.ctrl[: self._grip] = data.qpos[self._slides]
        for step in range(0, round(_CLOSE / TIMESTEP), _AT_ONCE):
            share = min(1.0, step * TIMESTEP / (0.9 * _CLOSE))
            data.ctrl[self._grip] = come + share * (gripper.closed - come)
            mujoco.mj_step(model, data, _AT_ONCE)
        is_from_above = -pose[2, 2] >= np.cos(_STEEP)
        back = -_BACK_BY * pose[:3, 2] if is_from_above else np.array([0.0, 0.0, _BACK_BY])
        self._move_to(way + back)
        if not np.isfinite(data.qpos).all():
            return Lift(LiftEnd.DIVERGED, -1, 0.0, np.inf)
        touched = self._touched_objects()
        if not len(touched):
            return Lift(LiftEnd.EMPTY, -1, self._gap(), self._largest_shift(start, -1))
        if self._gap() <= _LEAST_GAP * 2 * gripper.max_opening:
            return Lift(LiftEnd.LOST, -1, self._gap(), self._largest_shift(start, -1))
        rise = data.xpos[self._bodies, 2] - start[:, 2]
        highest = int(touched[rise[touched].argmax()])
        return Lift(LiftEnd.LIFTED, highest, self._gap(), self._largest_shift(start, highest))

    @property
    def _slides(self) -> np.ndarray:
        return np.array([self._model.joint(name).qposadr[0] for name in _slide_names(self._ways)])

    def _move_to(self, place: np.ndarray, stops: bool = False) -> bool:
        """Moves the hand straight to f64[3] from where it started; True if it touched something."""
        data = self._data
        begin = data.ctrl[: self._grip].copy()
        number = max(1, int(np.linalg.norm(place - begin) / _STEP_LENGTH))
        for step in range(number):
            data.ctrl[: self._grip] = begin + (step + 1) / number * (place - begin)
            mujoco.mj_step(self._model, data, round(_STEP_LENGTH / _SPEED / TIMESTEP))
            if stops and self._touches(self._is_hand):
                return True
        return False

    def _touches(self, is_one: np.ndarray) -> bool:
        """Whether bodies bool[nbody] touch any other."""
        contact = self._data.contact
        is_between = is_one[self._model.geom_bodyid[contact.geom]].sum(1) == 1
        return bool((is_between & (contact.dist <= 0)).any())

    def _touched_objects(self) -> np.ndarray:
        """i64[T]: the numbers of the objects that the hand touches."""
        contact = self._data.contact
        bodies = self._model.geom_bodyid[contact.geom]
        is_between = self._is_hand[bodies].any(1) & self._is_object[bodies].any(1)
        found = np.unique(bodies[is_between & (contact.dist <= 0)])
        return np.flatnonzero(np.isin(self._bodies, found))


def _slide_names(ways: Sequence[object]) -> list[str]:
    """Of the carriage's joints and motors."""
    return [_CARRIAGE if not number else f"{_CARRIAGE}{number}" for number in range(len(ways))]


def spec_to_lift(scene: Scene, visual: bool) -> mujoco.MjSpec:
    """A scene, stepped as grasps are lifted in it."""
    spec = populated_spec(
        scene.names,
        scene.objects,
        scene.support,
        TIMESTEP,
        scene.contact,
        poses=scene.poses,
        visual=visual,
    )
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def add_slide(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, axis: tuple[float, float, float]
) -> None:
    """A sliding joint of a body and a position servo for it, both of this name."""
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    motor = spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
    )
    motor.gainprm[0] = _GAIN
    motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    motor.biasprm[:3] = 0.0, -_GAIN, -_DAMPING


def _spec_with_hand(
    scene: Scene,
    robot: RobotDescription,
    visual: bool,
    ways: Sequence[tuple[float, float, float]] = _UPWARDS,
) -> mujoco.MjSpec:
    """A scene and a hand, at 100 m, that can move along some ways."""
    spec = spec_to_lift(scene, visual)
    hand = hand_spec(scene.contact, robot)
    remove_drawings(hand)
    spec.option.impratio = IMPRATIO
    copy_options(spec, hand)
    carriage = spec.worldbody.add_body(name=_CARRIAGE, pos=_AWAY[:3])
    for name, axis in zip(_slide_names(ways), ways, strict=True):
        add_slide(spec, carriage, name, axis)
    spec.attach(hand, prefix=_PREFIX, frame=carriage.add_frame())
    return spec
