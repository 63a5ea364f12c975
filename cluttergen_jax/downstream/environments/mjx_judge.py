"""The judge of `tasks`, in JAX: how an episode of grasping or placing ends, asked after each step of control.

It reads poses of objects and contact sensors of the hand, which C MuJoCo and both engines of MJX fill in the
same way. The two seconds for which a placed object is watched are steps of control here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple, Self

import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from cluttergen_jax.assets import Box, SupportAsset
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.downstream.environments.world import RobotWorld
from cluttergen_jax.downstream.episodes.progress import LIFTED
from cluttergen_jax.downstream.episodes.referee import WATCH_STEP, WATCHED
from cluttergen_jax.downstream.episodes.tasks import FALLEN, LEFT
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.geometry import Array, yaw_matrix
from cluttergen_jax.physics import displacement, has_moved


class EpisodeEnd(IntEnum):
    """How an episode ended, as a number; `text` is the Gymnasium environment's word, "" before the end."""

    NONE = 0
    SUCCESS = 1
    CONTACT = 2
    DISPLACED = 3
    UNSTABLE = 4
    OUTSIDE = 5
    TIME_LIMIT = 6

    @property
    def text(self) -> str:
        """The word."""
        if self in (EpisodeEnd.NONE, EpisodeEnd.TIME_LIMIT):
            return "" if self == EpisodeEnd.NONE else "time limit"
        return str(Outcome[self.name])


# Of a contact sensor of MuJoCo: whether contacts were found, and the force of the strongest.
_FOUND_AND_FORCE = 0b11
_BY_MAX_FORCE = 2
_NUM_VALUES = 4


@dataclass(frozen=True, eq=False)
class HandSensors:
    """Contact sensors of the hand in a model: with each of K objects, and with all else that does not move.

    Attributes:
      address: i[S], where the four values of each sensor begin in `sensordata`.
      other: i[S], what the hand touches: 0 to K - 1 for objects, K for all else.
      num_objects: K.
    """

    address: np.ndarray
    other: np.ndarray
    num_objects: int

    @classmethod
    def added_to(cls, world: RobotWorld, by_geom: bool) -> tuple[RobotWorld, Self]:
        """A world with the sensors, compiled anew.

        Args:
          by_geom: a sensor for each pair of shapes, which is what MJX in pure JAX knows; else one for each
            pair of bodies.
        """
        spec = world.spec
        number = {int(body): k for k, body in enumerate(world.bodies)}
        names: list[str] = []
        others: list[int] = []
        for hand, touched, body in _pairs(world, by_geom):
            names.append(f"hand-contact-{len(names)}")
            others.append(number.get(body, len(number)))
            spec.add_sensor(
                name=names[-1],
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=hand.kind,
                objname=hand.name,
                reftype=touched.kind,
                refname=touched.name,
                intprm=(_FOUND_AND_FORCE, _BY_MAX_FORCE, 1),
            )
        model = spec.compile()
        address = np.array([model.sensor(name).adr[0] for name in names])
        return replace(world, model=model), cls(address, np.array(others), len(number))

    def read(self, sensordata: Array) -> tuple[Array, Array]:
        """What the hand touches, bool[K + 1], and the strongest contact with it, f32[K + 1], newtons."""
        values = sensordata[self.address[:, None] + np.arange(_NUM_VALUES)]
        size = self.num_objects + 1
        force = jnp.linalg.norm(values[:, 1:], axis=-1)
        found = jnp.zeros(size, bool).at[self.other].max(values[:, 0] > 0)
        return found, jnp.zeros(size).at[self.other].max(jnp.where(values[:, 0] > 0, force, 0.0))


class _Part(NamedTuple):
    """A body with all that hangs on it, a body, or a shape, by its name."""

    kind: mujoco.mjtObj
    name: str


