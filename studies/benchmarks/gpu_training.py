"""Parts of `benchmarks.gpu` about training: where an update's time goes, time to 0.95, sweeps, full size."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.learning.agents import make_agent
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.ppo.ppo import PPO, TrainState
from cluttergen_jax.learning.training.presets import gpu as preset_gpu
from cluttergen_jax.learning.training.presets import paper as preset_paper
from cluttergen_jax.learning.training.run_folder import Interrupt
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from studies.benchmarks.ablation import Row as Run
from studies.benchmarks.ablation import train
from studies.benchmarks.rows import Cases, Row
from studies.benchmarks.trained import first_good


@dataclass(frozen=True)
class Scale:
    """How much is trained.

    Attributes:
      pool: name or folder; support: name; num_objects: of a scene.
      engine: "auto", "native", "warp" or "jax".
      num_envs: of the updates that are taken apart; None for the preset's.
      repeats: how often each of their parts is timed.
      num_attempts: of a run that is to come to 0.95; paper_attempts: of the paper's, None for all of them.
      runs: what is swept. ppo: changes of all of them, and network: of the paper's, for a miniature.
      evaluates: episodes of the last evaluation.
    """

    pool: str = "dining"
    support: str = "table"
    num_objects: int = 10
    engine: str = "auto"
    num_envs: tuple[int | None, ...] = (None, 4096)
    repeats: int = 5
    num_attempts: int = 400_000
    paper_attempts: int | None = None
    runs: tuple[Run, ...] = ()
    ppo: tuple[tuple[str, Any], ...] = ()
    network: tuple[tuple[str, Any], ...] = ()
    evaluates: int = 256


def _run(name: str, **ppo: Any) -> Run:
    title = ", ".join(f"{key} {value:,}" for key, value in ppo.items()) or "preset `gpu`"
    return Run(name, title, preset="gpu", ppo=ppo)


SWEEP = (
    _run("preset"),
    _run("envs-512", num_envs=512, num_steps=16),
    _run("envs-2048", num_envs=2048, num_steps=8),
    _run("envs-4096", num_envs=4096, num_steps=8),
    _run("envs-4096-short", num_envs=4096, num_steps=4),
    _run("minibatches-16", num_minibatches=16),
    _run("minibatches-32", num_minibatches=32),
    _run("epochs-5", num_epochs=5),
    _run("rate-2e-3", learning_rate=2e-3),
    _run("rate-5e-4", learning_rate=5e-4),
    _run("envs-4096-minibatches-32", num_envs=4096, num_steps=8, num_minibatches=32),
    _run(
        "envs-4096-minibatches-32-rate-2e-3", num_envs=4096, num_minibatches=32, learning_rate=2e-3
    ),
    _run("far", discount=0.99, gae_lambda=0.95),
)
"""What preset `gpu` is tuned by; the first is the preset itself."""


class Until(Interrupt):
    """Asks for a stop when the time is up, or once a run's success has come to the goal.

    Attributes:
      was_ctrl_c: it was neither of them.
    """

    def __init__(self, folder: Path, seconds: float, is_goal_enough: bool) -> None:
        self.was_ctrl_c = False
        self._folder = folder
        self._ends = time.monotonic() + seconds
        self._is_goal_enough = is_goal_enough
        super().__init__()

    @property
    def is_asked(self) -> bool:
        """By Ctrl-C, by the clock, or by success."""
        return (
            self.was_ctrl_c
            or time.monotonic() > self._ends
            or (self._is_goal_enough and self.has_goal)
        )

    @is_asked.setter
    def is_asked(self, value: bool) -> None:
        self.was_ctrl_c = value

    @property
    def has_goal(self) -> bool:
        """The success while training has come to 0.95."""
        success = [row["success"] for row in read_rows(self._folder / "progress.csv")]
        return bool(success) and first_good(np.array(success)) is not None


def tune(scale: Scale, out: Path, seconds_left: Callable[[], float]) -> Cases:
    """Runs of preset `gpu` and its changes until they come to 0.95."""
    for run in scale.runs or SWEEP:
        changed = replace(run, ppo={**run.ppo, **dict(scale.ppo)})
        yield (
            run.title,
            partial(_trained, scale, changed, out, seconds_left, scale.num_attempts),
        )


def _trained(
    scale: Scale,
    run: Run,
    out: Path,
    seconds_left: Callable[[], float],
    num_attempts: int,
    encoder: str | None = None,
) -> Row:
    folder = out / run.name
    problem = ProblemConfig(
        pool=scale.pool,
        support=scale.support,
        engine=scale.engine,
        placement=PlacementConfig(num_objects=scale.num_objects),
    )
    until = Until(folder, seconds_left() - _RESERVE, is_goal_enough=run.preset == "gpu")
    try:
        train(run, out, problem, num_attempts, 0, encoder, until, eval_episodes=scale.evaluates)
    except KeyboardInterrupt:
        if until.was_ctrl_c:
            raise
    return figures_of(folder, run.preset == "gpu")


_RESERVE = 20.0
"""Seconds that a run which is stopped by the clock needs to save what it has."""


def figures_of(folder: Path, is_goal_enough: bool) -> Row:
    """How far a run has come."""
    rows = read_rows(folder / "progress.csv")
    success = np.array([row["success"] for row in rows])
    size = rows[0]["attempts"] if rows else 0
    seconds = np.cumsum([size / row["attempts_per_second"] for row in rows])
    good = first_good(success) if len(rows) else None
    found: Row = {
        "attempts": int(rows[-1]["attempts"]) if rows else 0,
        "seconds": float(seconds[-1]) if rows else 0.0,
        "success": float(success[-10:].mean()) if rows else 0.0,
    }
    if good is not None:
        found |= {
            "attempts to 0.95": int(rows[good]["attempts"]),
            "seconds to 0.95": float(seconds[good]),
        }
    if (folder / "policy" / "record.json").exists():
        evaluation = read_record(folder / "policy").get("evaluation")
        if evaluation:
            return found | {"whole check": evaluation["success"]}
    return found if is_goal_enough and good is not None else found | {"goes_on": True}


def paper(scale: Scale, out: Path, seconds_left: Callable[[], float]) -> Cases:
    """Preset `paper` at full size: its encoder, pretrained, then the run itself."""
    network = replace(preset_paper().network, **dict(scale.network))
    yield "encoder", partial(_encoder, network, out / "encoder", scale)
    run = Run("paper", "preset `paper`", variant="beta_free", preset="paper")
    run = replace(run, ppo=dict(scale.ppo), network=dict(scale.network))
    attempts = scale.paper_attempts or preset_paper().ppo.num_attempts
    yield (
        "policy",
        partial(_trained, scale, run, out, seconds_left, attempts, str(out / "encoder")),
    )


def _encoder(network: Any, folder: Path, scale: Scale) -> Row:
    sizes = {
        "features": network.object_features,
        "object_points": network.object_points,
        "num_centroids": network.num_centroids,
        "group_size": network.group_size,
    }
    if scale.network:
        sizes |= {"num_shapes": 2, "num_held_out": 1, "num_epochs": 1}
    started = time.monotonic()
    report = cg.training.pretrain(network.scene_encoder, folder, **sizes)
    return {"accuracy": float(report.accuracy), "seconds": time.monotonic() - started}


def share(scale: Scale) -> Cases:
    """Where the time of an update of preset `gpu` goes."""
    for number in scale.num_envs:
        settings = preset_gpu()
        ppo = replace(settings.ppo, **dict(scale.ppo))
        ppo = replace(ppo, num_envs=number) if number else ppo
        yield f"{ppo.num_envs} environments", partial(_share, scale, replace(settings, ppo=ppo))


def _share(scale: Scale, settings: Any) -> Row:
    """Seconds of one update, and of those parts of it that can be called alone."""
    placement = replace(settings.placement, num_objects=scale.num_objects)
    problem = make_problem(
        ProblemConfig(
            pool=scale.pool,
            support=scale.support,
            engine=scale.engine,
            placement=placement,
            stability=settings.stability,
        )
    )
    agent = make_agent(problem.rules, settings.network)
    env = PlacementEnv(problem.rules, agent.observation)
    ppo = PPO(env, agent.apply, settings.ppo, encode=agent.encode)
    key = jax.random.key(0)
    number = settings.ppo.num_steps
    params = agent.init(key, jax.eval_shape(env.reset, key).obs)
    state = jax.jit(ppo.update)(jax.jit(ppo.start)(key, params))[0]
    act = jax.jit(
        lambda state: agent.apply(state.params, agent.encode(state.params)(state.env.obs))
    )
    action = act(state)[0].sample(key)

    def attempt(state: TrainState) -> Any:
        return jax.vmap(problem.rules.attempt)(state.env.pipeline_state.episode, action)[0]

    parts: dict[str, tuple[Callable[..., Any], int]] = {
        "update": (jax.jit(ppo.update), 1),
        "rollout": (jax.jit(lambda state: ppo._roll_out(state.params, state.env, key)), 1),
        "physics": (jax.jit(attempt), number),
        "network": (act, number),
    }
    seconds = {
        name: times * _median(each, state, scale.repeats) for name, (each, times) in parts.items()
    }
    whole = seconds["update"]
    return {
        "attempts/s": settings.ppo.batch_size / whole,
        "update s": whole,
        "physics": seconds["physics"] / whole,
        "encoder and heads": seconds["network"] / whole,
        "the rest of the rollout": (seconds["rollout"] - seconds["physics"] - seconds["network"])
        / whole,
        "learning": (whole - seconds["rollout"]) / whole,
    }


def _median(function: Callable[..., Any], state: Any, repeats: int) -> float:
    jax.block_until_ready(function(state))
    found = []
    for _ in range(repeats):
        started = time.monotonic()
        jax.block_until_ready(function(state))
        found.append(time.monotonic() - started)
    return float(np.median(found))
