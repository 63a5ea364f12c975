"""Judges anybody's scenes by one strict rule: what overlaps and floats at the start, moves and falls later.

Simulated from rest, everything awake, with the file's own options; nothing is repaired. Rows, a table and a
picture of the worst tell what was found.
"""

from __future__ import annotations

import copy
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.sense import SceneSense
from cluttergen_jax.config import DETECTORS, Detector, StabilityConfig, VerifyConfig, check_positive
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError
from cluttergen_jax.files import file_whole
from cluttergen_jax.geometry import rotate
from cluttergen_jax.importing.readers.mjcf import Geom
from cluttergen_jax.importing.readers.model import convex_parts
from cluttergen_jax.judging.scene_files import find_scenes, read_model, read_starts
from cluttergen_jax.judging.sense import GAP, SenseFindings, find_sense, kind_of_name
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.margin import MIN_LIFT
from cluttergen_jax.physics.standing import has_moved, horizons_of, keep_awake, watch
from cluttergen_jax.progress import Progress, stop_asked
from cluttergen_jax.rendering.camera import drawn_points
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.rendering.picture import contact_sheet, render_model, save_png
from cluttergen_jax.rendering.renderer import HIDDEN_GROUP
from cluttergen_jax.tables import aligned_table

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
_MOST_NAMES = 5
_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]


@dataclass(frozen=True)
class JudgeConfig:
    """What the judge asks; see `cluttergen_jax.judge`."""

    seconds: tuple[float, ...] = (1.0, 10.0, 60.0)
    max_shift: float = VerifyConfig.max_shift
    max_turn_deg: float = VerifyConfig.max_turn_deg
    max_penetration: float = 0.001
    hold_joints: bool = False
    sense: SceneSense | None = None

    def __post_init__(self) -> None:
        check_positive(self, "max_shift", "max_turn_deg", "max_penetration")
        horizons_of(self.seconds)

    @property
    def limits(self) -> StabilityConfig:
        """What counts as still, as `physics.standing` takes it."""
        return StabilityConfig.standing_within(self.max_shift, self.max_turn_deg)

    def check_steps(self, model: mujoco.MjModel) -> None:
        """Refuses a model that cannot be stepped, or would take forever (ConfigError)."""
        step = model.opt.timestep
        last = self.seconds[-1]
        if not (step > 0 and last / step <= _MAX_STEPS):
            given = f"a time step of {step:g} s over {last:g} s"
            allowed = f"{_MAX_STEPS:,} steps at most"
            raise ConfigError(given, allowed, f"seconds={self.seconds[0]:g}")


@dataclass(frozen=True, eq=False)
class FreeBodies:
    """The bodies of a model that are judged: those with a free joint, with all that hangs on them.

    Attributes:
      ids: i[B], of the bodies; names: of each.
      left_out: why other bodies with a free joint are not judged.
      is_shape: bool[ngeom], the geoms by which overlaps are measured (`collision_shapes`).
      notes: what was decided about these.
    """

    ids: np.ndarray
    names: tuple[str, ...]
    left_out: tuple[str, ...]
    is_shape: np.ndarray
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Judgement:
    """One start of a scene, simulated with one detector. B judged bodies, H horizons.

    Attributes:
      names: of the bodies.
      shift, turn: f64[H, B], the farthest that each was from its start up to each horizon, metres and
        radians; of a body with joints the farthest of its links; infinite where the simulation diverged or
        stopped.
      is_still: bool[H, B], it is within the limits.
      penetration: f64[B], metres, the deepest overlap at the start, whether or not contacts are filtered;
        against: with what, "" if with nothing.
      is_deep, floats, falls: bool[B], see `FAULTS`.
      begin, end: f64[nq], the positions before and after.
      note: what went wrong in the simulation, "" if nothing did.
      sense: what a table of sense says of the start, where that was asked.
    """

    names: tuple[str, ...]
    shift: np.ndarray
    turn: np.ndarray
    is_still: np.ndarray
    penetration: np.ndarray
    against: tuple[str, ...]
    is_deep: np.ndarray
    floats: np.ndarray
    falls: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    note: str
    sense: SenseFindings | None = None


