"""A robot and objects, simulated: set-points of servos go in, and what the arm touches is watched."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import mujoco
import numpy as np

from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome
from cluttergen_jax.downstream.episodes.robot_parts import Gripper, RobotParts
from cluttergen_jax.downstream.transforms import matrix_of

MAX_FORCE = 2.0
"""N; an unplanned contact that presses harder ends an episode."""
_MEASURED = 16
_WARNING = mujoco.mjtWarning
_DIVERGED = (_WARNING.mjWARN_BADQPOS, _WARNING.mjWARN_BADQVEL, _WARNING.mjWARN_BADQACC)


class Kind(IntEnum):
    """What a geom belongs to; the last two are columns (`columns.OccupancyBoxes`)."""

    GROUND = 0
    OTHER = 1
    TARGET = 2
    ARM = 3
    HAND = 4
    HELD = 5
    SEEN = 6
    HIDDEN = 7


def kinds_of(arm: RobotParts, bodies: Sequence[int], target: int) -> np.ndarray:
    """i[nbody]: the kind of each body; bodies: of the objects; target: of the one that is moved."""
    kind = np.full(len(arm.is_arm), Kind.GROUND)
    kind[bodies] = Kind.OTHER
    kind[target] = Kind.TARGET
    kind[arm.is_arm] = Kind.ARM
    kind[arm.is_hand] = Kind.HAND
    return kind


class Phase(IntEnum):
    """Which contacts are planned, besides those among objects and with what they stand on.

    FREE: none of the arm. GRASP: the hand may touch the target. CARRY: so it may, and the target touches
    nothing else. TOUCH: as GRASP, the target may touch what it stands on or will.
    """

    FREE = 0
    GRASP = 1
    CARRY = 2
    TOUCH = 3


def _unplanned_contacts() -> np.ndarray:
    """bool[phases, kinds, kinds]."""
    table = np.zeros((len(Phase), len(Kind), len(Kind)), bool)
    table[:, [Kind.ARM, Kind.HAND], :] = True
    table[:, :, [Kind.ARM, Kind.HAND]] = True
    # Fingers meet where an object is lost, which is told otherwise.
    table[:, Kind.HAND, Kind.HAND] = False
    for phase in (Phase.GRASP, Phase.CARRY, Phase.TOUCH):
        table[phase, Kind.HAND, Kind.TARGET] = table[phase, Kind.TARGET, Kind.HAND] = False
    for other in (Kind.GROUND, Kind.OTHER):
        table[Phase.CARRY, Kind.TARGET, other] = table[Phase.CARRY, other, Kind.TARGET] = True
    return table


_UNPLANNED = _unplanned_contacts()
TOUCHING = _UNPLANNED[Phase.CARRY] & ~_UNPLANNED[Phase.TOUCH]
"""bool[kinds, kinds]: what is held and what it may be put on."""


class Simulation:
    """A compiled model of a robot and objects, simulated; where it begins is the business of subclasses.

    Args:
      model, arm: the model and where the robot is in it; gripper: how that moves.
      names: of the scene's objects, as their bodies are called.
      target: the number of the one that the hand may touch at first.

    Attributes:
      step_time: seconds of a step. num_steps: so far. travel: metres that the tool has moved.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        arm: RobotParts,
        gripper: Gripper,
        names: Sequence[str],
        target: int,
    ) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self.arm = arm
        self.gripper = gripper
        self.step_time = float(model.opt.timestep)
        self._bodies = [model.body(name).id for name in names]
        self.aim_at(target)
        self.num_steps = 0
        self.travel = 0.0

    def put_home(
        self, names: Sequence[str], poses: np.ndarray, home: Sequence[float] | np.ndarray
    ) -> None:
        """Puts objects at poses f64[N, 7] and the arm at joints f64[n], its hand open."""
        for name, pose in zip(names, poses, strict=True):
            first = int(self.model.joint(name).qposadr[0])
            self.data.qpos[first : first + 7] = pose
        self.data.qpos[self.arm.qpos] = self.data.ctrl[self.arm.ctrl] = home
        widest = self.gripper.max_opening
        self.data.qpos[self.arm.fingers] = self.gripper.joints_of(widest)
        self.data.ctrl[self.arm.grip] = self.gripper.control_of(widest)
        mujoco.mj_forward(self.model, self.data)
        self._last_tool = self.data.site_xpos[self.arm.site].copy()

    def wake(self) -> None:
        """From now on nothing sleeps."""
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)

    def aim_at(self, target: int) -> None:
        """From now on this object is the one that the hand may touch."""
        kind = kinds_of(self.arm, self._bodies, self._bodies[target])
        self._kind = kind[self.model.geom_bodyid]
        self._target = target

    @property
    def joints(self) -> np.ndarray:
        """f64[n]: where the arm is."""
        return self.data.qpos[self.arm.qpos].copy()

    @property
    def set_point(self) -> np.ndarray:
        """f64[n]: where the arm's servos want it, as long as it rests."""
        return self.data.ctrl[self.arm.ctrl].copy()

    @property
    def tool(self) -> np.ndarray:
        """f64[4, 4]: T_world_tool."""
        mujoco.mj_kinematics(self.model, self.data)
        return self.arm.tool(self.data)

    @property
    def opening(self) -> float:
        """Metres that each pad is from the middle."""
        return self.gripper.measure(self.data.qpos[self.arm.fingers])

    @property
    def is_closed(self) -> bool:
        """The fingers are told to close on something."""
        return self.gripper.is_closing(float(self.data.ctrl[self.arm.grip]))

    def poses(self) -> np.ndarray:
        """f64[N, 7]: T_world_object of the scene's objects."""
        mujoco.mj_kinematics(self.model, self.data)
        return np.concatenate([self.data.xpos[self._bodies], self.data.xquat[self._bodies]], axis=1)

    def pose(self, number: int) -> np.ndarray:
        """f64[4, 4]: T_world_object of one."""
        return matrix_of(self.poses()[number])

    def wait(self, seconds: float, phase: Phase) -> None:
        """Lets time pass, the set-points as they are."""
        for _ in range(round(seconds / self.step_time)):
            self._step(phase)

    def _step(self, phase: Phase) -> None:
        mujoco.mj_step(self.model, self.data)
        self.num_steps += 1
        self._keep()
        if self.num_steps % _MEASURED == 0:
            now = self.data.site_xpos[self.arm.site].copy()
            self.travel += float(np.linalg.norm(now - self._last_tool))
            self._last_tool = now
            self._check_diverged()
        self._watch(phase)

    def _keep(self) -> None:
        """Called after each step, before it is judged."""

    def _check_diverged(self) -> None:
        # MuJoCo has begun anew by then, with the arm somewhere.
        if any(self.data.warning[kind].number for kind in _DIVERGED):
            raise Failed(Outcome.UNSTABLE, "the simulation diverged")

    def _watch(self, phase: Phase) -> None:
        contact = self._pressing(_UNPLANNED[phase])
        if contact is not None:
            self._check_diverged()
            bodies = self.model.geom_bodyid[self.data.contact.geom[contact]]
            a, b = (self.model.body(body).name or "ground" for body in bodies)
            raise Failed(Outcome.CONTACT, f"{a} and {b}, {phase.name.lower()}")

    def _pressing(self, asked: np.ndarray) -> int | None:
        """The first contact of kinds bool[kinds, kinds] that presses harder than `MAX_FORCE`."""
        data = self.data
        if not data.ncon:
            return None
        kinds = self._kind[data.contact.geom]
        force = np.zeros(6)
        for contact in np.flatnonzero(asked[kinds[:, 0], kinds[:, 1]]):
            mujoco.mj_contactForce(self.model, data, int(contact), force)
            if np.linalg.norm(force[:3]) > MAX_FORCE:
                return int(contact)
        return None
