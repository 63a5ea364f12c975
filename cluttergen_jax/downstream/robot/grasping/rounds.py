"""Rounds of clearing piles: look, propose, grasp, take away, until it is over (Breyer et al., CoRL 2020).

A round ends when no object is left, nothing is proposed, or two attempts in a row fail. Every attempt is seen
anew, in depth images with noise. What an attempt is, a rule says:

vgn       as in the simulation of VGN's authors: the hand starts 5 cm back, wide open, stops where it touches
          and closes there, goes back by 10 cm, and holds something then (`clutter.ApproachScene`).
strict    as lifts of `robot dataset`: the hand, opened for what it takes, may touch nothing at the grasp and
          on its last 10 cm; it closes and rises by 10 cm, and an object has come up (`clutter.LiftScene`).

What was lifted is taken away, and the rest settles. Objects whose middle is outside VGN's cube of 30 cm are
taken away before the round; those that come there later count as not cleared.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from cluttergen_jax.assets import populated_spec
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.clutter import (
    ApproachScene,
    Lift,
    LiftEnd,
    LiftScene,
    StillScene,
)
from cluttergen_jax.downstream.robot.grasping.grasp_dataset import (
    CUBE,
    FINGER,
    draw_cameras,
    task_frame,
    tsdf_grid,
)
from cluttergen_jax.downstream.robot.grasping.holdable import check_holdable
from cluttergen_jax.downstream.robot.grasping.volume_grasps import OpenHand, draw_grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import inverse
from cluttergen_jax.downstream.words import GraspRule
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.own_parts import array_of, load_module, part_name
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Scene, read_bank, read_scenes
from cluttergen_jax.statistics import share_of

MOST_FAILURES = 2
"""In a row, after which a round is over; VGN's `MAX_CONSECUTIVE_FAILURES`."""
# Seconds between two looks at whether what is left rests, and after which it is let go on.
_REST = 0.25
_LONGEST_REST = 4.0

# m/s and rad/s of what rests.
_SLOW = 0.01
_SLOW_TURN = 0.1

_BELOW = FINGER
"""Metres below the region's middle at which an object has fallen."""
_TEMPERATURE = 0.2
"""By how much scores of grasps are shaken, so that one that failed is not proposed again."""
_TURN = 1e-3
GEOMETRY = "geometry"
_ANSWER = (
    "T_world_tool f[4, 4] (a rigid transform, metres) and a width (metres), or None to give up"
)


@dataclass(frozen=True, eq=False)
class ClutterView:
    """What a proposer is given: V depth images of a scene, with noise, and what was made of them.

    Attributes:
      depth: f32[V, H, W], metres along the optical axis; nan: nothing was measured, inf: nothing is there.
      K: f64[3, 3], pixels. T_world_camera: f64[V, 4, 4], OpenCV's axes, as they are believed to be.
      grid: f32[1, N, N, N], truncated signed distances as VGN's networks read them
        (`grasp_dataset.tsdf_grid`).
      T_world_task: f64[4, 4], a lower corner of the cube of `size` metres that the grid fills; the top lies
        5 cm above it.
      widest: metres that the hand opens.
    """

    depth: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray
    grid: np.ndarray
    T_world_task: np.ndarray
    size: float
    widest: float


class ClutterProposer(Protocol):
    """Who chooses a grasp; `proposer=` of `robot.clear_clutter` takes it."""

    def __call__(self, rng: np.random.Generator, view: ClutterView) -> Any:
        """One grasp: T_world_tool f[4, 4] and metres between the points that the fingers press on; or None.

        z of the tool is the approach, y the direction in which the fingers close, its origin lies between
        their pads: 4.5 cm before that of VGN's tool. Calls come from several threads.
        """