class Fault(NamedTuple):
    """A verdict on a body besides its motion.

    Attributes:
      column: its name in rows, and that of its flags in `Judgement`; title: in tables.
      meaning: what it means, in words, with these settings.
      describe: what is said of a start in which some body has it.
    """

    column: str
    title: str
    meaning: Callable[[JudgeConfig], str]
    describe: Callable[[Judgement], str]


def _describe_overlap(found: Judgement) -> str:
    deep = int(found.penetration.argmax())
    depth = length_in_mm(found.penetration[deep])
    return f"{found.names[deep]} is {depth} deep in {found.against[deep]}"


def _describe_bodies(found: Judgement, column: str) -> str:
    """The first body with a fault that is a verb, and how many more there are."""
    flags = getattr(found, column)
    more = f" and {flags.sum() - 1} more" if flags.sum() > 1 else ""
    return f"{found.names[int(flags.argmax())]} {column}{more}"


def length_in_mm(metres: float) -> str:
    """A length for a reader."""
    return f"{1000 * metres:,.1f} mm"


FAULTS = (
    Fault(
        "is_deep",
        "overlap",
        lambda config: f"deeper than {1000 * config.max_penetration:g} mm at the start",
        _describe_overlap,
    ),
    # At the start no chain of bodies at most 1 mm apart leads to anything that is not judged; or nothing
    # within 1 mm presses it upwards, and it sinks by more than 1 mm within 0.05 s.
    Fault(
        "floats",
        "float",
        lambda _: "nothing carries it at the start",
        partial(_describe_bodies, column="floats"),
    ),
    Fault(
        "falls",
        "fall",
        lambda _: f"more than {1000 * FALL:g} mm lower at the end",
        partial(_describe_bodies, column="falls"),
    ),
)
"""One more verdict is one more here, with its flags in `Judgement`: rows, table and sentences follow."""


def find_free_bodies(model: mujoco.MjModel) -> FreeBodies:
    """The bodies of a model that are judged.

    Left out are those that an actuator drives: robots; and those that collide with nothing: markers.
    """
    collides = _collides(model)
    targets = zip(model.actuator_trntype.tolist(), model.actuator_trnid[:, 0].tolist(), strict=True)
    pulled = [
        int(getattr(model, _PULLED[kind])[target]) for kind, target in targets if kind in _PULLED
    ]
    pulled += model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY, 0].tolist()
    is_driven = np.isin(np.arange(model.nbody), model.body_rootid[pulled])
    kept = []
    left_out = []
    for body in model.jnt_bodyid[model.jnt_type == _FREE].tolist():
        if is_driven[body]:
            left_out.append("an actuator drives them")
        elif not collides[model.body_rootid[model.geom_bodyid] == body].any():
            left_out.append("they collide with nothing")
        else:
            kept.append(body)
    names = tuple(_name(model, body) for body in kept)
    return FreeBodies(np.array(kept, int), names, tuple(left_out), *collision_shapes(model))


def collision_shapes(model: mujoco.MjModel) -> tuple[np.ndarray, tuple[str, ...]]:
    """The geoms that are the shapes of bodies, whatever contacts the file leaves out between two of them.

    Of a body with all that hangs on it these are the geoms that can collide with anything at all. If it has
    none, they are those that are drawn, opaque, convex and have a volume; markers that a program moves
    (mocap) have none.

    Returns:
      bool[ngeom], and a note on the bodies that are measured by what is drawn.
    """
    is_shape = _collides(model)
    root = model.body_rootid[model.geom_bodyid]
    has_shape = np.isin(root, root[is_shape])
    candidates = np.flatnonzero(~has_shape & (model.body_mocapid[root] < 0))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    drawn = [geom for geom in candidates.tolist() if _is_solid(Geom(model, data, geom))]
    is_shape[drawn] = True
    names = [repr(_name(model, body)) for body in dict.fromkeys(root[drawn].tolist())]
    if not names:
        return is_shape, ()
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    what = (
        "bodies that collide with nothing: overlaps with them are measured by what is drawn of them"
    )
    return is_shape, (f"{what}: {', '.join(names[:_MOST_NAMES])}{more}",)


