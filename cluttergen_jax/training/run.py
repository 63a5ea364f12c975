"""One training run: compiled updates, a live display, checkpoints, and Ctrl-C at any time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from cluttergen_jax.agent.checkpoint import has_state, read_state
from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.agent.health import explain
from cluttergen_jax.agent.ppo import PPO, TrainState
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.networks.config import NetworkConfig
from cluttergen_jax.networks.ranking import RankerConfig
from cluttergen_jax.physics.memory import engine_bytes
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.task import make_task
from cluttergen_jax.training.encoder_weights import with_encoder
from cluttergen_jax.training.hosts import agree, gathered, is_writer
from cluttergen_jax.training.interrupt import Interrupt
from cluttergen_jax.training.journal import Evaluate, Journal, RunConfig, Silence
from cluttergen_jax.training.memory import Needs, check_memory
from cluttergen_jax.training.places import devices_for, fresh_state, placed, shared
from cluttergen_jax.training.updates import Updates, num_updates

__all__ = ["DivergedError", "Run", "RunConfig"]


class DivergedError(ClutterGenError):
    """A loss or a weight is not a number any more."""


class Run:
    """A run in a folder: `last/` (whole state), `best/` and `policy/` (weights), progress.csv, curve.png.

    Several devices share its environments; of several processes, the first one writes and speaks.

    Args:
      rules: the decision process.
      network: the network's sizes.
      ppo: the numbers.
      config: how it is watched over.
      folder: continued if it holds a run.
      recipe: JSON values stored in every checkpoint.
      evaluate: says how good weights are; None leaves evaluations out.
      encoder_weights: folder of pretrained weights that the point encoders begin with.
    """

    def __init__(
        self,
        rules: Rules,
        network: NetworkConfig | RankerConfig,
        ppo: PPOConfig,
        config: RunConfig,
        folder: Path,
        recipe: dict[str, Any],
        evaluate: Evaluate | None = None,
        encoder_weights: Path | None = None,
    ) -> None:
        self.config, self.folder, self.recipe = config, folder, recipe
        task = make_task(rules, network)
        self.learner = task.learner
        self.ppo = PPO(task.env, task.learner.apply, ppo, devices_for(ppo.num_envs), task.encode)
        self._encoder_weights = encoder_weights
        self._physics, self._evaluate = rules.physics, evaluate
        folder.mkdir(parents=True, exist_ok=True)

    def memory(self) -> str:
        """What the run needs and what there is, for people.

        Raises:
          ConfigError: it will not fit.
        """
        key = jax.random.key(0)
        params = jax.eval_shape(lambda: self._init(key))
        needs = Needs.of(self.ppo, params, lambda num: engine_bytes(self._physics, num), len(jax.devices()))
        return check_memory(needs, self.config.memory_limit)

    def start(self) -> TrainState:
        """The state to go on from: the last checkpoint's, or a fresh one."""
        key_init, key_run = jax.random.split(jax.random.key(self.config.seed))
        fresh = fresh_state(self.ppo, key_run, self._init(key_init))
        last = self.folder / "last"
        if not agree(has_state(last))[0, 0]:
            return fresh
        whole = gathered(fresh)
        return placed(self.ppo, shared(read_state(last, whole) if is_writer() else whole))

    def _init(self, key: Any) -> Any:
        params = self.learner.init(key, jax.eval_shape(self.ppo.env.reset, key).obs)
        if self._encoder_weights is None:
            return params
        return with_encoder(params, self._encoder_weights)

    def train(self, show: Callable[[str], None] = print, interrupt: Interrupt | None = None) -> TrainState:
        """Runs to the end, or until Ctrl-C, which saves and is passed on.

        Raises:
          ConfigError: the run will not fit into memory.
          DivergedError: numbers are not finite any more; the last state whose numbers were is saved.
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        needed = self.memory()
        if is_writer():
            show(f"memory     {needed}")
        state = self.start()
        journal = self._journal(int(state.num_updates), show)
        try:
            with interrupt or Interrupt() as interrupt:
                state = self._work(state, journal, interrupt)
            if agree(interrupt.is_asked).any():
                journal.say(f"stopped at update {int(state.num_updates)}; everything is saved")
                raise KeyboardInterrupt
            self._finish(state, journal)
        finally:
            journal.close()
        return state

    def _journal(self, first: int, show: Callable[[str], None]) -> Silence:
        if not is_writer():
            return Silence()
        return Journal(self.folder, self.recipe, self.config, self.ppo.config, first, show)

    def _work(self, state: TrainState, journal: Silence, interrupt: Interrupt) -> TrainState:
        """Updates to the end, or until an interrupt asks for it; the latest state, which is saved."""
        config, number, total = self.config, int(state.num_updates), self.ppo.config.num_updates
        if number >= total:
            return state
        journal.say("compiling")
        updates, seconds, saved = Updates(self.ppo, state, config.window), None, time.monotonic()
        journal.begin()
        while number < total:
            wish = num_updates(seconds, self._until_mark(number), config.longest_call)
            is_due = time.monotonic() - saved > config.save_every
            wishes = agree(wish, interrupt.is_asked, is_due)
            if wishes[:, 1].any():
                break
            if wishes[0, 2]:
                journal.save_state(gathered(state))
                saved = time.monotonic()
            started = time.monotonic()
            after, rows, health = updates(state, int(wishes[0, 0]))
            seconds = (time.monotonic() - started) / len(rows)
            if where := explain(health):
                journal.add(rows[:-1], number, seconds)
                raise self._diverged(journal, state, number + len(rows) - 1, where)
            journal.add(rows, number, seconds)
            state, number = after, number + len(rows)
            self._mark(journal, state, number)
        journal.save_state(gathered(state))
        journal.save_policy(state)
        return state

    def _until_mark(self, number: int) -> int:
        """Updates until the next one after which something is to be done, whatever the calls' lengths."""
        marks = [self.config.window, self._eval_updates or self.config.window]
        stops = [mark - number % mark for mark in marks]
        return min(*stops, self.ppo.config.num_updates - number)

    @property
    def _eval_updates(self) -> int:
        """Updates between evaluations; 0 if there are none."""
        return -(-self.config.eval_every // self.ppo.config.batch_size)

    def _mark(self, journal: Silence, state: TrainState, number: int) -> None:
        """What is done at fixed updates, so that a run stopped or timed otherwise leaves the same."""
        if number % self.config.window == 0:
            journal.keep_best(state)
        every = self._eval_updates
        if self._evaluate and every and number % every == 0 and number < self.ppo.config.num_updates:
            journal.add_evaluation(state, self._evaluate(jax.device_get(state.params)))

    def _finish(self, state: TrainState, journal: Silence) -> None:
        """The evaluation of a whole run's weights, unless that is there already."""
        if self._evaluate is None or agree(journal.is_evaluated)[0, 0]:
            return
        journal.say("evaluating")
        evaluation = self._evaluate(jax.device_get(state.params))
        journal.add_evaluation(state, evaluation)
        journal.save_policy(state, evaluation)

    def _diverged(self, journal: Silence, state: TrainState, number: int, where: str) -> DivergedError:
        """Saves the state before the call in which numbers stopped being finite; the error to raise."""
        journal.save_state(gathered(state))
        journal.save_policy(state)
        return DivergedError(
            f"update {number}: not finite: {where}",
            hint=f"a smaller learning rate with another `out`; the last good state, after "
            f"{int(state.num_updates)} updates, is in {self.folder / 'last'}",
        )