@dataclass(frozen=True)
class ClutterRound:
    """What became of a pile.

    Attributes:
      scene: its number in the bank. num_objects: in the cube when the round began; num_outside: of the
        others, which were taken away.
      ends: of each attempt, a word of `clutter.LiftEnd`. lifted: the objects' names, "" where nothing was.
      left: objects in the cube in the end. gave_up: nothing was proposed while some were left.
    """

    scene: int
    num_objects: int
    num_outside: int
    ends: tuple[str, ...]
    lifted: tuple[str, ...]
    left: int
    gave_up: bool

    @property
    def num_cleared(self) -> int:
        """Attempts that lifted something."""
        return self.ends.count(str(LiftEnd.LIFTED))


@dataclass(frozen=True)
class ClutterRounds:
    """Rounds of one proposer by one rule; printed, what it reached, with 95 % intervals (Wilson).

    Attributes:
      rule, proposer, robot: by name. rounds: a pile each.
    """

    rule: str
    proposer: str
    robot: str
    rounds: tuple[ClutterRound, ...]

    @property
    def ends(self) -> Counter[str]:
        """How many attempts ended in each way."""
        return Counter(end for each in self.rounds for end in each.ends)

    @property
    def num_attempts(self) -> int:
        """Of all rounds."""
        return self.ends.total()

    @property
    def num_objects(self) -> int:
        """Of all piles, in the cube."""
        return sum(each.num_objects for each in self.rounds)

    @property
    def num_cleared(self) -> int:
        """Attempts that lifted something, each an object."""
        return self.ends[str(LiftEnd.LIFTED)]

    def __str__(self) -> str:
        failures = ", ".join(
            f"{name} {number}"
            for name, number in self.ends.most_common()
            if name != str(LiftEnd.LIFTED)
        )
        gave_up = sum(each.gave_up for each in self.rounds)
        outside = sum(each.num_outside for each in self.rounds)
        lines = [
            f"rounds     {len(self.rounds)} piles, rule {self.rule}, proposer {self.proposer}, "
            f"hand of {self.robot}",
            f"success    {share_of(self.num_cleared, self.num_attempts)} attempts",
            f"cleared    {share_of(self.num_cleared, self.num_objects)} objects",
            f"failures   {failures or 'none'}; gave up {gave_up} times",
        ]
        if outside:
            lines.append(
                f"left out   {outside} objects outside of the cube of {CUBE:g} m about the region's middle"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class RoundPlan:
    """How rounds are run.

    Attributes:
      robot: whose hand it is. rule: of attempts.
      propose: who chooses; None for `GeometryProposer`.
      num_views: images before each attempt; noise: factor of a usual depth camera's.
      seed: of cameras, noise and choices.
    """

    robot: RobotDescription
    rule: GraspRule
    propose: ClutterProposer | None
    num_views: int
    noise: float
    seed: int


def find_proposer(proposer: str | ClutterProposer) -> ClutterProposer | None:
    """Who is called so; None for `geometry`.

    Raises:
      ConfigError: there is none, or it cannot be called.
    """
    if proposer == GEOMETRY:
        return None
    found: Any = proposer
    if isinstance(proposer, str):
        if ":" not in proposer:
            raise ConfigError(
                f"proposer {proposer!r}", f"{GEOMETRY}, or FILE.py:NAME or MODULE:NAME", GEOMETRY
            )
        module, name, _ = load_module(proposer, "proposer")
        found = getattr(module, name, None)
    if not callable(found):
        raise ConfigError(
            f"proposer {proposer!r}, which cannot be called", "a function (rng, view) of your own"
        )
    own: ClutterProposer = found
    return own


def clear_piles(
    bank: Path, plan: RoundPlan, num_rounds: int | None, num_threads: int, out: Path | None
) -> ClutterRounds:
    """Rounds on the scenes of a bank that stand; see `robot.clear_clutter`."""
    scenes = list(read_scenes(read_bank(bank)))[:num_rounds]
    if not scenes:
        raise BankError(f"{bank}: none of its scenes stands", "one that does or more")
    kept = [keep_inside(scene) for scene in scenes]
    if not any(len(scene.names) for scene in kept):
        raise BankError(
            f"{bank}: no object lies in the cube of {CUBE:g} m about the middle of its region",
            "scenes as of VGN, on 28 cm",
            "cluttergen generate --region 0.28x0.28 --method pile",
        )
    check_holdable([each for scene in kept for each in scene.objects], plan.robot, str(bank))
    found: dict[int, ClutterRound] = {}
    pool = ThreadPoolExecutor(num_threads)
    try:
        with Progress("rounds", len(scenes), "pile") as progress:
            waiting = [pool.submit(run_round, scene, plan) for scene in scenes]
            for future in as_completed(waiting):
                each = future.result()
                found[each.scene] = each
                cleared = sum(one.num_cleared for one in found.values())
                total = sum(one.num_objects for one in found.values())
                progress.update(1, f"{cleared} of {total} cleared")
    finally:
        pool.shutdown(cancel_futures=True)
    name = GEOMETRY if plan.propose is None else part_name(plan.propose)
    rounds = tuple(found[number] for number in sorted(found))
    if out is not None:
        content = {
            "rule": plan.rule,
            "proposer": name,
            "robot": plan.robot.name,
            "views": plan.num_views,
            "noise": plan.noise,
            "seed": plan.seed,
            "rounds": [asdict(each) for each in rounds],
        }
        write_atomically(out, json.dumps(content, indent=1).encode())
    return ClutterRounds(plan.rule, name, plan.robot.name, rounds)


def run_round(scene: Scene, plan: RoundPlan) -> ClutterRound:
    """Clears a pile as far as it goes."""
    number = scene.origin.index
    propose = plan.propose or GeometryProposer(OpenHand(plan.robot, scene.support))
    there = keep_inside(scene)
    num_outside = len(scene.names) - len(there.names)
    scene = settle(there)
    num_objects = len(there.names)
    failures = 0
    ends: list[str] = []
    lifted: list[str] = []
    gave_up = False
    while scene.names and failures < MOST_FAILURES:
        streams = np.random.default_rng([plan.seed, number, len(ends)]).spawn(2)
        still = StillScene(scene, plan.robot)
        chosen = _ask(propose, look(scene, still, plan, streams[0]), streams[1])
        if chosen is None:
            gave_up = True
            break
        lift, after = attempt(scene, still, plan, *chosen)
        is_lifted = lift.end is LiftEnd.LIFTED
        ends.append(str(lift.end))
        lifted.append(scene.names[lift.raised] if is_lifted else "")
        failures = 0 if is_lifted else failures + 1
        scene = after
    return ClutterRound(
        number, num_objects, num_outside, tuple(ends), tuple(lifted), len(scene.names), gave_up
    )


def look(scene: Scene, still: StillScene, plan: RoundPlan, rng: np.random.Generator) -> ClutterView:
    """Depth images of a scene and their volume, as `robot dataset` makes them."""
    T_world_task = task_frame(scene.support)
    noise = REALSENSE.scale(plan.noise)
    seen = [
        noisy(still.depth(camera), camera, noise, rng)
        for camera in draw_cameras(T_world_task, plan.num_views, rng)
    ]
    depths = [depth for depth, _ in seen]
    cameras = [camera for _, camera in seen]
    return ClutterView(
        np.stack(depths),
        cameras[0].K,
        np.stack([each.T_world_camera for each in cameras]),
        tsdf_grid(depths, cameras, T_world_task),
        T_world_task,
        CUBE,
        2 * gripper_of(plan.robot).max_opening,
    )


def _ask(
    propose: ClutterProposer, view: ClutterView, rng: np.random.Generator
) -> tuple[np.ndarray, float] | None:
    """T_world_tool f64[4, 4] and the width that a proposer answers.

    Raises:
      ConfigError: it answers something else.
    """
    told = propose(rng, view)
    if told is None:
        return None
    name = part_name(propose)
    try:
        given, width = told
        pose = array_of(given).astype(np.float64)
        width = float(width)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"proposer {name!r} returned {told!r}", _ANSWER) from error
    turn = pose[:3, :3] if pose.shape == (4, 4) else np.zeros((3, 3))
    is_turn = np.abs(turn @ turn.T - np.eye(3)).max() < _TURN and np.linalg.det(turn) > 0
    if not (is_turn and np.isfinite(pose).all() and width >= 0):
        raise ConfigError(f"proposer {name!r} returned {pose.tolist()} and {width}", _ANSWER)
    return pose, min(width, view.widest)


