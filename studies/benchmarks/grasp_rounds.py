"""Rounds of clearing a pile, as VGN's authors have them: look, propose, grasp, take away, until it is over.

A round ends when no object is left, nothing is proposed, or two attempts in a row fail (Breyer et al., CoRL
2020). Every attempt is seen anew, in depth images with noise as `robot dataset` has them, and executed as its
lifts are: the open hand has to come there freely, everything is awake, the fingers close, the hand rises.
What is lifted is taken away, and the rest settles. Objects whose middle is outside the cube are taken away
before the round, and count as not cleared if they come there later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import populated_spec
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping import vgn
from cluttergen_jax.downstream.robot.grasping.clutter import LiftEnd, LiftScene, StillScene
from cluttergen_jax.downstream.transforms import inverse
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import REALSENSE, noisy
from studies.benchmarks.grasp_geometry import LEAST_CLEARANCE, OpenHand, draw_grasps, draw_with_room
from studies.benchmarks.grasp_learning import network_inputs

MOST_FAILURES = 2
"""In a row, after which a round is over."""
# Seconds between two looks at whether what is left rests, and after which it is let go on.
_REST = 0.25
_LONGEST_REST = 4.0

# m/s and rad/s of what rests.
_SLOW = 0.01
_SLOW_TURN = 0.1

_BELOW = 0.05
"""Metres below the region's middle at which an object has fallen."""
_MOST_SEEN = 1500
"""Grasps of a volume that the network looks at."""
_TEMPERATURE = 0.2
"""By how much scores of grasps are shaken, so that one that failed is not proposed again."""

Proposal = tuple[np.ndarray, float]
"""T_task_tool f64[4, 4], and metres between the points that the fingers press on."""


class Proposer(Protocol):
    """Who chooses a grasp in a volume f32[N, N, N]."""

    def __call__(self, grid: np.ndarray, rng: np.random.Generator) -> Proposal | None:
        """One grasp; None to give up."""


@dataclass(frozen=True)
class Sight:
    """How a scene is seen: num_views pictures, with `noise` times the noise of a usual depth camera."""

    num_views: int = 6
    noise: float = 1.0


@dataclass(frozen=True)
class Round:
    """What became of a pile.

    Attributes:
      num_objects: of the pile. ends: of each attempt, a word of `LiftEnd`, or `blocked`.
    """

    num_objects: int
    ends: tuple[str, ...]

    @property
    def num_cleared(self) -> int:
        """Attempts that lifted something."""
        return self.ends.count(str(LiftEnd.LIFTED))


def run_round(
    scene: Scene,
    robot: RobotDescription,
    propose: Proposer,
    sight: Sight,
    seed: Sequence[int],
    show: Callable[[str], None] = lambda text: None,
) -> Round:
    """Clears a pile as far as it goes.

    Args:
      propose: who chooses. seed: of views, noise and choices; equal ones see the first volume alike.
      show: is told how each attempt ended.
    """
    scene = settle(keep_inside(scene))
    failures = 0
    num_objects = len(scene.names)
    ends = list[str]()
    while scene.names and failures < MOST_FAILURES:
        streams = np.random.default_rng([*seed, len(ends)]).spawn(2)
        still = StillScene(scene, robot)
        proposal = propose(see(scene, still, sight, streams[0]), streams[1])
        if proposal is None:
            break
        T_world_tool = vgn.task_frame(scene.support) @ proposal[0]
        width = proposal[1]
        if still.blocker(T_world_tool, width):
            end = "blocked"
        else:
            end, scene = attempt(scene, robot, T_world_tool, width)
        ends.append(end)
        failures = 0 if end == LiftEnd.LIFTED else failures + 1
        show(end)
    return Round(num_objects, tuple(ends))


def see(scene: Scene, still: StillScene, sight: Sight, rng: np.random.Generator) -> np.ndarray:
    """f32[N, N, N]: the volume of a scene, as `robot dataset` makes it."""
    T_world_task = vgn.task_frame(scene.support)
    noise = REALSENSE.scale(sight.noise)
    depths = []
    cameras = []
    for camera in vgn.draw_cameras(T_world_task, sight.num_views, rng):
        depth, believed = noisy(still.depth(camera), camera, noise, rng)
        depths.append(depth)
        cameras.append(believed)
    return vgn.tsdf_grid(depths, cameras, T_world_task)[0]


