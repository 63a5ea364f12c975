"""How far objects turn in the hand that `rank_grasps` has take them, where not every grasp is possible.

Each object stands alone; every fifth of its grasps that is free there lifts it by 10 cm and holds it for four
and a half seconds. Then the first of a few grasps, drawn at random as if the others were blocked, is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import tyro

import cluttergen_jax as cg
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping.clutter import LIFT, LiftScene, StillScene
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.grasping.grips import rank_grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import angle_between, matrix_of
from studies.benchmarks.section import prose, report, table

_SECONDS = 5.0
_RISE = 0.5
_CLOSE = 0.5
_AT_ONCE = 6
_FAR = 5.0
"""Degrees from which a turn is named."""


@dataclass(frozen=True)
class HeldTurns:
    """What is measured.

    Attributes:
      pool: of objects. robot: whose hand. every: of so many grasps one is measured.
      choices: numbers of grasps that are possible; draws: of these, for each object and number.
      write: put the table into reports/benchmarks.md.
    """

    pool: str = "household"
    robot: str = "panda"
    every: int = 5
    choices: tuple[int, ...] = (2, 3, 4, 6)
    draws: int = 500
    write: bool = False


class HoldScene(LiftScene):
    """A scene in which what is lifted is held for a while."""

    def turn_of(self, pose: np.ndarray, width: float) -> float:
        """Degrees by which the only object turns in the hand from when it has closed until the end."""
        model = self._model
        data = self._data
        gripper = self._gripper
        mujoco.mj_resetData(model, data)
        opening = float(gripper.opening_of(width))
        self._put(pose, opening)
        come = float(gripper.control_of(opening))
        step = model.opt.timestep
        for at in range(0, round(_CLOSE / step), _AT_ONCE):
            share = min(1.0, at * step / (0.9 * _CLOSE))
            data.ctrl[self._grip] = come + share * (gripper.closed - come)
            mujoco.mj_step(model, data, _AT_ONCE)
        closed = self._held()
        for at in range(0, round(_SECONDS / step), _AT_ONCE):
            share = min(1.0, at * step / _RISE)
            data.ctrl[self._up] = LIFT * share**2 * (3 - 2 * share)
            mujoco.mj_step(model, data, _AT_ONCE)
        return float(np.degrees(angle_between(closed, self._held())))

    def _held(self) -> np.ndarray:
        T = np.eye(4)
        hand, held = (self._data.xmat[each].reshape(3, 3) for each in (self._hand, self._bodies[0]))
        T[:3, :3] = hand.T @ held
        return T


@dataclass(frozen=True)
class Measured:
    """Grasps of an object in their rank: degrees of turn, and how straight down each comes (1)."""

    turn: np.ndarray
    down: np.ndarray


def measure(args: HeldTurns, grasps: Grasps, scene: cg.Scene) -> Measured:
    """Lifts of an object that stands alone."""
    robot = find_robot(args.robot)
    still = StillScene(scene, robot)
    holding = HoldScene(scene, robot)
    T_world_object = matrix_of(scene.poses[0])
    found = []
    for grip in list(rank_grasps(grasps, T_world_object, gripper_of(robot)))[:: 2 * args.every]:
        pose = T_world_object @ grip.T_object_tool
        if not still.blocker(pose, grip.width):
            found.append((holding.turn_of(pose, grip.width), -pose[2, 2]))
    turn, down = np.array(found).reshape(-1, 2).T
    return Measured(turn, down)


def cells(args: HeldTurns, measured: list[Measured], number: int) -> list[str]:
    """A row of the table."""
    rng = np.random.default_rng(0)
    taken = [
        (each, rng.permutation(len(each.turn))[:number].min())
        for each in measured
        for _ in range(args.draws)
    ]
    turns = np.array([each.turn[first] for each, first in taken])
    downs = np.array([each.down[first] for each, first in taken])
    return [
        str(number),
        f"{turns.mean():.2f}",
        f"{np.quantile(turns, 0.95):.1f}",
        f"{100 * (turns > _FAR).mean():.1f} %",
        f"{downs.mean():.2f}",
    ]


def main(args: HeldTurns) -> None:
    """Measures and reports."""
    support = find_support("table")
    pool = cg.load_pool(args.pool)
    measured = []
    for grasps in cg.robot.grasps(args.pool, robot=args.robot):
        asset = pool[grasps.name]
        place = [[0, 0, support.top + asset.half_extents[2], 1, 0, 0, 0]]
        scene = cg.Scene((asset.name,), (asset,), np.array(place), support)
        found = measure(args, grasps, scene)
        if len(found.turn) >= max(args.choices):
            measured.append(found)
    head = ("possible grasps", "turn, degrees", "95 % below", f"above {_FAR:g}", "straight down")
    text = prose(
        f"""{len(measured)} objects of {args.pool}, held for {_SECONDS:g} s by the hand of {args.robot}; the
        first by rank of so many grasps drawn at random."""
    )
    rows = [cells(args, measured, number) for number in args.choices]
    body = f"## Turn in the hand\n\n{text}\n\n{table(head, rows)}"
    report("held_turn", body, write=args.write, packages=("mujoco",))


if __name__ == "__main__":
    main(tyro.cli(HeldTurns))