def _collides(model: mujoco.MjModel) -> np.ndarray:
    """bool[ngeom]: what can collide with anything, by its bits or because a pair names it."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    collides[np.concatenate([model.pair_geom1, model.pair_geom2])] = True
    return collides


def _is_solid(geom: Geom) -> bool:
    """Whether a geom is opaque, convex and has a volume."""
    if not geom.is_convex or geom.rgba[3] < 1:
        return False
    try:
        return convex_parts([geom.mesh()]) is not None
    except AssetError:
        return False


def _name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body-{body}"


def judge_start(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    detector: Detector,
    bodies: FreeBodies,
    config: JudgeConfig,
) -> Judgement:
    """Judges one start with one of MuJoCo's detectors of convex collisions.

    Args:
      model, start: read alone; velocities count as zero.
    """
    model = copy.copy(model)
    data = copy.copy(start)
    keep_awake(model, detector)
    data.qvel[:] = 0
    number = len(bodies.ids)
    note = ""
    depth = np.zeros(number)
    against = ("",) * number
    floats = np.zeros(number, bool)
    falls = np.zeros(number, bool)
    shift, turn = np.full((2, len(config.seconds), number), np.inf)
    sense = None
    try:
        mujoco.mj_forward(model, data)
        depth, against, is_complete = _overlaps(model, data, bodies)
        is_connected, is_pressed_up = _find_supports(model, data, bodies)
        if config.sense is not None:
            # The contacts are those of bodies up to `GAP` apart, as `_find_supports` left them.
            sense = find_sense(
                model, data, bodies.ids.tolist(), bodies.names, bodies.is_shape, config.sense
            )
        motion = _Motion(model, data, bodies, config.hold_joints)
        shift, turn = motion.run(config.seconds)
        floats = ~is_connected | (~is_pressed_up & (motion.sunk > GAP))
        falls = motion.sinking() > FALL
        note = motion.note
        if not note and (data.warning.number[_FULL].any() or not is_complete):
            note = "MuJoCo had no room for all contacts"
    except mujoco.FatalError as error:
        note = " ".join(str(error).split())
    return Judgement(
        names=bodies.names,
        shift=shift,
        turn=turn,
        is_still=~has_moved(shift, turn, config.limits),
        penetration=depth,
        against=against,
        is_deep=depth > config.max_penetration,
        floats=floats,
        falls=falls,
        begin=start.qpos.copy(),
        end=data.qpos.copy(),
        note=note,
        sense=sense,
    )


def _down(model: mujoco.MjModel) -> np.ndarray:
    """f64[3]: along gravity, of unit length; zero where there is none."""
    return model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)


def _pairs(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    return (
        owner[is_other],
        data.contact.dist[is_other],
        -data.contact.frame[is_other, :3] @ _down(model),
    )


def _overlaps(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies
) -> tuple[np.ndarray, tuple[str, ...], bool]:
    """f64[B], metres, the deepest overlap of each body with another, with what, and whether none is missed.

    It is measured by geometry: whatever the file says of who may touch whom.
    """
    deepest = np.zeros(len(bodies.ids))
    against = [""] * len(bodies.ids)
    root = model.body_rootid[model.geom_bodyid]
    is_complete = True
    try:
        found = [_open_contacts(model, data, bodies, np.isin(root, bodies.ids))]
    except _NoRoomError:
        found = [_pairs(model, data, bodies)[:2]]
        for body in bodies.ids:
            try:
                found.append(_open_contacts(model, data, bodies, root == body))
            except _NoRoomError:
                is_complete = False
    for owner, distance in found:
        for pair, depth in zip(owner.tolist(), -distance, strict=True):
            for own, other in (pair, pair[::-1]):
                if own >= 0 and depth > deepest[own]:
                    deepest[own] = depth
                    against[own] = bodies.names[other] if other >= 0 else "what is not judged"
    return deepest, tuple(against), is_complete


class _NoRoomError(Exception):
    """MuJoCo has no room for all contacts."""


def _open_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies, is_asked: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`_pairs` of the shapes of some bodies, bool[ngeom], with all other shapes, without any filter.

    Raises:
      _NoRoomError: there are more contacts than the file has room for.
    """
    model = copy.copy(model)
    data = copy.copy(data)
    # Two geoms are tried if one has a bit for what it is that the other asks for.
    model.geom_contype[:] = np.where(bodies.is_shape, np.where(is_asked, 1, 2), 0)
    model.geom_conaffinity[:] = np.where(bodies.is_shape & is_asked, 3, 0)
    # A body has the bits of its geoms. What did not collide is in no tree that is searched for geoms.
    for of_body, of_geom in (
        (model.body_contype, model.geom_contype),
        (model.body_conaffinity, model.geom_conaffinity),
    ):
        of_body[:] = 0
        np.bitwise_or.at(of_body, model.geom_bodyid, of_geom)
    model.exclude_signature[:] = -1
    disable = mujoco.mjtDisableBit
    enable = mujoco.mjtEnableBit
    model.opt.disableflags &= ~int(disable.mjDSBL_CONTACT | disable.mjDSBL_CONSTRAINT)
    model.opt.disableflags |= int(disable.mjDSBL_FILTERPARENT | disable.mjDSBL_MIDPHASE)
    model.opt.enableflags &= ~int(enable.mjENBL_OVERRIDE)
    data.warning.number[:] = 0
    try:
        mujoco.mj_collision(model, data)
    except mujoco.FatalError as error:
        raise _NoRoomError from error
    if data.warning.number[_FULL].any():
        raise _NoRoomError
    return _pairs(model, data, bodies)[:2]