def _pairs(world: RobotWorld, by_geom: bool) -> Iterator[tuple[_Part, _Part, int]]:
    """What the hand's sensors are between, and the body that is touched.

    In physics for learning no other link of the arm touches anything.
    """
    model = world.model
    robot = world.description
    is_solid = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    is_hand = is_solid & world.robot.is_hand[model.geom_bodyid]
    is_other = is_solid & ~world.robot.is_arm[model.geom_bodyid]
    shapes = {}
    for geom in world.spec.geoms:
        if is_solid[geom.id]:
            geom.name = geom.name or f"collider-{geom.id}"
            shapes[geom.id] = _Part(mujoco.mjtObj.mjOBJ_GEOM, geom.name)
    hand = _Part(mujoco.mjtObj.mjOBJ_XBODY, robot.prefix + robot.of_gripper(robot.gripper.body))
    hands = [shapes[geom] for geom in np.flatnonzero(is_hand)] if by_geom else [hand]
    for body in np.unique(model.geom_bodyid[is_other]).tolist():
        geoms = np.flatnonzero(is_other & (model.geom_bodyid == body))
        # The world's own shapes are asked for one by one: as a body it has everything in it.
        touched = [shapes[geom] for geom in geoms]
        if body and not by_geom:
            touched = [_Part(mujoco.mjtObj.mjOBJ_BODY, model.body(body).name)]
        yield from ((mine, part, body) for mine in hands for part in touched)


class Seen(struct.PyTreeNode):
    """What the judge sees after a step of control. K objects.

    Attributes:
      poses: f32[K, 7], T_world_object, unit quaternions wxyz. tool: f32[3], metres, world frame.
      is_touching: bool, the hand touched the target in the last step of the simulation.
      is_closing: bool, the gripper is asked to close on something.
      is_pressing: bool, in some step an unplanned contact pressed harder than `execute.MAX_FORCE`.
      is_finite: bool, the simulation has not diverged.
    """

    poses: Array
    tool: Array
    is_touching: Array
    is_closing: Array
    is_pressing: Array
    is_finite: Array


class Start(struct.PyTreeNode):
    """How an episode began.

    Attributes:
      poses: f32[K, 7], T_world_object. is_present: bool[K], the objects that belong to it.
      target: i32, the one that is to be moved.
    """

    poses: Array
    is_present: Array
    target: Array


class JudgeMemory(struct.PyTreeNode):
    """What the judge remembers of an episode.

    Attributes:
      num_steps: i32, steps of control so far.
      has_touched: bool, the hand touched the target; touched: f32[3], where the tool was then.
      watched: i32, steps of control since the object was let go, -1 before that.
      let_go: f32[7], its pose then.
    """

    num_steps: Array
    has_touched: Array
    touched: Array
    watched: Array
    let_go: Array

    @classmethod
    def new(cls) -> Self:
        """Of an episode that begins."""
        return cls(
            num_steps=jnp.zeros((), jnp.int32),
            has_touched=jnp.zeros((), bool),
            touched=jnp.zeros(3),
            watched=jnp.full((), -1, jnp.int32),
            let_go=jnp.zeros(7),
        )

    @property
    def is_watching(self) -> Array:
        """bool: the object was let go, and is watched."""
        return self.watched >= 0


