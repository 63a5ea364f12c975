"""Behaviour cloning: a network imitates scripted episodes of the robot's environment, and is judged in it.

    python -m benchmarks.behaviour_cloning --out out/cloning [--tasks place grasp] [--write]

Episodes are kept one by one in `out`, so that the same command resumes. 500 of `place` take about 80
CPU-minutes, of `grasp` 25; training 5. Scenes to learn from and to be judged in are of two banks, and of
unequal seeds. Only episodes in which the scripted policy succeeded are imitated.
"""

from __future__ import annotations

import io
import multiprocessing
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro

import cluttergen_jax as cg
from benchmarks.section import prose, report, table
from cluttergen_jax.downstream.environments.env import RobotEnv
from cluttergen_jax.files import write_atomically
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.progress import Progress

CHUNK, EXECUTED = 10, 5
"""Steps of control that are predicted at once, and how many of them are made before the next look."""
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
      num_updates: of batches of 512 steps; width: of the network.
      workers: processes that make episodes; 0 for each core.
      write: put the table into reports/benchmarks.md.
    """

    out: Path = Path("out/cloning")
    tasks: tuple[str, ...] = ("place", "grasp")
    num_episodes: int = 500
    num_trials: int = 50
    robot: str = "panda"
    pool: str = "household"
    num_objects: int = 8
    num_updates: int = 30_000
    width: int = 512
    workers: int = 0
    write: bool = False


class Imitator(nn.Module):
    """Observation f[D] to the changes of the set-points in the next `CHUNK` steps, f[CHUNK, A], -1 to 1."""

    width: int
    num_actions: int

    @nn.compact
    def __call__(self, seen: jax.Array) -> jax.Array:
        """See class."""
        x = seen
        for _ in range(4):
            x = nn.gelu(nn.LayerNorm()(nn.Dense(self.width)(x)))
        out = nn.Dense(CHUNK * self.num_actions)(x)
        return jnp.tanh(out).reshape(*seen.shape[:-1], CHUNK, self.num_actions)


def features(seen: dict[str, np.ndarray], num_joints: int) -> np.ndarray:
    """f32[D]: the arm, the tool as its matrix, objects about the target, and the target about the tool."""
    arm, objects = seen["agent_pos"], seen["environment_state"].reshape(-1, 11)
    tool, target = arm[-7:], objects[0]
    turn = rotation_matrix(tool[3:].astype(np.float64))
    away = turn.T @ (target[:3] - tool[:3])
    rows = [
        np.concatenate([(row[:3] - target[:3]) * row[10], rotation_matrix(row[3:7])[:, :2].ravel(), row[7:]])
        if row[10]
        else np.zeros(13)
        for row in objects.astype(np.float64)
    ]
    held = np.concatenate([arm[: num_joints * 2 + 1], tool[:3], turn.ravel(), away, target[:3]])
    return np.concatenate([held, *rows]).astype(np.float32)


def make_env(args: BehaviourCloning, task: str, bank: Path) -> RobotEnv:
    """The environment in which episodes are made and trials are judged."""
    found: Any = task
    return cg.make_robot_env(found, bank, args.robot, action="joint_delta", physics="learning")


def _bank(args: BehaviourCloning, name: str, seed: int, num_scenes: int) -> Path:
    path = args.out / name
    shape = {"num_objects": args.num_objects, "region": "0.5x0.5", "order": "random"}
    cg.generate(path, pool=args.pool, num_scenes=num_scenes, seed=seed, render=False, max_files=0, **shape)
    return path


def _make_episode(env: RobotEnv, seed: int, path: Path) -> None:
    """One scripted episode: f32[T, D], f32[T, A] and whether it succeeded."""
    seen, _ = env.reset(seed=seed)
    number, rows, actions, is_success = len(env.world.robot.qpos), [], [], False
    for action in cg.scripted_actions(env):
        rows.append(features(seen, number))
        actions.append(action)
        seen, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            is_success = bool(info["is_success"])
            break
    write_atomically(path, _packed(np.array(rows), np.array(actions), is_success))


def _packed(rows: np.ndarray, actions: np.ndarray, is_success: bool) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, rows=rows, actions=actions, is_success=is_success)
    return buffer.getvalue()


def _work(args: BehaviourCloning, task: str, bank: Path, left: list[tuple[int, Path]]) -> None:
    env = make_env(args, task, bank)
    for seed, path in left:
        _make_episode(env, seed, path)


def collect(args: BehaviourCloning, task: str, bank: Path) -> tuple[list[np.ndarray], list[np.ndarray], int]:
    """Rows and actions of each successful episode, and how many were made."""
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
    files = [np.load(path, allow_pickle=False) for path in paths]
    good = [each for each in files if each["is_success"]]
    return [each["rows"] for each in good], [each["actions"] for each in good], len(files)


def fit(args: BehaviourCloning, rows: list[np.ndarray], actions: list[np.ndarray]) -> Any:
    """A function of features f[D] to actions f[CHUNK, A]."""
    inputs = np.concatenate(rows)
    mean, spread = inputs.mean(0), inputs.std(0) + 1e-4
    # After the end of an episode the last action holds on.
    padded = [np.concatenate([each, np.repeat(each[-1:], CHUNK, 0)]) for each in actions]
    targets = np.concatenate(
        [
            np.stack([whole[k : k + len(each)] for k in range(CHUNK)], axis=1)
            for whole, each in zip(padded, actions, strict=True)
        ]
    )
    model = Imitator(args.width, targets.shape[-1])
    params = model.init(jax.random.key(0), inputs[:1])
    schedule = optax.cosine_decay_schedule(1e-3, args.num_updates)
    optimizer = optax.adamw(schedule, weight_decay=1e-4)
    state, rng = optimizer.init(params), np.random.default_rng(0)

    @jax.jit
    def update(params: Any, state: Any, seen: jax.Array, wanted: jax.Array) -> tuple[Any, Any, jax.Array]:
        def loss(params: Any) -> jax.Array:
            return jnp.abs(model.apply(params, seen) - wanted).mean()

        value, slope = jax.value_and_grad(loss)(params)
        change, state = optimizer.update(slope, state, params)
        return optax.apply_updates(params, change), state, value

    with Progress("training", args.num_updates, "update") as progress:
        for _ in range(args.num_updates):
            chosen = rng.integers(len(inputs), size=512)
            params, state, _ = update(params, state, (inputs[chosen] - mean) / spread, targets[chosen])
            progress.update(1)
    act = jax.jit(lambda seen: model.apply(params, (seen - mean) / spread))
    return lambda seen: np.asarray(act(seen))


def judge(args: BehaviourCloning, env: RobotEnv, act: Any) -> tuple[Counter[str], Counter[str], int]:
    """How trials end by the network and by the scripted policy, and in how many the network lifted."""
    cloned, scripted, lifted = Counter[str](), Counter[str](), 0
    number = len(env.world.robot.qpos)
    with Progress("trials", args.num_trials, "trial") as progress:
        for trial in range(args.num_trials):
            seen, _ = env.reset(seed=_FRESH + trial)
            start, gained, outcome = float(seen["environment_state"][2]), 0.0, ""
            while not outcome:
                for action in act(features(seen, number))[:EXECUTED]:
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
            progress.update(1)
    return cloned, scripted, lifted


def body_of(args: BehaviourCloning) -> str:
    """The section."""
    learn = _bank(args, "bank", 0, min(256, args.num_episodes))
    fresh = _bank(args, "fresh", 1, args.num_trials)
    rows = []
    for task in args.tasks:
        seen, actions, made = collect(args, task, learn)
        act = fit(args, seen, actions)
        cloned, scripted, lifted = judge(args, make_env(args, task, fresh), act)
        causes = ", ".join(f"{name} {n}" for name, n in cloned.most_common() if name != "success")
        share = [f"{each['success']} of {args.num_trials}" for each in (cloned, scripted)]
        steps = sum(map(len, actions))
        rows.append(
            (task, f"{len(seen)} of {made}", f"{steps:,}", share[0], str(lifted), causes or "-", share[1])
        )
        print(*rows[-1], flush=True)
    head = ("task", "imitated", "steps", "cloned", "lifted", "its failures", "scripted")
    text = prose(
        f"""`{args.robot}`, {args.pool}, {args.num_objects} objects, physics `learning`; {args.num_updates:,}
        updates of a network of four layers, {args.width} wide, that sees joints and true poses and predicts
        the next {CHUNK} changes of set-points. Trials are of a bank of other scenes; `scripted` in the same
        trials. In `place` nobody tells the network where to put the object."""
    )
    return f"## Behaviour cloning\n\n{text}\n\n{table(head, rows)}"


def main(args: BehaviourCloning) -> None:
    """Measures and reports."""
    report("behaviour_cloning", body_of(args), write=args.write, packages=("mujoco", "jax", "flax"))


if __name__ == "__main__":
    main(tyro.cli(BehaviourCloning))