class _Lifts(LiftScene):
    """Lifts after which one may ask where everything is."""

    def poses(self) -> np.ndarray:
        """f64[K, 7]: T_world_object."""
        data = self._data
        return np.concatenate([data.xpos[self._bodies], data.xquat[self._bodies]], axis=1)


def attempt(
    scene: Scene, robot: RobotDescription, T_world_tool: np.ndarray, width: float
) -> tuple[str, Scene]:
    """How a lift ends, and what is left of the scene, at rest."""
    lifts = _Lifts(scene, robot)
    lift = lifts.lift(T_world_tool, width)
    if lift.end is LiftEnd.DIVERGED:
        return str(lift.end), scene
    left = [index for index in range(len(scene.names)) if index != lift.raised]
    return str(lift.end), settle(_some_of(replace(scene, poses=lifts.poses()), left))


def _some_of(scene: Scene, index: Sequence[int]) -> Scene:
    names = tuple(scene.names[i] for i in index)
    objects = tuple(scene.objects[i] for i in index)
    return replace(scene, names=names, objects=objects, poses=scene.poses[list(index)])


def keep_inside(scene: Scene) -> Scene:
    """Without the objects whose middle is beside the cube or that fell."""
    at = (
        inverse(vgn.task_frame(scene.support))
        @ np.c_[scene.poses[:, :3], np.ones(len(scene.names))].T
    )
    is_inside = ((at[:2] >= 0) & (at[:2] < vgn.SIZE)).all(0) & (at[2] > vgn.DEPTH - _BELOW)
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
    for _ in range(round(_LONGEST_REST / _REST)):
        mujoco.mj_step(model, data, round(_REST / step))
        speed = np.abs(data.qvel.reshape(-1, 6))
        if speed[:, :3].max() < _SLOW and speed[:, 3:].max() < _SLOW_TURN:
            break
    if not np.isfinite(data.qpos).all():
        return scene
    return keep_inside(replace(scene, poses=data.qpos.reshape(-1, 7).copy()))


@dataclass(frozen=True)
class ByNetwork:
    """Of the antipodal grasps of a volume whose open hand is clear the one of which a network is surest.

    It looks at some of those for which a few points of the hand have room. How much room there is, it was
    shown; so any will do. Where no hand is clear it is asked all the same.

    Attributes:
      score: what `network_inputs` makes of C grasps to f[C], logits.
      hand: that has to be clear.
    """

    score: Callable[[dict[str, np.ndarray]], np.ndarray]
    hand: OpenHand

    def __call__(self, grid: np.ndarray, rng: np.random.Generator) -> Proposal | None:
        """See `Proposer`."""
        found = draw_with_room(grid, self.hand, _MOST_SEEN, rng)
        if not len(found.width):
            return None
        shaken = self.score(network_inputs(grid, found)) + _TEMPERATURE * rng.gumbel(
            size=len(found.width)
        )
        found = found.take(np.argsort(-shaken, kind="stable"))
        row = self.hand.first_clear(grid, found, (LEAST_CLEARANCE,)) or 0
        return found.pose[row], float(found.width[row])


@dataclass(frozen=True)
class ByGeometry:
    """One of the best antipodal grasps of a volume, or any; with level normals where there is no other.

    Scores are shaken by noise of Gumbel's distribution: what looks clear may touch something unseen, and
    the best grasp would be proposed again as long as nothing moves.

    Attributes:
      hand: that has to be clear. is_random: any of those with as much room, all with equal chances.
    """

    hand: OpenHand
    is_random: bool = False

    def __call__(self, grid: np.ndarray, rng: np.random.Generator) -> Proposal | None:
        """See `Proposer`."""
        for is_level in (False, True):
            found = draw_grasps(grid, self.hand, is_level)
            shaken = (0 if self.is_random else found.score) + _TEMPERATURE * rng.gumbel(
                size=len(found.score)
            )
            found = found.take(np.argsort(-shaken, kind="stable"))
            row = self.hand.first_clear(grid, found)
            if row is not None:
                return found.pose[row], float(found.width[row])
        return None
