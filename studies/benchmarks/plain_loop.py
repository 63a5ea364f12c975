"""Against what a student writes in an afternoon: a loop that drops objects and lets them settle.

    python -m studies.benchmarks.plain_loop [--write]

The loop is plain MuJoCo and written to be quick: a free spot is looked for with MuJoCo's own contacts before
anything is simulated, what is placed sleeps until it is touched, and an object that fails is tried again. Its
scenes are judged by the last check that ours pass, with both detectors. One thread each; ours is the whole
command, files included, less the time of its first 256 scenes: compiling and the start do not count.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import tyro

from cluttergen_jax.generation import make_sampler
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.simulations import sleeping_model
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.types import Verdict
from studies.benchmarks.section import ROOT, prose, report, table
from studies.benchmarks.waiting import Version

_BLOCK = 256
_ATTEMPTS = 5
_SPOTS = 100
_STEPS = 60
_QUIET = 20
_RELEASE = 0.001


Case = tuple[str, str, int]
"""A pool, a support and a number of objects."""


@dataclass(frozen=True)
class PlainLoop:
    """What is compared.

    Attributes:
      methods: of ours.
      cases: of which scenes are made.
      scenes: of each case that ours makes, in whole blocks; the loop makes as many as it can in `seconds`.
      seconds: CPU-seconds of the loop in each round.
      rounds: in which the two take turns.
      write: put the table into reports/benchmarks.md.
    """

    methods: tuple[str, ...] = ("clear", "spread", "guided")
    cases: tuple[Case, ...] = (
        ("dining", "table", 10),
        ("all", "table", 20),
        ("all", "table", 30),
        ("all", "table-0.40x0.50", 20),
    )
    scenes: int = 768
    seconds: float = 20.0
    rounds: int = 2
    write: bool = False


class Loop:
    """Drops objects on a table one after another; a plain loop over `mj_step`."""

    def __init__(self, pool: str, support: str, num_objects: int) -> None:
        sampler = make_sampler(
            pool=pool, support=support, method="clear", num_objects=num_objects, num_threads=1
        )
        rules = sampler.problem.rules
        assert isinstance(rules.simulator, NativePhysics)
        self.engine = rules.simulator
        self.layout = self.engine.layout
        self.num_objects = num_objects
        self.half = np.asarray(sampler.problem.region.half_extents, np.float64)
        self.height = np.asarray(rules.geometry.half_extents, np.float64)[:, 2]
        self.model = sleeping_model(self.layout.model)
        self.data = mujoco.MjData(self.model)

    def scene(self, rng: np.random.Generator) -> np.ndarray | None:
        """Poses f64[K, 7] of a scene to be checked, NaN where nothing is; None if an object found no room."""
        num_known = self.layout.num_objects
        poses = self.layout.parked
        chosen = rng.permutation(num_known)[: self.num_objects]
        is_placed = np.zeros(num_known, bool)
        for index in chosen:
            is_placed[index] = True
            for _ in range(_ATTEMPTS):
                settled = self._attempt(rng, poses, is_placed, int(index))
                if settled is not None:
                    poses = settled
                    break
            else:
                return None
        return np.where(is_placed[:, None], poses, np.nan)

    def _attempt(
        self, rng: np.random.Generator, poses: np.ndarray, is_placed: np.ndarray, index: int
    ) -> np.ndarray | None:
        model = self.model
        data = self.data
        model.qpos0[:] = poses.ravel()
        model.tree_sleep_policy[:] = mujoco.mjtSleepPolicy.mjSLEEP_INIT
        model.tree_sleep_policy[index] = mujoco.mjtSleepPolicy.mjSLEEP_NEVER
        mujoco.mj_resetData(model, data)
        own = data.qpos[7 * index : 7 * index + 7]
        for _ in range(_SPOTS):
            yaw = rng.uniform(0, 2 * np.pi)
            own[:2] = rng.uniform(-self.half, self.half)
            own[2] = self.layout.top + self.height[index] + _RELEASE
            own[3:] = np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            if not (self.layout.geom_object[data.contact.geom] == index).any():
                break
        else:
            return None
        start = data.qpos.reshape(-1, 7).copy()
        velocity = data.qvel[6 * index : 6 * index + 6]
        quiet = 0
        before = np.zeros(6)
        for _ in range(_STEPS):
            mujoco.mj_step(model, data)
            change = velocity - before
            before = velocity.copy()
            is_quiet = np.abs(velocity).max() < 0.005 and np.abs(change).max() < 1 / 240
            quiet = quiet + 1 if is_quiet else 0
            if quiet == _QUIET:
                break
        after = data.qpos.reshape(-1, 7)
        moved = np.linalg.norm(after[:, :3] - start[:, :3], axis=1)
        moved[index] = 0
        is_down = after[index, 2] < self.layout.top
        if quiet < _QUIET or moved[is_placed].max() > 0.002 or is_down:
            return None
        return after.copy()


class Rate(NamedTuple):
    """Scenes that were begun, those that stand, and CPU-seconds."""

    begun: int
    stand: int
    seconds: float


def loop_rate(loop: Loop, seconds: float, seed: int) -> Rate:
    """Of as many scenes as the loop makes in some CPU-seconds."""
    rng = np.random.default_rng(seed)
    started = time.process_time()
    begun = 0
    stand = 0
    made: list[np.ndarray] = []
    with tempfile.TemporaryDirectory() as folder:
        while time.process_time() - started < seconds:
            poses = loop.scene(rng)
            begun += 1
            if poses is not None:
                made.append(poses)
            if len(made) == 64:
                stand += _num_standing(loop, made)
                np.savez(Path(folder, f"{begun}.npz"), poses=np.stack(made))
                made = []
        stand += _num_standing(loop, made)
    return Rate(begun, stand, time.process_time() - started)


def _num_standing(loop: Loop, made: Sequence[np.ndarray]) -> int:
    if not made:
        return 0
    poses = np.stack(made)
    is_placed = np.isfinite(poses[..., 0])
    poses = np.where(is_placed[..., None], poses, loop.layout.parked)
    checked = loop.engine.stand_batch(poses, is_placed, np.ones(len(made), bool))
    return int((checked.verdict == int(Verdict.STABLE)).sum())


def our_rate(version: Version, method: str, case: Case, scenes: int, seed: int) -> Rate:
    """Of the scenes after the first block."""
    used = []
    stood = []
    # The first run compiles, if nobody has yet.
    for count in (_BLOCK, _BLOCK, scenes):
        words = ["generate", "--pool", case[0], "--support", case[1], "--num-objects", str(case[2])]
        words += ["--method", method, "--num-scenes", str(count), "--max-files", str(count)]
        words += ["--threads", "1", "--no-render", "--seed", str(seed), "--out", "OUT"]
        seconds = version.seconds(words)
        assert seconds is not None, words
        used.append(seconds)
        rows = read_bank(version.folder / "out").tables()
        stood.append(sum(int(np.asarray(each["is_success"]).sum()) for each in rows))
    return Rate(scenes - _BLOCK, stood[2] - stood[1], used[2] - used[1])


def compared(config: PlainLoop, case: Case) -> list[list[str]]:
    """Rows of a case."""
    loop = Loop(*case)
    rates: dict[str, list[Rate]] = {"the loop": [], **{each: [] for each in config.methods}}
    with tempfile.TemporaryDirectory() as folder:
        version = Version(ROOT, Path(folder))
        for turn in range(config.rounds):
            rates["the loop"].append(loop_rate(loop, config.seconds, turn))
            for method in config.methods:
                rates[method].append(our_rate(version, method, case, config.scenes, turn))
    rows = []
    base = _median(rates["the loop"])
    for name, found in rates.items():
        begun = sum(each.begun for each in found)
        stand = sum(each.stand for each in found)
        rate = _median(found)
        ratio = f"{rate / base:.1f}" if base else "-"
        what = f"{case[2]} of {Path(case[0]).name}, {case[1]}"
        rows.append([what, name, f"{stand} of {begun}", f"{rate:.2f}", ratio])
    return rows


def _median(found: Sequence[Rate]) -> float:
    return float(np.median([each.stand / each.seconds for each in found]))


def main(config: PlainLoop) -> None:
    """Measures, prints, and renews the section if asked."""
    rows = [row for case in config.cases for row in compared(config, case)]
    heads = ["case", "made by", "stand", "scenes a CPU-second", "of the loop's"]
    about = prose(
        f"""Scenes that stand a CPU-second of one thread, the median of {config.rounds} rounds in which all
        take turns, files included. The loop looks for a free spot with MuJoCo's own contacts, {_SPOTS} times
        at most, and tries an object {_ATTEMPTS} times; its scenes have to pass our last check."""
    )
    text = "\n\n".join(["## Against a plain loop", about, table(heads, rows)])
    report("plain_loop", text, write=config.write)


if __name__ == "__main__":
    main(tyro.cli(PlainLoop))
