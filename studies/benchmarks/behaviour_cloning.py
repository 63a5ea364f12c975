"""Behaviour cloning: a policy imitates scripted episodes of the robot's environment, and is judged in it.

    python -m studies.benchmarks.behaviour_cloning --out out/cloning [--tasks place grasp] [--write]

Episodes are kept one by one in `out`, so that the same command resumes; the policy is in `imitation`. 500 of
`place` take 20 CPU-minutes, learning from them about as many. Scenes to learn from and to be judged in are of
two banks, and of unequal seeds. Only episodes in which the scripted policy succeeded are imitated. The policy
is told where the object shall go, as the scripted one is.
"""

from __future__ import annotations

import io
import multiprocessing
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.downstream.environments.env import RobotEnv
from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import Progress
from studies.benchmarks.imitation import Policy, examples_of, fit, state_of
from studies.benchmarks.section import prose, report, table

# m/s and rad/s of the tool on its way to a key pose, and share of the joints' speed, on average.
_SPEED = 0.25
_TURN_SPEED = 1.0
_JOINT_SHARE = 0.5

_SLOWER = 0.5
"""By how much with something in the hand."""
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""About the approach."""
# Of inverse kinematics; radians between a way of joints and a straight one.
_NUM_SOLUTIONS = 6
_NEAR = 0.5

# Share of the gripper that changes in a step; steps of rest before the next look.
_GRIP_STEP = 0.12
_WAIT = 4

_FRESH = 1_000_000
"""Seeds of trials begin here."""


@dataclass(frozen=True)
class BehaviourCloning:
    """What is learnt and judged.

    Attributes:
      out: the folder of banks and episodes.
      tasks: of the environment.
      num_episodes: that are imitated; num_trials: in which the network is judged.
      robot, pool, num_objects: of the scenes.
      num_updates: of the network; width: of its layers.
      workers: processes that make episodes; 0 for each core.
      write: put the table into reports/benchmarks.md.
    """

    out: Path = Path("out/cloning")
    tasks: tuple[str, ...] = ("place",)
    num_episodes: int = 500
    num_trials: int = 50
    robot: str = "panda"
    pool: str = "household"
    num_objects: int = 8
    num_updates: int = 24_000
    width: int = 384
    workers: int = 0
    write: bool = False


def make_env(args: BehaviourCloning, task: str, bank: Path) -> RobotEnv:
    """The environment in which episodes are made and trials are judged."""
    found: Any = task
    return cg.make_robot_env(found, bank, args.robot, action="joint_delta", physics="learning")


def _bank(args: BehaviourCloning, name: str, seed: int, num_scenes: int) -> Path:
    path = args.out / name
    shape = {"num_objects": args.num_objects, "region": "0.5x0.5", "order": "random"}
    cg.generate(
        path, pool=args.pool, num_scenes=num_scenes, seed=seed, render=False, max_files=0, **shape
    )
    return path


def _make_episode(env: RobotEnv, seed: int, path: Path) -> None:
    """One scripted episode: what was seen, done and asked of the arm in each of T steps, and its end."""
    seen, _ = env.reset(seed=seed)
    assert env.start is not None
    kept: dict[str, list[np.ndarray]] = {
        "agent_pos": [],
        "objects": [],
        "action": [],
        "set_point": [],
    }
    is_success = False
    goal = env.start.goals[env.start.target]
    for action in cg.scripted_actions(env):
        assert env.execution is not None
        now = (
            seen["agent_pos"],
            seen["environment_state"].reshape(-1, 11),
            action,
            env.execution.set_point,
        )
        for name, value in zip(kept, now, strict=True):
            kept[name].append(np.array(value))
        seen, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            is_success = bool(info["is_success"])
            break
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, goal=goal, is_success=is_success, **{k: np.array(v) for k, v in kept.items()}
    )
    write_atomically(path, buffer.getvalue())


def _work(args: BehaviourCloning, task: str, bank: Path, left: list[tuple[int, Path]]) -> None:
    env = make_env(args, task, bank)
    for seed, path in left:
        _make_episode(env, seed, path)


def collect(
    args: BehaviourCloning, task: str, bank: Path
) -> tuple[list[dict[str, np.ndarray]], int]:
    """The successful episodes, and how many were made."""
    folder = args.out / f"{args.robot}-{task}"
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{seed:06d}.npz" for seed in range(args.num_episodes)]
    left = [(seed, path) for seed, path in enumerate(paths) if not path.exists()]
    workers = args.workers or os.cpu_count() or 1
    context = multiprocessing.get_context("spawn")
    processes = [
        context.Process(target=_work, args=(args, task, bank, left[first::workers]))
        for first in range(min(workers, len(left)))
    ]
    for each in processes:
        each.start()
    with Progress(task, len(left), "episode") as progress:
        made = 0
        while processes and any(each.is_alive() for each in processes):
            processes[0].join(5.0)
            now = sum(path.exists() for _, path in left)
            progress.update(now - made)
            made = now
    for each in processes:
        each.join()
        if each.exitcode:
            raise SystemExit(f"a worker ended with status {each.exitcode}")
    episodes = [dict(np.load(path, allow_pickle=False)) for path in paths]
    return [each for each in episodes if each["is_success"]], len(episodes)


def learn(args: BehaviourCloning, env: RobotEnv, episodes: list[dict[str, np.ndarray]]) -> Policy:
    """The policy that imitates them."""
    arm = ArmKinematics(env.world.base, env.world.description)
    tools = [np.array([arm.tool(joints) for joints in each["set_point"]]) for each in episodes]
    examples = [examples_of(*each) for each in zip(episodes, tools, strict=True)]
    return fit(examples, args.num_updates, args.width)


def cloned_actions(
    env: RobotEnv, policy: Policy, seen: dict[str, Any], key: Any
) -> Iterator[np.ndarray]:
    """The actions that bring the tool straight to the next key pose, and then the gripper to its share."""
    start = env.start
    run = env.execution
    assert start is not None
    assert run is not None
    arm = ArmKinematics(env.world.base, env.world.description)
    grip = float(env.action_of(run.data.ctrl)[-1])
    objects = seen["environment_state"].reshape(1, -1, 11)
    goal = start.goals[start.target]
    state = state_of(seen["agent_pos"][None], objects, goal[None], np.array([grip]))
    wanted, wanted_grip = jax.device_get(policy.next_key(state, key))
    for joints in _straight_path(
        arm, env, run.set_point.copy(), wanted.astype(np.float64), grip < 0
    ):
        ctrl = run.data.ctrl.copy()
        ctrl[env.world.robot.ctrl] = joints
        yield np.append(env.action_of(ctrl)[:-1], grip).astype(np.float32)
    still = np.zeros(env.action_space.shape[0] - 1, np.float32)
    steps = int(np.ceil(abs(float(wanted_grip) - grip) / _GRIP_STEP))
    shares = np.linspace(grip, float(np.clip(wanted_grip, -1, 1)), steps + 1)
    for share in [*shares[1:], *[shares[-1]] * _WAIT]:
        yield np.append(still, share).astype(np.float32)


def _straight_path(
    arm: ArmKinematics, env: RobotEnv, start: np.ndarray, wanted: np.ndarray, is_holding: bool
) -> Iterator[np.ndarray]:
    """Joints f64[n] of each step of a straight way; an empty hand may come turned by half: it is the same.

    Where the straight way cannot be reached joints change evenly; where its end cannot, nothing happens.
    """
    ends = [wanted] if is_holding else [wanted, wanted @ _HALF_TURN]
    found = [(end, joints) for end in ends for joints in _solutions(arm, end, start)]
    if not found:
        return
    end, joints = min(found, key=lambda each: float(np.abs(each[1] - start).max()))
    now = arm.tool(start)
    turn = Rotation.from_matrix(now[:3, :3].T @ end[:3, :3]).as_rotvec()
    away = end[:3, 3] - now[:3, 3]
    longest = float((np.abs(joints - start) / np.array(env.world.description.arm.speed)).max())
    seconds = max(
        np.linalg.norm(away) / _SPEED, np.linalg.norm(turn) / _TURN_SPEED, longest / _JOINT_SHARE
    ) / (_SLOWER if is_holding else 1.0)
    number = int(np.ceil(seconds * env.metadata["render_fps"])) + 1
    for step in range(1, number + 1):
        share = (step / number) ** 2 * (3 - 2 * step / number)
        between = start + share * (joints - start)
        matrix = now[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
        solved = arm.solve(rigid(matrix, now[:3, 3] + share * away), between)
        is_near = solved is not None and np.abs(solved - between).max() < _NEAR
        yield solved if solved is not None and is_near else between


def _solutions(arm: ArmKinematics, end: np.ndarray, start: np.ndarray) -> list[np.ndarray]:
    near = arm.solve(end, start)
    return [*([] if near is None else [near]), *arm.solutions(end, _NUM_SOLUTIONS)]


def judge(
    args: BehaviourCloning, env: RobotEnv, policy: Policy
) -> tuple[Counter[str], Counter[str], int]:
    """How trials end by the network and by the scripted policy, and in how many the network lifted."""
    cloned = Counter[str]()
    scripted = Counter[str]()
    lifted = 0
    with Progress("trials", args.num_trials, "trial") as progress:
        for trial in range(args.num_trials):
            seen, _ = env.reset(seed=_FRESH + trial)
            start = float(seen["environment_state"][2])
            gained = 0.0
            outcome = ""
            key = jax.random.key(trial)
            while not outcome:
                key = jax.random.fold_in(key, 0)
                for action in cloned_actions(env, policy, seen, key):
                    seen, *_, info = env.step(action)
                    gained = max(gained, float(seen["environment_state"][2]) - start)
                    if outcome := info["outcome"]:
                        break
            cloned[outcome] += 1
            lifted += gained > 0.05
            env.reset(seed=_FRESH + trial)
            outcome = ""
            for action in cg.scripted_actions(env):
                *_, info = env.step(action)
                if outcome := info["outcome"]:
                    break
            scripted[outcome or "given up"] += 1
            progress.update(1, f"{cloned['success']} cloned, {scripted['success']} scripted")
    return cloned, scripted, lifted


def body_of(args: BehaviourCloning) -> str:
    """The section."""
    bank = _bank(args, "bank", 0, min(256, args.num_episodes))
    fresh = _bank(args, "fresh", 1, args.num_trials)
    rows = []
    for task in args.tasks:
        episodes, made = collect(args, task, bank)
        policy = learn(args, make_env(args, task, bank), episodes)
        cloned, scripted, lifted = judge(args, make_env(args, task, fresh), policy)
        causes = ", ".join(f"{name} {n}" for name, n in cloned.most_common() if name != "success")
        share = [f"{each['success']} of {args.num_trials}" for each in (cloned, scripted)]
        steps = sum(len(each["action"]) for each in episodes)
        rows.append(
            (
                task,
                f"{len(episodes)} of {made}",
                f"{steps:,}",
                share[0],
                str(lifted),
                causes or "-",
                share[1],
            )
        )
        print(*rows[-1], flush=True)
    head = ("task", "imitated", "steps", "cloned", "lifted", "its failures", "scripted")
    text = prose(
        f"""`{args.robot}`, {args.pool}, {args.num_objects} objects, physics `learning`; {args.num_updates:,}
        updates of a policy that sees the tool, true poses and the goal, and draws the next key pose by flow
        matching. Trials are of a bank of other scenes; `scripted` in the same trials."""
    )
    return f"## Behaviour cloning\n\n{text}\n\n{table(head, rows)}"


def main(args: BehaviourCloning) -> None:
    """Measures and reports."""
    report("behaviour_cloning", body_of(args), write=args.write, packages=("mujoco", "jax", "flax"))


if __name__ == "__main__":
    main(tyro.cli(BehaviourCloning))
