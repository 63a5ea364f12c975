"""One strict rule for anybody's scene: what overlaps and floats at the start, what moves and falls later.

Simulated from rest, everything awake, with the file's own options; nothing is repaired.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.config import Detector, check_positive
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.measures.simulate import horizons_of, shift_and_turn
from cluttergen_jax.geometry import rotate
from cluttergen_jax.physics.margin import MIN_LIFT
from cluttergen_jax.physics.simulations import disabled_flags
from cluttergen_jax.progress import stop_asked

GAP = 0.001
"""Metres between two bodies up to which they count as touching, when it is asked what floats."""
AT_ONCE = 0.05
"""Seconds within which what has nothing below and sinks by more than `GAP` floats: free fall is 12 mm."""
FALL = 0.05
"""Metres below its start from which a body has fallen."""
_LOOK = 0.01
"""Seconds between two looks."""
_MAX_STEPS = 1_200_000
"""Of one simulation: a minute in steps of 0.05 ms."""
_PULLED = {
    int(mujoco.mjtTrn.mjTRN_JOINT): "jnt_bodyid",
    int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): "jnt_bodyid",
    int(mujoco.mjtTrn.mjTRN_SITE): "site_bodyid",
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "site_bodyid",
}
_FREE = mujoco.mjtJoint.mjJNT_FREE
_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


@dataclass(frozen=True)
class JudgeConfig:
    """What the judge asks; see `cluttergen_jax.judge`."""

    seconds: tuple[float, ...] = (1.0, 10.0, 60.0)
    max_shift: float = 0.005
    max_turn_deg: float = 5.0
    max_penetration: float = 0.001
    hold_joints: bool = False

    def __post_init__(self) -> None:
        check_positive(self, "max_shift", "max_turn_deg", "max_penetration")
        horizons_of(self.seconds)

    def check_steps(self, model: mujoco.MjModel) -> None:
        """Refuses a model that cannot be stepped, or would take forever (ConfigError)."""
        step, last = model.opt.timestep, self.seconds[-1]
        if not (step > 0 and last / step <= _MAX_STEPS):
            given, allowed = f"a time step of {step:g} s over {last:g} s", f"{_MAX_STEPS:,} steps at most"
            raise ConfigError(given, allowed, f"seconds={self.seconds[0]:g}")


@dataclass(frozen=True, eq=False)
class FreeBodies:
    """The bodies of a model that are judged: those that hang on the world by one free joint.

    Attributes:
      ids: i[B], of the bodies; names: of each.
      left_out: why other bodies with a free joint are not judged.
    """

    ids: np.ndarray
    names: tuple[str, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Judgement:
    """One start of a scene, simulated with one detector. B judged bodies, H horizons.

    Attributes:
      names: of the bodies.
      shift, turn: f64[H, B], the farthest that each was from its start up to each horizon, metres and
        radians; infinite where the simulation diverged or stopped.
      penetration: f64[B], metres, the deepest overlap at the start; against: with what, "" if with nothing.
      floats: bool[B]: at the start no chain of bodies at most 1 mm apart leads to anything that is not
        judged; or nothing within 1 mm presses it upwards, and it sinks by more than 1 mm within 0.05 s.
      falls: bool[B]: at the last horizon it is more than 5 cm below its start.
      is_still: bool[H, B], it is within the limits; is_deep: bool[B], it overlaps by more than is allowed.
      begin, end: f64[nq], the positions before and after.
      note: what went wrong in the simulation, "" if nothing did.
    """

    names: tuple[str, ...]
    shift: np.ndarray
    turn: np.ndarray
    penetration: np.ndarray
    against: tuple[str, ...]
    floats: np.ndarray
    falls: np.ndarray
    is_still: np.ndarray
    is_deep: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    note: str


def find_free_bodies(model: mujoco.MjModel) -> FreeBodies:
    """The bodies of a model that are judged.

    Left out are those with other joints or an actuator: robots, and objects that bend; and those that collide
    with nothing: markers.
    """
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    targets = zip(model.actuator_trntype.tolist(), model.actuator_trnid[:, 0].tolist(), strict=True)
    pulled = [int(getattr(model, _PULLED[kind])[target]) for kind, target in targets if kind in _PULLED]
    pulled += model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY, 0].tolist()
    is_driven = np.isin(np.arange(model.nbody), model.body_rootid[pulled])
    joints = np.bincount(model.body_rootid[model.jnt_bodyid], minlength=model.nbody)
    kept, left_out = [], []
    for body in model.jnt_bodyid[model.jnt_type == _FREE].tolist():
        if joints[body] > 1 or is_driven[body]:
            left_out.append("they have other joints or an actuator")
        elif not collides[model.body_rootid[model.geom_bodyid] == body].any():
            left_out.append("they collide with nothing")
        else:
            kept.append(body)
    names = tuple(model.body(body).name or f"body-{body}" for body in kept)
    return FreeBodies(np.array(kept, int), names, tuple(left_out))


def judge_start(
    model: mujoco.MjModel, start: mujoco.MjData, detector: Detector, bodies: FreeBodies, config: JudgeConfig
) -> Judgement:
    """Judges one start with one of MuJoCo's detectors of convex collisions.

    Args:
      model, start: read alone; velocities count as zero.
    """
    model, data = copy.copy(model), copy.copy(start)
    model.opt.disableflags = disabled_flags(model, detector)
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    # A diverging scene must be seen, not put back to where it started.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data.qvel[:] = 0
    number, note = len(bodies.ids), ""
    depth, against, floats, falls = (
        np.zeros(number),
        ("",) * number,
        np.zeros(number, bool),
        np.zeros(number, bool),
    )
    shift, turn = np.full((2, len(config.seconds), number), np.inf)
    try:
        mujoco.mj_forward(model, data)
        depth, against = _overlaps(model, data, bodies)
        is_chained, is_lifted = _carried(model, data, bodies)
        motion = _Motion(model, data, bodies, config.hold_joints)
        shift, turn = motion.run(config.seconds)
        floats = ~is_chained | (~is_lifted & (motion.sunk > GAP))
        falls, note = motion.sinking() > FALL, motion.note
        if not note and data.warning.number[_FULL].any():
            note = "MuJoCo had no room for all contacts"
    except mujoco.FatalError as error:
        note = " ".join(str(error).split())
    return Judgement(
        names=bodies.names,
        shift=shift,
        turn=turn,
        penetration=depth,
        against=against,
        floats=floats,
        falls=falls,
        is_still=(shift <= config.max_shift) & (turn <= np.radians(config.max_turn_deg)),
        is_deep=depth > config.max_penetration,
        begin=start.qpos.copy(),
        end=data.qpos.copy(),
        note=note,
    )


def _down(model: mujoco.MjModel) -> np.ndarray:
    """f64[3]: along gravity, of unit length; zero where there is none."""
    return model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)


def _pairs(model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies) -> tuple[np.ndarray, ...]:
    """Of the contacts between two bodies: who touches whom, how near, and how far upwards.

    Returns:
      i[C, 2], the judged bodies on both sides, -1 for others; f64[C], metres between them; f64[C], the sine
      of the angle at which the first side presses the second upwards.
    """
    place = np.full(model.nbody, -1)
    place[bodies.ids] = np.arange(len(bodies.ids))
    geoms = data.contact.geom
    # A side of a contact with something soft is no geom.
    owner = np.where(geoms < 0, -1, place[model.body_rootid[model.geom_bodyid[geoms]]])
    is_other = (owner[:, 0] != owner[:, 1]) & (owner >= 0).any(1)
    return owner[is_other], data.contact.dist[is_other], -data.contact.frame[is_other, :3] @ _down(model)


def _overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies
) -> tuple[np.ndarray, tuple[str, ...]]:
    """f64[B], metres, the deepest overlap of each body with another, and with what."""
    deepest, against = np.zeros(len(bodies.ids)), [""] * len(bodies.ids)
    owner, distance, _ = _pairs(model, data, bodies)
    for pair, depth in zip(owner.tolist(), -distance, strict=True):
        for own, other in (pair, pair[::-1]):
            if own >= 0 and depth > deepest[own]:
                deepest[own], against[own] = (
                    depth,
                    bodies.names[other] if other >= 0 else "what is not judged",
                )
    return deepest, tuple(against)


def _carried(model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies) -> tuple[np.ndarray, np.ndarray]:
    """bool[B] each: a chain of bodies that touch leads to what is not judged; something lies below."""
    margins = model.geom_margin.copy()
    model.geom_margin[:] = np.maximum(margins, GAP)
    mujoco.mj_collision(model, data)
    owner, distance, lift = _pairs(model, data, bodies)
    model.geom_margin[:] = margins
    owner, lift = owner[distance <= GAP], lift[distance <= GAP]
    # The last entry is all that is not judged, which -1 means as well.
    chained, lifted = np.zeros((2, len(bodies.ids) + 1), bool)
    chained[-1] = True
    while (reached := chained[owner].any(1)[:, None] & ~chained[owner]).any():
        chained[owner[reached]] = True
    lifted[owner[lift >= MIN_LIFT, 1]] = lifted[owner[lift <= -MIN_LIFT, 0]] = True
    return chained[:-1], lifted[:-1]


class _Motion:
    """The simulation of one start.

    Attributes:
      sunk: f64[B], metres by which each body had sunk 0.05 s after the start.
      note: what went wrong, "" if nothing did.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies, holds: bool) -> None:
        self._model, self._data, self.note = model, data, ""
        self._address = model.jnt_qposadr[model.body_jntadr[bodies.ids]]
        axes = data.xmat[bodies.ids].reshape(-1, 3, 3)
        self._center = np.einsum("bji,bj->bi", axes, data.subtree_com[bodies.ids] - data.xpos[bodies.ids])
        self._start, self._qpos, self.sunk = self.poses(), data.qpos.copy(), np.zeros(len(bodies.ids))
        # Positions and velocities of joints that are held.
        self._is_held, self._is_stopped = np.full(model.nq, holds), np.full(model.nv, holds)
        for joint in np.flatnonzero(model.jnt_type == _FREE):
            self._is_held[model.jnt_qposadr[joint] + np.arange(7)] = False
            self._is_stopped[model.jnt_dofadr[joint] + np.arange(6)] = False

    def poses(self) -> np.ndarray:
        """f64[B, 7]: where each body's centre of mass is, and its orientation."""
        pose = self._data.qpos[self._address[:, None] + np.arange(7)]
        with np.errstate(invalid="ignore"):
            pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
            pose[:, :3] += rotate(np, pose[:, 3:], self._center)
        return pose

    def sinking(self) -> np.ndarray:
        """f64[B], metres by which each body has sunk along gravity since the start; 0 where it diverged."""
        return np.nan_to_num((self.poses()[:, :3] - self._start[:, :3]) @ _down(self._model))

    def run(self, seconds: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """f64[H, B] metres and radians: the farthest up to each horizon, infinite where it diverged."""
        farthest, reached = np.zeros((2, len(self._start))), []
        step, done = self._model.opt.timestep, 0
        stride, at_once = max(round(_LOOK / step), 1), round(AT_ONCE / step)
        for until in (round(each / step) for each in seconds):
            while done < until and not self.note:
                if stop_asked.is_set():
                    raise KeyboardInterrupt
                number = min(stride, until - done, at_once - done if done < at_once else stride)
                self._advance(number)
                done += number
                farthest = np.maximum(farthest, shift_and_turn(self.poses(), self._start))
                if done == at_once:
                    self.sunk = self.sinking()
            # Where it diverges nothing is known of anything any more.
            reached.append(np.full_like(farthest, np.inf) if self.note else farthest)
        shift, turn = np.stack(reached, axis=1)
        return shift, turn

    def _advance(self, number: int) -> None:
        model, data = self._model, self._data
        is_any_held = self._is_held.any()
        for _ in range(number if is_any_held else 1):
            mujoco.mj_step(model, data, 1 if is_any_held else number)
            data.qpos[self._is_held], data.qvel[self._is_stopped] = self._qpos[self._is_held], 0.0
        if not np.isfinite(data.qpos).all():
            self.note = f"it diverged before {data.time:.2f} s"
