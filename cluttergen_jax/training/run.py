"""One training run: compiled updates, a live display, checkpoints, and Ctrl-C at any time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from cluttergen_jax.agent.checkpoint import read_record, read_state, save_policy, save_state
from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.agent.learner import Learner
from cluttergen_jax.agent.ppo import PPO, TrainState
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.networks.actor_critic import NetworkConfig
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.training.records import Records, Row, draw_curve


class DivergedError(ClutterGenError):
    """A loss or a weight is not a number any more."""


@dataclass(frozen=True)
class RunConfig:
    """How a run is watched over.

    Attributes:
      seed: of weights, episodes and actions.
      save_every: seconds between checkpoints.
      window: updates over which the success that decides on "best" is averaged.
    """

    seed: int = 0
    save_every: float = 60.0
    window: int = 10


class Run:
    """A run in a folder: `last/` (whole state), `best/` and `policy/` (weights), progress.csv, curve.png.

    Args:
      rules: the decision process.
      network: the network's sizes.
      ppo: the numbers.
      config: how it is watched over.
      folder: continued if it holds a run.
      recipe: JSON values stored in every checkpoint.
    """

    def __init__(
        self,
        rules: Rules,
        network: NetworkConfig,
        ppo: PPOConfig,
        config: RunConfig,
        folder: Path,
        recipe: dict[str, Any],
    ) -> None:
        self.config, self.folder, self.recipe = config, folder, recipe
        geometry = rules.geometry
        most = min(rules.num_slots, geometry.num_objects)
        self.learner = Learner(network, geometry.cloud, geometry.half_extents, most)
        self.ppo = PPO(PlacementEnv(rules), self.learner.apply, ppo)
        folder.mkdir(parents=True, exist_ok=True)

    def start(self) -> TrainState:
        """The state to go on from: the last checkpoint's, or a fresh one."""
        key_init, key_run = jax.random.split(jax.random.key(self.config.seed))
        observation = jax.eval_shape(self.ppo.env.reset, key_init).obs
        state = jax.jit(self.ppo.start)(key_run, self.learner.init(key_init, observation))
        last = self.folder / "last"
        return read_state(last, state) if last.exists() else state

    def train(self, show: Callable[[str], None] = print) -> TrainState:
        """Runs to the end, or until Ctrl-C, which saves and is passed on."""
        state = self.start()
        first, ppo = int(state.num_updates), self.ppo.config
        records = Records(self.folder, first)
        update = jax.jit(self.ppo.update, donate_argnums=0)
        best = (
            float(read_record(self.folder / "best")["success"]) if (self.folder / "best").exists() else -1.0
        )
        saved = time.monotonic()
        total = ppo.num_updates * ppo.batch_size
        try:
            with tqdm(
                total=total, initial=first * ppo.batch_size, unit="attempt", unit_scale=True, disable=None
            ) as bar:
                for number in range(first, ppo.num_updates):
                    started = time.monotonic()
                    state, figures = update(state)
                    row = _row(number, ppo.batch_size, jax.device_get(figures), time.monotonic() - started)
                    self._check(row, number)
                    records.begin(list(row))
                    records.add(row)
                    bar.update(ppo.batch_size)
                    bar.set_postfix_str(_shown(row))
                    success = float(np.mean([r["success"] for r in records.rows[-self.config.window :]]))
                    if success > best and number + 1 >= self.config.window:
                        best = success
                        self._save_policy("best", state, success)
                    if time.monotonic() - saved > self.config.save_every:
                        self._save_state(state)
                        saved = time.monotonic()
        except KeyboardInterrupt:
            show(f"stopped at update {int(state.num_updates)}; saving")
            self._finish(state, records)
            raise
        self._finish(state, records)
        return state

    def _finish(self, state: TrainState, records: Records) -> None:
        if not records.rows:
            return
        self._save_state(state)
        self._save_policy("policy", state, records.rows[-1]["success"])
        draw_curve(records.rows, self.folder / "curve.png", self.folder.name)
        records.close()

    def _save_state(self, state: TrainState) -> None:
        save_state(self.folder / "last", state, self.recipe | {"num_updates": int(state.num_updates)})

    def _save_policy(self, name: str, state: TrainState, success: float) -> None:
        done = {"success": success, "attempts": int(state.num_updates) * self.ppo.config.batch_size}
        save_policy(self.folder / name, state.params, self.recipe | done)

    def _check(self, row: Row, number: int) -> None:
        wrong = [name for name, value in row.items() if not math.isfinite(value)]
        if wrong:
            raise DivergedError(
                f"update {number}: {', '.join(wrong)} is not finite",
                hint=f"a smaller learning rate; the last good state is in {self.folder / 'last'}",
            )


def _row(number: int, batch_size: int, figures: dict[str, Any], seconds: float) -> Row:
    row = {name.removeprefix("env/"): float(value) for name, value in figures.items() if name != "env/reward"}
    return {
        "update": number,
        "attempts": (number + 1) * batch_size,
        "attempts_per_second": batch_size / seconds,
        **row,
    }


def _shown(row: Row) -> str:
    return (
        f"success {row['success']:.2f} placed {row['num_placed']:.2f} reward {row['reward']:.3f} "
        f"entropy {row['entropy']:.2f} kl {row['kl']:.4f} value {row['value_loss']:.3f}"
    )