@dataclass(frozen=True, eq=False)
class MjxJudge:
    """Judges episodes of one task, "grasp" or "place", by the rules of `tasks`.

    Args:
      task: its name.
      support: with the region; period: seconds of a step of control.
      max_steps: steps of control that an episode may take until it succeeds, or until the object was let go.
    """

    task: str
    support: SupportAsset
    period: float
    max_steps: int

    @property
    def watch_steps(self) -> int:
        """Steps of control for which an object that was let go is watched; 0 where nothing is let go."""
        return round(WATCHED / self.period) if self.task == "place" else 0

    def judge(self, start: Start, memory: JudgeMemory, seen: Seen) -> tuple[JudgeMemory, Array]:
        """The memory after a step of control, and i32, an `EpisodeEnd`."""
        memory = memory.replace(num_steps=memory.num_steps + 1)
        steps = self._place if self.task == "place" else self._grasp
        memory, ending = steps(start, memory, seen)
        ending = jnp.where(seen.is_pressing, EpisodeEnd.CONTACT, ending)
        ending = jnp.where(seen.is_finite, ending, EpisodeEnd.UNSTABLE)
        is_late = ~memory.is_watching & (memory.num_steps >= self.max_steps)
        ending = jnp.where((ending == EpisodeEnd.NONE) & is_late, EpisodeEnd.TIME_LIMIT, ending)
        return memory, ending.astype(jnp.int32)

    def _grasp(self, start: Start, memory: JudgeMemory, seen: Seen) -> tuple[JudgeMemory, Array]:
        height = seen.poses[start.target, 2] - start.poses[start.target, 2]
        is_lifted = (height >= LIFTED) & seen.is_touching
        is_moved = moved_others(start, seen.poses)[0]
        ending = jnp.where(is_moved, EpisodeEnd.DISPLACED, EpisodeEnd.SUCCESS)
        ending = jnp.where(is_lifted, ending, EpisodeEnd.NONE)
        return memory, jnp.where(self._has_fallen(start, seen), EpisodeEnd.OUTSIDE, ending)

    def _place(self, start: Start, memory: JudgeMemory, seen: Seen) -> tuple[JudgeMemory, Array]:
        pose = seen.poses[start.target]
        is_moved = moved_others(start, seen.poses)[0]
        was_watching = memory.is_watching
        has_touched = memory.has_touched | seen.is_touching
        touched = jnp.where(seen.is_touching, seen.tool, memory.touched)
        has_left = has_touched & ~seen.is_touching & ~seen.is_closing
        has_left &= jnp.linalg.norm(seen.tool - touched) > LEFT
        is_let_go = has_left & ~is_over(stand_beside(self.support), pose) & ~was_watching
        before = jnp.where(is_let_go & is_moved, EpisodeEnd.DISPLACED, EpisodeEnd.NONE)
        before = jnp.where(self._has_fallen(start, seen), EpisodeEnd.OUTSIDE, before)
        watched = jnp.where(was_watching, memory.watched + 1, jnp.where(is_let_go, 0, -1))
        after = self._after_watching(memory.replace(watched=watched), pose, is_moved)
        memory = memory.replace(
            has_touched=has_touched,
            touched=touched,
            watched=watched,
            let_go=jnp.where(was_watching, memory.let_go, pose),
        )
        return memory, jnp.where(was_watching, after, before)

    def _after_watching(self, memory: JudgeMemory, pose: Array, is_moved: Array) -> Array:
        """The ending of an object that was let go."""
        every = max(1, round(WATCH_STEP / self.period))
        shift, turn = displacement(jnp, pose, memory.let_go)
        ending = jnp.where(is_moved, EpisodeEnd.DISPLACED, EpisodeEnd.NONE)
        ending = jnp.where(has_moved(shift, turn, StabilityConfig()), EpisodeEnd.UNSTABLE, ending)
        ending = jnp.where(memory.watched % every == 0, ending, EpisodeEnd.NONE)
        is_over_yet = (ending == EpisodeEnd.NONE) & (memory.watched >= self.watch_steps)
        end = jnp.where(
            distance_to_region(self.support, pose) > 0, EpisodeEnd.OUTSIDE, EpisodeEnd.SUCCESS
        )
        return jnp.where(is_over_yet, end, ending)

    def _has_fallen(self, start: Start, seen: Seen) -> Array:
        low = seen.poses[:, 2] < self.support.lowest - FALLEN
        return (low & start.is_present).any()


def moved_others(start: Start, poses: Array) -> tuple[Array, Array]:
    """bool: another object moved by more than `StabilityConfig` allows of neighbours; f32: metres at most."""
    limits = StabilityConfig()
    shift, turn = displacement(jnp, poses, start.poses)
    is_other = start.is_present & (jnp.arange(len(poses)) != start.target)
    is_far = (shift > limits.max_shift) | (turn > limits.max_turn)
    return (is_far & is_other).any(), jnp.where(is_other, shift, 0.0).max()


def distance_to_region(support: SupportAsset, pose: Array) -> Array:
    """f32: metres in plan from an object's middle, f32[7], to the support's region; 0 within."""
    region = support.region
    return _outside(region.center, region.half_extents, region.yaw, pose)


def is_over(box: Box, pose: Array) -> Array:
    """bool: an object's middle, f32[7], is within a box in plan."""
    return _outside(box.center[:2], box.half_extents[:2], box.yaw, pose) == 0


def _outside(center: Sequence[float], half: Sequence[float], yaw: float, pose: Array) -> Array:
    """f32: metres in plan from a pose to a rectangle."""
    place = (pose[:2] - jnp.asarray(center)) @ jnp.asarray(yaw_matrix(-yaw)[:2, :2].T, jnp.float32)
    return jnp.linalg.norm(jnp.maximum(jnp.abs(place) - jnp.asarray(half), 0.0))


def is_closing(robot: RobotDescription, control: Array) -> Array:
    """bool: a control closes the gripper on whatever is between its pads (`Gripper.is_closing`)."""
    gripper = gripper_of(robot)
    return (control - gripper.control[0]) * (gripper.closed - gripper.control[0]) > 0