def attempt(
    scene: Scene, still: StillScene, plan: RoundPlan, pose: np.ndarray, width: float
) -> tuple[Lift, Scene]:
    """What becomes of a grasp T_world_tool f64[4, 4] by a rule, and what is left of the scene, at rest."""
    lifts: LiftScene
    if plan.rule == "strict":
        if still.blocker(pose, width):
            return Lift(LiftEnd.BLOCKED, -1, width, 0.0), scene
        lifts = LiftScene(scene, plan.robot)
        lift = lifts.lift(pose, width)
    else:
        lifts = ApproachScene(scene, plan.robot)
        lift = lifts.approach(pose)
        if lift.end is LiftEnd.BLOCKED:
            return lift, scene
    if lift.end is LiftEnd.DIVERGED:
        return lift, scene
    left = [index for index in range(len(scene.names)) if index != lift.raised]
    return lift, settle(_some_of(replace(scene, poses=lifts.poses()), left))


def _some_of(scene: Scene, index: Sequence[int]) -> Scene:
    names = tuple(scene.names[i] for i in index)
    objects = tuple(scene.objects[i] for i in index)
    return replace(scene, names=names, objects=objects, poses=scene.poses[list(index)])


def keep_inside(scene: Scene) -> Scene:
    """Without the objects whose middle is beside VGN's cube or that fell."""
    points = np.c_[scene.poses[:, :3], np.ones(len(scene.names))]
    at = inverse(task_frame(scene.support)) @ points.T
    is_inside = ((at[:2] >= 0) & (at[:2] < CUBE)).all(0) & (at[2] > FINGER - _BELOW)
    return _some_of(scene, np.flatnonzero(is_inside).tolist())


