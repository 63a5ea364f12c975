"""Environments of the robot: success of a random and of a scripted policy, and what a step of control costs.

Scenes have eight objects of a pool, as those of `robot place`. The first run tests grasps of the objects,
which takes some ten CPU-seconds each and is kept. About five minutes for ten episodes.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from itertools import count, product
from pathlib import Path

import tyro

import cluttergen_jax as cg
from cluttergen_jax.downstream.episodes.env import RobotEnv
from studies.benchmarks.section import prose, report, table

_CONTROLS = 100


@dataclass(frozen=True)
class RobotEnvironments:
    """What is measured.

    Attributes:
      num_episodes: of each policy and task.
      bank: scenes; made of `pool` if empty.
      pool: of objects.
      robots, tasks, physics: of environments.
      write: put the table into reports/benchmarks.md.
    """

    num_episodes: int = 10
    bank: str = ""
    pool: str = "household"
    robots: tuple[str, ...] = ("panda",)
    tasks: tuple[str, ...] = ("place", "grasp")
    physics: tuple[str, ...] = ("accurate", "learning")
    write: bool = False


def run_episode(env: RobotEnv, seed: int, is_scripted: bool) -> str:
    """How an episode ends."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    drawn = (env.action_space.sample() for _ in count())
    actions = cg.robot.scripted_actions(env) if is_scripted else drawn
    for action in actions:
        *_, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            return str(info["outcome"])
    return "given up"


def cost(env: RobotEnv) -> tuple[float, float]:
    """CPU-milliseconds of a reset and of a step of control, the arm at rest."""
    env.reset(seed=0)
    begun = time.process_time()
    for seed in range(10):
        env.reset(seed=seed)
    of_reset = 1e2 * (time.process_time() - begun)
    begun = time.process_time()
    for _ in range(_CONTROLS):
        env.step(env.action_of(env.execution.data.ctrl))
    return of_reset, 1e3 / _CONTROLS * (time.process_time() - begun)


def body_of(args: RobotEnvironments, folder: Path) -> str:
    """The section."""
    bank = args.bank or folder / "bank"
    if not args.bank:
        shape = {"num_objects": 8, "region": "0.5x0.5", "order": "random"}
        cg.generate(
            bank, pool=args.pool, num_scenes=args.num_episodes, render=False, max_files=0, **shape
        )
    found = cg.load_bank(bank)
    rows = []
    for robot, task, physics in product(args.robots, args.tasks, args.physics):
        env = cg.robot.make_env(task, found, robot, action="joint_delta", physics=physics)
        costs = [f"{each:.1f}" for each in cost(env)]
        for is_scripted in (False, True):
            ends = Counter(run_episode(env, seed, is_scripted) for seed in range(args.num_episodes))
            causes = ", ".join(f"{name} {n}" for name, n in ends.most_common() if name != "success")
            name = "scripted" if is_scripted else "random"
            wins = f"{ends['success']} of {args.num_episodes}"
            rows.append((robot, task, physics, name, wins, causes or "-", *costs))
            print(*rows[-1], flush=True)
    head = ("robot", "task", "physics", "policy", "success", "failures", "ms a reset", "ms a step")
    text = prose(
        f"""{len(found)} scenes, {len(found.names)} objects in the model. A step of control is 50 ms of
        simulated time; both costs are CPU-milliseconds, judge and observation of the state included."""
    )
    return f"## Environments of the robot\n\n{text}\n\n{table(head, rows)}"


def main(args: RobotEnvironments) -> None:
    """Measures and reports."""
    with tempfile.TemporaryDirectory() as folder:
        report(
            "robot_env",
            body_of(args, Path(folder)),
            write=args.write,
            packages=("mujoco", "gymnasium"),
        )


if __name__ == "__main__":
    main(tyro.cli(RobotEnvironments))