def _find_supports(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies
) -> tuple[np.ndarray, np.ndarray]:
    """What carries each body, as bodies that are at most `GAP` apart touch.

    Returns:
      is_connected, bool[B]: a chain of contacts leads to a body that is not judged (floor, table); and
      is_pressed_up, bool[B]: some contact presses it upwards.
    """
    margins = model.geom_margin.copy()
    model.geom_margin[:] = np.maximum(margins, GAP)
    mujoco.mj_collision(model, data)
    owner, distance, lift = _pairs(model, data, bodies)
    model.geom_margin[:] = margins
    owner = owner[distance <= GAP]
    lift = lift[distance <= GAP]
    # The last entry is all that is not judged, which -1 means as well.
    is_connected, is_pressed_up = np.zeros((2, len(bodies.ids) + 1), bool)
    is_connected[-1] = True
    while (reached := is_connected[owner].any(1)[:, None] & ~is_connected[owner]).any():
        is_connected[owner[reached]] = True
    is_pressed_up[owner[lift >= MIN_LIFT, 1]] = True
    is_pressed_up[owner[lift <= -MIN_LIFT, 0]] = True
    return is_connected[:-1], is_pressed_up[:-1]


class _Motion:
    """The simulation of one start.

    Attributes:
      sunk: f64[B], metres by which each body had sunk 0.05 s after the start.
      note: what went wrong, "" if nothing did.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, bodies: FreeBodies, holds: bool
    ) -> None:
        self._model = model
        self._data = data
        self.note = ""
        self._address = model.jnt_qposadr[model.body_jntadr[bodies.ids]]
        axes = data.xmat[bodies.ids].reshape(-1, 3, 3)
        self._center = np.einsum(
            "bji,bj->bi", axes, data.subtree_com[bodies.ids] - data.xpos[bodies.ids]
        )
        self.sunk = np.zeros(len(bodies.ids))
        self._at_once = round(AT_ONCE / model.opt.timestep)
        self._done = 0
        # Links that move against the body that they hang on, and whose they are.
        place = np.full(model.nbody, -1)
        place[bodies.ids] = np.arange(len(bodies.ids))
        is_link = (place[model.body_rootid] >= 0) & (model.body_jntnum > 0) & (place < 0)
        self._links = np.flatnonzero(is_link)
        self._owner = place[model.body_rootid[self._links]]
        # Positions and velocities of joints that are held.
        self._qpos = data.qpos.copy()
        self._is_held = np.full(model.nq, holds)
        self._is_stopped = np.full(model.nv, holds)
        for joint in np.flatnonzero(model.jnt_type == _FREE):
            self._is_held[model.jnt_qposadr[joint] + np.arange(7)] = False
            self._is_stopped[model.jnt_dofadr[joint] + np.arange(6)] = False
        self._start = self._poses()

    def _body_poses(self) -> np.ndarray:
        """f64[B, 7]: where each body's centre of mass is, and its orientation."""
        pose = self._data.qpos[self._address[:, None] + np.arange(7)]
        with np.errstate(invalid="ignore"):
            pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
            pose[:, :3] += rotate(np, pose[:, 3:], self._center)
        return pose

    def _poses(self) -> np.ndarray:
        """f64[B + L, 7]: of the bodies, and of all links, their centres of mass and orientations."""
        links = np.c_[self._data.xipos[self._links], self._data.xquat[self._links]]
        return np.concatenate([self._body_poses(), links])

    def sinking(self) -> np.ndarray:
        """f64[B], metres by which each body has sunk along gravity since the start; 0 where it diverged."""
        start = self._start[: len(self.sunk), :3]
        return np.nan_to_num((self._body_poses()[:, :3] - start) @ _down(self._model))

    def run(self, seconds: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """f64[H, B] metres and radians: the farthest up to each horizon, infinite where it diverged."""
        step = self._model.opt.timestep
        ends = [round(each / step) for each in seconds]
        # Looked at when it is asked what has sunk, too.
        marks = sorted({*ends, min(self._at_once, ends[-1])})
        looks = watch(self._advance, self._start, marks, max(round(_LOOK / step), 1))
        farthest = dict(zip(marks, looks, strict=True))
        shift, turn = np.stack([self._of_bodies(*farthest[end]) for end in ends], axis=1)
        return shift, turn

    def _of_bodies(self, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """f64[2, B] of f64[B + L] each: of a body with links the farthest of them."""
        number = len(self.sunk)
        farthest = np.stack([shift[:number], turn[:number]])
        np.maximum.at(farthest[0], self._owner, shift[number:])
        np.maximum.at(farthest[1], self._owner, turn[number:])
        return farthest

    def _advance(self, count: int) -> np.ndarray:
        """So many steps, and the poses after them: NaN where it diverged, as nothing is known any more."""
        if stop_asked.is_set():
            raise KeyboardInterrupt
        if not self.note:
            self._step(count)
            self._done += count
            if self._done == self._at_once:
                self.sunk = self.sinking()
        if self.note:
            return np.full_like(self._start, np.nan)
        if len(self._links):
            mujoco.mj_kinematics(self._model, self._data)
        return self._poses()

    def _step(self, count: int) -> None:
        model = self._model
        data = self._data
        is_any_held = self._is_held.any()
        for _ in range(count if is_any_held else 1):
            mujoco.mj_step(model, data, 1 if is_any_held else count)
            data.qpos[self._is_held] = self._qpos[self._is_held]
            data.qvel[self._is_stopped] = 0.0
        if not np.isfinite(data.qpos).all():
            self.note = f"it diverged before {data.time:.2f} s"


_SHOWN = 12
_RED = (0.86, 0.10, 0.12, 1.0)
_GROUPS_SEEN = 3

_Task = tuple[Path, str, Detector, mujoco.MjModel, mujoco.MjData, FreeBodies]


@dataclass(frozen=True, eq=False)
class JudgedStart:
    """One start of a file, called `start` ("" if there is one alone), as one detector found it."""

    file: Path
    start: str
    detector: Detector
    found: Judgement

    def __str__(self) -> str:
        found = self.found
        name = f"{self.file.name}:{self.start}" if self.start else self.file.name
        far = int(found.shift[-1].argmax())
        parts = []
        if number := int((~found.is_still[-1]).sum()):
            moved = f"{length_in_mm(found.shift[-1, far])} and {np.degrees(found.turn[-1, far]):.0f} deg"
            parts.append(f"{number} of {len(found.names)} moved, {found.names[far]} by {moved}")
        parts += [each.describe(found) for each in FAULTS if getattr(found, each.column).any()]
        return f"{name}, {self.detector}: {'; '.join(filter(None, (*parts, found.note)))}"

    @property
    def badness(self) -> tuple[int, float, int]:
        """How many bodies moved, the farthest by how much, and how many other faults there are."""
        found = self.found
        others = sum(getattr(found, each.column).sum() for each in FAULTS)
        return int((~found.is_still[-1]).sum()), float(found.shift[-1].max()), int(others)


@dataclass(frozen=True, eq=False)
class JudgeReport:
    """What `judge` found; printed, it says how many scenes and bodies are still, overlap, float and fall.

    Attributes:
      config: what was asked.
      starts: every start by every detector, in the order of the files.
      unread: why a file, or its states, cannot be judged, by file.
      notes: what was left out, and what was written.
      mujoco: the version.
    """

    config: JudgeConfig
    starts: tuple[JudgedStart, ...]
    unread: dict[Path, str]
    notes: tuple[str, ...]
    mujoco: str = mujoco.__version__

    @cached_property
    def rows(self) -> pa.Table:
        """A row for each judged body of each start and detector, and one for each file that cannot be judged.

        Metres and radians; columns of motion for each horizon.
        """
        horizons = [f"{seconds:g}s" for seconds in self.config.seconds]
        columns: dict[str, Any] = {
            **dict.fromkeys(("file", "start", "detector", "body"), pa.string()),
            **{f"is_still_{each}": pa.bool_() for each in horizons},
            **{f"{name}_{each}": pa.float64() for each in horizons for name in ("shift", "turn")},
            **{"penetration": pa.float64(), "against": pa.string()},
            **dict.fromkeys((each.column for each in FAULTS), pa.bool_()),
            **dict.fromkeys(("note", "error", "mujoco"), pa.string()),
        }
        if self.config.sense is not None:
            columns |= {"kind": pa.string(), "carried_by": pa.string(), "is_usual": pa.bool_()}
        rows = [row for each in self.starts for row in self._rows_of(each, horizons)]
        rows += [{"file": str(path), "error": reason} for path, reason in self.unread.items()]
        return pa.Table.from_pylist(
            [row | {"mujoco": self.mujoco} for row in rows], pa.schema(columns)
        )

    def _rows_of(self, each: JudgedStart, horizons: list[str]) -> Iterator[dict[str, Any]]:
        found = each.found
        for place, body in enumerate(found.names):
            row: dict[str, Any] = {
                "file": str(each.file),
                "start": each.start,
                "detector": each.detector,
                "body": body,
            }
            row |= {"note": found.note, "against": found.against[place]}
            row["penetration"] = found.penetration[place].item()
            row |= {each.column: getattr(found, each.column)[place].item() for each in FAULTS}
            for name in ("is_still", "shift", "turn"):
                values = getattr(found, name)[:, place].tolist()
                row |= {
                    f"{name}_{label}": value for label, value in zip(horizons, values, strict=True)
                }
            if found.sense is not None and self.config.sense is not None:
                row["kind"] = kind_of_name(body, self.config.sense)
                row |= found.sense.row_of(body)
            yield row

    @cached_property
    def sense(self) -> SenseFindings | None:
        """What the table of sense says of all starts, each counted once; None where it was not asked."""
        if self.config.sense is None:
            return None
        once = {(each.file, each.start): each.found.sense for each in self.starts}
        return SenseFindings.total(filter(None, once.values()))

    def shares(self, detector: Detector, of_bodies: bool = False) -> dict[str, float]:
        """Number of starts (or bodies); shares that are still up to each horizon, overlap, float, fall."""
        found = [each.found for each in self.starts if each.detector == detector]

        def share(flags: list[np.ndarray], of_start: Callable[[np.ndarray], Any]) -> float:
            return float(
                np.mean(np.hstack(flags if of_bodies else [of_start(each) for each in flags]))
            )

        return {
            "number": sum(len(each.names) for each in found) if of_bodies else len(found),
            **{
                f"still {seconds:g} s": share([each.is_still[place] for each in found], np.all)
                for place, seconds in enumerate(self.config.seconds)
            },
            **{
                fault.title: share([getattr(each, fault.column) for each in found], np.any)
                for fault in FAULTS
            },
        }

    def __str__(self) -> str:
        config = self.config
        lines = []
        cells = []
        for kind in ("scenes", "bodies"):
            for name in DETECTORS:
                if any(each.detector == name for each in self.starts):
                    number, *shares = self.shares(name, kind == "bodies").values()
                    cells.append(
                        [f"{kind}, {name}", f"{number}", *(f"{each:.3f}" for each in shares)]
                    )
        if cells:
            still = (f"still {seconds:g} s" for seconds in config.seconds)
            titles = (fault.title for fault in FAULTS)
            lines.append(aligned_table(["", "number", *still, *titles], cells))
        meanings = [
            f"still: never more than {1000 * config.max_shift:g} mm or {config.max_turn_deg:g} deg from the "
            "start",
            *(f"{fault.title}: {fault.meaning(config)}" for fault in FAULTS),
        ]
        lines.append(
            f"MuJoCo {self.mujoco}, from rest, everything awake, each file's own options; "
            + "; ".join(meanings)
        )
        if self.sense is not None:
            lines += self.sense.lines()
        cannot = [f"{path} cannot be judged: {reason}" for path, reason in self.unread.items()]
        return "\n".join(
            [*lines, *self.notes, *_shorten([*map(str, self._worst_first())]), *_shorten(cannot)]
        )

    def _worst_first(self) -> list[JudgedStart]:
        """The starts with faults, by the worse detector; those in which most bodies moved first."""
        bad = [each for each in self.starts if each.badness[0] or each.badness[2]]
        worse = {
            (each.file, each.start): each for each in sorted(bad, key=lambda each: each.badness)
        }
        return sorted(worse.values(), key=lambda each: each.badness, reverse=True)

    def write(self, out: Path) -> str:
        """Writes report.csv, report.parquet and, where something is wrong, worst.png; a line that says so.

        Raises:
          OSError: it cannot be written.
        """
        out.mkdir(parents=True, exist_ok=True)
        with file_whole(out / "report.csv") as fresh:
            pyarrow.csv.write_csv(self.rows, fresh)
        with file_whole(out / "report.parquet") as fresh:
            pq.write_table(self.rows, fresh)
        bad = self._worst_first()
        (can_draw, message) = renderer_status()
        drawn = f", {draw(bad[0], out / 'worst.png').name}" if bad and can_draw else ""
        return f"report     {out / 'report.csv'}{drawn}" + (
            "" if can_draw else f"; no picture: {message}"
        )


def _shorten(lines: list[str]) -> list[str]:
    return lines[:_SHOWN] + [f"and {len(lines) - _SHOWN} more"] * (len(lines) > _SHOWN)


def draw(each: JudgedStart, path: Path) -> Path:
    """A picture of a start and of its end side by side, what moved in red."""
    model = read_model(each.file)[0]
    found = each.found
    is_seen = (model.geom_group < _GROUPS_SEEN) & (model.geom_rgba[:, 3] > 0)
    names = [
        model.body(int(body)).name or f"body-{body}"
        for body in model.body_rootid[model.geom_bodyid]
    ]
    is_judged = np.isin(names, found.names)
    if not (is_seen & is_judged).any():
        is_seen[:] = True
    is_moved = np.isin(names, np.array(found.names)[~found.is_still[-1]])
    model.geom_matid[is_moved] = -1
    model.geom_rgba[is_moved] = _RED
    model.geom_group[:] = np.where(is_seen, VISUAL_GROUP, HIDDEN_GROUP)
    if not model.nlight:
        model.vis.headlight.ambient = 0.4
        model.vis.headlight.diffuse = 0.6
    data = mujoco.MjData(model)
    data.qpos[:] = found.begin
    mujoco.mj_forward(model, data)
    focus = drawn_points(model, data, is_seen & is_judged)
    ends = [qpos for qpos in (found.begin, found.end) if np.isfinite(qpos).all()]
    images = [render_model(model, qpos, focus=focus, samples=8) for qpos in ends]
    captions = [f"{each.file.name} {each.start}: start", "end"][: len(images)]
    return save_png(contact_sheet(images, captions, columns=2), path)


def judge_scenes(
    paths: Sequence[str | Path],
    states: str | Path | np.ndarray | None,
    config: JudgeConfig,
    detectors: Sequence[Detector],
    max_starts: int,
    jobs: int,
) -> JudgeReport:
    """See `cluttergen_jax.judge`."""
    files, num_others = find_scenes(paths)
    unread: dict[Path, str] = {}
    changed: dict[Path, tuple[str, ...]] = {}
    left_out = Counter[str]()
    threads = jobs or os.cpu_count() or 1
    # MuJoCo keeps meshes that it has read, and takes a file of the same second for the one that it knows.
    mujoco.mj_clearCache(mujoco.mj_getCache())

    def tasks() -> Iterator[_Task]:
        for path in files:
            try:
                model, of_file = read_model(path)
                bodies = find_free_bodies(model)
                changed[path] = (*of_file, *bodies.notes)
                left_out.update(f"free bodies are not judged: {why}" for why in bodies.left_out)
                if not len(bodies.ids):
                    why = "; ".join(
                        f"free bodies are not judged: {each}"
                        for each in dict.fromkeys(bodies.left_out)
                    )
                    raise AssetError(f"no body in it moves freely{f' ({why})' if why else ''}")
                config.check_steps(model)
                starts, num_more = read_starts(model, path, states, max_starts)
                left_out[f"starts are not judged: at most {max_starts} of a file"] += num_more
                for name, data in starts:
                    yield from ((path, name, each, model, data, bodies) for each in detectors)
            except ClutterGenError as error:
                unread[path] = str(error)
            progress.update()

    def run(task: _Task) -> JudgedStart:
        path, name, detector, model, data, bodies = task
        return JudgedStart(path, name, detector, judge_start(model, data, detector, bodies, config))

    pool = ThreadPoolExecutor(threads)
    with silent_log(), Progress("judging", len(files), "file") as progress:
        started: list[Future[JudgedStart]] = []
        try:
            for task in tasks():
                started.append(pool.submit(run, task))
                # As many wait as run, so that no more models are loaded than are needed.
                while len(waiting := [each for each in started if not each.done()]) > 2 * threads:
                    wait(waiting, return_when=FIRST_COMPLETED)
                progress.note(f"{len(started) - len(waiting)} simulations done")
            judged = tuple(each.result() for each in started)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    left_out["XML files are no scenes: parts of others, or of another kind"] = num_others
    notes = [f"{number} {what}" for what, number in left_out.items() if number]
    files_of: dict[str, list[str]] = {}
    for path, of_file in changed.items():
        for note in of_file:
            files_of.setdefault(note, []).append(path.name)
    for note, names in files_of.items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        notes.append(f"{names[0]}{more}: {note}")
    return JudgeReport(config, judged, unread, tuple(notes))
