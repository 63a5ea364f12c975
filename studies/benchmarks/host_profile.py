"""Where the CPU's time goes while scenes are sampled, and while a policy is trained.

    python -m studies.benchmarks.host_profile [--write]

CPU-seconds of the whole process, all threads, in each piece of the work: one piece runs at a time.
Compilation and the first block of scenes, or the first update, are left out.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import jax
import numpy as np
import tyro

from cluttergen_jax.generation import make_sampler
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.ppo.ppo import PPO
from cluttergen_jax.learning.training.presets import PRESETS, Settings
from cluttergen_jax.physics import native, simulations
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.rollout import BLOCK_SIZE, Rollout, blocks_of, sample_blocks
from cluttergen_jax.plots import new_figure, prepare, save
from cluttergen_jax.scene.bank.table import table_of
from studies.benchmarks.section import IMAGES, prose, report, table
from studies.plots import add_legend

STEPS = "MuJoCo's steps"
CONTACTS = "contacts at rest"
PHYSICS = "judging and copying (NumPy)"
SEARCH = "proposals (XLA)"
RULES = "rules (XLA)"
ROWS = "rows (Python)"
REST = "the rest"
ACTING = "encoder, network and rules (XLA)"
UPDATE = "gradient steps (XLA)"

_PIECES = (
    (simulations.Simulations, "run", STEPS),
    (native.NativePhysics, "at_rest", CONTACTS),
    (native.NativePhysics, "settle_batch", PHYSICS),
    (native.NativePhysics, "stand_batch", PHYSICS),
)


@dataclass(frozen=True)
class Profile:
    """Measure shares of CPU time.

    Attributes:
      methods: that sample; presets: that train, for two updates after the first.
      pool: name or folder.
      num_blocks: of 256 scenes, after the first one.
      write: renew this program's section of reports/benchmarks.md, and its picture.
    """

    methods: tuple[str, ...] = ("clear", "drop", "guided")
    presets: tuple[str, ...] = ("cpu", "paper_cpu")
    pool: str = "dining"
    num_blocks: int = 3
    write: bool = False


class Clock:
    """CPU-seconds by piece; what a piece calls is counted there alone."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._inner: list[float] = []

    @contextmanager
    def piece(self, name: str) -> Iterator[None]:
        """Counts what happens meanwhile."""
        started = time.process_time()
        self._inner.append(0.0)
        try:
            yield
        finally:
            passed = time.process_time() - started
            self.seconds[name] += passed - self._inner.pop()
            if self._inner:
                self._inner[-1] += passed

    def counting(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """The function, its time counted until its results are there."""

        def counted(*args: Any, **given: Any) -> Any:
            with self.piece(name):
                return jax.block_until_ready(function(*args, **given))

        return counted

    def watch(self, stack: ExitStack, owner: Any, method: str, name: str) -> None:
        """Counts the calls of a method until the stack is left."""
        stack.enter_context(
            patch.object(owner, method, self.counting(getattr(owner, method), name))
        )


def sampling(method: str, pool: str, num_blocks: int) -> dict[str, float]:
    """CPU-milliseconds a finished scene that stands, by piece."""
    clock = Clock()
    sampler = make_sampler(pool=pool, method=method)
    geometry = sampler.problem.rules.geometry
    to_rows = clock.counting(table_of, ROWS)
    made = Rollout.__init__

    def watched(rollout: Rollout, *args: Any, **given: Any) -> None:
        made(rollout, *args, **given)
        for name in ("_begin", "_propose"):
            setattr(rollout, name, clock.counting(getattr(rollout, name), SEARCH))
        for name in ("_judge", "_conclude", "_finish"):
            setattr(rollout, name, clock.counting(getattr(rollout, name), RULES))

    num_valid = 0
    started = 0.0
    with ExitStack() as stack:
        stack.enter_context(patch.object(Rollout, "__init__", watched))
        for piece in _PIECES:
            clock.watch(stack, *piece)
        blocks = blocks_of((num_blocks + 1) * BLOCK_SIZE)
        for block, indices, scenes in sample_blocks(sampler.steps, blocks, seed=0):
            to_rows(indices, scenes, sampler.names, np.asarray(geometry.half_extents))
            if block == 0:
                clock.seconds.clear()
                started = time.process_time()
            else:
                num_valid += int(scenes.is_success.sum())
    seconds = dict(clock.seconds)
    seconds[REST] = time.process_time() - started - sum(seconds.values())
    return {name: 1e3 * value / num_valid for name, value in seconds.items()}


def training(preset: str, pool: str, num_updates: int = 2) -> dict[str, float]:
    """CPU-milliseconds an attempt by piece."""
    clock = Clock()
    with ExitStack() as stack:
        for piece in _PIECES:
            clock.watch(stack, *piece)
        return _trained(clock, PRESETS[preset](), pool, num_updates)


def _trained(clock: Clock, settings: Settings, pool: str, num_updates: int) -> dict[str, float]:
    whole = Clock()
    stability = settings.stability
    problem = make_problem(
        ProblemConfig(pool=pool, placement=settings.placement, stability=stability)
    )
    agent = make_agent(problem.rules, settings.network)
    ppo = PPO(
        PlacementEnv(problem.rules, agent.observation),
        agent.apply,
        settings.ppo,
        None,
        agent.encode,
    )
    key = jax.random.key(0)
    params = agent.init(key, jax.eval_shape(ppo.env.reset, key).obs)
    state = jax.jit(ppo.start)(key, params)
    update = jax.jit(ppo.update)
    roll_out = jax.jit(lambda state: ppo._roll_out(state.params, state.env, key)[0].reward)
    jax.block_until_ready(roll_out(state))
    state = jax.block_until_ready(update(state)[0])
    clock.seconds.clear()
    for _ in range(num_updates):
        clock.counting(roll_out, ACTING)(state)
        state = whole.counting(update, UPDATE)(state)[0]
    num_attempts = num_updates * settings.ppo.batch_size
    # The physics was counted twice: in the rollout alone, and in the one of the update.
    shares = {name: clock.seconds[name] / 2 for name in (STEPS, CONTACTS, PHYSICS)}
    shares[ACTING] = clock.seconds[ACTING]
    shares[UPDATE] = whole.seconds[UPDATE] - sum(shares.values())
    return {name: 1e3 * seconds / num_attempts for name, seconds in shares.items()}


def _text(unit: str, found: dict[str, dict[str, float]]) -> str:
    """Milliseconds of CPU time by piece."""
    pieces = list(dict.fromkeys(name for shares in found.values() for name in shares))
    rows = []
    for name, shares in found.items():
        total = sum(shares.values())
        cells = [f"{shares[each]:.2f}" if each in shares else "-" for each in pieces]
        rows.append([name, f"{1e3 / total:,.0f}", f"{total:.2f}", *cells])
    return table(["", f"{unit}s per CPU-second", f"CPU ms per {unit}", *pieces], rows)


def _draw(found: dict[str, dict[str, dict[str, float]]], stem: Path) -> None:
    figure = new_figure(9.0, 3.2)
    pieces = dict.fromkeys(
        name for rows in found.values() for shares in rows.values() for name in shares
    )
    colours = {name: f"C{number}" for number, name in enumerate(pieces)}
    for place, (title, rows) in enumerate(found.items()):
        axis = figure.add_subplot(1, len(found), place + 1)
        prepare(axis, title, "share of CPU time, %")
        for row, shares in enumerate(rows.values()):
            left = 0.0
            total = sum(shares.values())
            for name, value in shares.items():
                axis.barh(row, 100 * value / total, left=left, label=name, color=colours[name])
                left += 100 * value / total
        axis.set_yticks(range(len(rows)), list(rows))
        axis.invert_yaxis()
    add_legend(figure)
    save(figure, stem, ("png",))


def main(options: Profile) -> None:
    """Measures, prints, and renews the section and the picture if asked."""
    sampled = {name: sampling(name, options.pool, options.num_blocks) for name in options.methods}
    trained = {name: training(name, options.pool) for name in options.presets}
    about = prose(
        f"""Ten objects of {options.pool} on the usual table: {options.num_blocks * BLOCK_SIZE} scenes a
        method, without files, by scene that stands; and training by attempt, at its beginning."""
    )
    text = "\n\n".join(
        ["## Where the time goes", about, _text("scene", sampled), _text("attempt", trained)]
    )
    report("profile", f"{text}\n\n![Shares of CPU time](images/profile.png)", write=options.write)
    if options.write:
        _draw({"scenes": sampled, "training": trained}, IMAGES / "profile")


if __name__ == "__main__":
    main(tyro.cli(Profile))