def settle(scene: Scene) -> Scene:
    """The scene some time later, when all is at rest, without what left the cube."""
    if not scene.names:
        return scene
    step = scene.stability.timestep
    spec = populated_spec(
        scene.names, scene.objects, scene.support, step, scene.contact, poses=scene.poses
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    bodies = [model.body(name).id for name in scene.names]
    for _ in range(round(_LONGEST_REST / _REST)):
        mujoco.mj_step(model, data, round(_REST / step))
        speed = np.abs(data.cvel[bodies])
        if speed[:, 3:].max() < _SLOW and speed[:, :3].max() < _SLOW_TURN:
            break
    if not np.isfinite(data.qpos).all():
        return scene
    poses = np.concatenate([data.xpos[bodies], data.xquat[bodies]], axis=1)
    return keep_inside(replace(scene, poses=poses))


@dataclass(frozen=True, eq=False)
class GeometryProposer:
    """One of the best antipodal grasps of a volume whose open hand is clear.

    With level normals where there is no other. Scores are shaken by noise of Gumbel's distribution: what
    looks clear may touch something unseen, and the best grasp would be proposed again as long as nothing
    moves.

    Attributes:
      hand: that has to be clear.
    """

    hand: OpenHand
    name = GEOMETRY

    def __call__(
        self, rng: np.random.Generator, view: ClutterView
    ) -> tuple[np.ndarray, float] | None:
        """See `ClutterProposer`."""
        grid = view.grid[0]
        for is_level in (False, True):
            found = draw_grasps(grid, self.hand, is_level)
            shaken = found.score + _TEMPERATURE * rng.gumbel(size=len(found.score))
            found = found.take(np.argsort(-shaken, kind="stable"))
            row = self.hand.first_clear(grid, found)
            if row is not None:
                return view.T_world_task @ found.pose[row], float(found.width[row])
        return None
