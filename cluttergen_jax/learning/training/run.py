"""One training run: compiled updates, a live display, checkpoints, and Ctrl-C at any time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.learning.agents import ENCODER, make_agent
from cluttergen_jax.learning.networks.config import KIND, NetworkConfig
from cluttergen_jax.learning.ppo.checkpoint import has_state, read_policy, read_state
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig, TrainState
from cluttergen_jax.learning.ppo.sharding import make_mesh
from cluttergen_jax.learning.training import distributed
from cluttergen_jax.learning.training.interrupt import Interrupt
from cluttergen_jax.learning.training.memory import check_memory
from cluttergen_jax.learning.training.run_logger import (
    Evaluate,
    Evaluation,
    Logger,
    NullLogger,
    RunConfig,
    RunLogger,
)
from cluttergen_jax.learning.training.updates import Updates, num_updates
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.rules import Rules

_SET_ENCODER = "PointNet_0"


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
      random: says how good `random` is in the same world, for the end of the run; None leaves it out.
    """

    def __init__(
        self,
        rules: Rules,
        network: NetworkConfig,
        ppo: PPOConfig,
        config: RunConfig,
        folder: Path,
        recipe: dict[str, Any],
        evaluate: Evaluate | None = None,
        encoder_weights: Path | None = None,
        random: Callable[[], Evaluation] | None = None,
    ) -> None:
        self.config, self.folder = config, folder
        self.recipe = recipe | {"kind": KIND}
        self.agent = make_agent(rules, network)
        env = PlacementEnv(rules, self.agent.observation)
        self.ppo = PPO(env, self.agent.apply, ppo, make_mesh(ppo.num_envs), self.agent.encode)
        self._encoder_weights = encoder_weights
        self._evaluate, self._random = evaluate, random
        folder.mkdir(parents=True, exist_ok=True)

    def start(self) -> TrainState:
        """The state to go on from: the last checkpoint's, or a fresh one."""
        key_init, key_run = jax.random.split(new_key(self.config.seed))
        fresh = distributed.fresh_state(self.ppo, key_run, self._init(key_init))
        last = self.folder / "last"
        if not distributed.agree(has_state(last))[0, 0]:
            return fresh
        whole = distributed.gathered(fresh)
        return distributed.placed(
            self.ppo, distributed.shared(read_state(last, whole) if distributed.is_writer() else whole)
        )

    def _init(self, key: Any) -> Any:
        params = self.agent.init(key, jax.eval_shape(self.ppo.env.reset, key).obs)
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
        state = self.start()
        logger = self._logger(int(state.num_updates), show)
        try:
            with interrupt or Interrupt() as interrupt:
                state = self._work(state, logger, interrupt)
            if distributed.agree(interrupt.is_asked).any():
                logger.say(f"stopped at update {int(state.num_updates)}; everything is saved")
                raise KeyboardInterrupt
            self._finish(state, logger)
        finally:
            logger.close()
        return state

    def _logger(self, first: int, show: Callable[[str], None]) -> Logger:
        if not distributed.is_writer():
            return NullLogger()
        return RunLogger(self.folder, self.recipe, self.config, self.ppo.config, first, show)

    def _work(self, state: TrainState, logger: Logger, interrupt: Interrupt) -> TrainState:
        """Updates to the end, or until an interrupt asks for it; the latest state, which is saved."""
        config, number, total = self.config, int(state.num_updates), self.ppo.config.num_updates
        if number >= total:
            return state
        logger.say("compiling")
        updates = interrupt.compiled(Updates, self.ppo, state, config.window)
        seconds, saved = None, time.monotonic()
        logger.say(f"memory     {check_memory(updates.compiled, config.memory_limit)}")
        logger.begin()
        while number < total:
            wanted = num_updates(seconds, self._until_mark(number), config.longest_call)
            is_due = time.monotonic() - saved > config.save_every
            asked = distributed.agree(wanted, interrupt.is_asked, is_due)
            if asked[:, 1].any():
                break
            if asked[0, 2]:
                logger.save_state(distributed.gathered(state))
                saved = time.monotonic()
            started = time.monotonic()
            after, rows, is_finite = updates(state, int(asked[0, 0]))
            seconds = (time.monotonic() - started) / len(rows)
            if not is_finite:
                logger.add(rows[:-1], number, seconds)
                where = updates.where_not_finite(state, len(rows))
                raise self._diverged(logger, state, number + len(rows) - 1, where)
            logger.add(rows, number, seconds)
            state, number = after, number + len(rows)
            self._mark(logger, state, number)
        logger.save_state(distributed.gathered(state))
        logger.save_policy(state)
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

    def _mark(self, logger: Logger, state: TrainState, number: int) -> None:
        """What is done at fixed updates, so that a run stopped or timed otherwise leaves the same."""
        if number % self.config.window == 0:
            logger.keep_best(state)
        every = self._eval_updates
        if self._evaluate and every and number % every == 0 and number < self.ppo.config.num_updates:
            logger.add_evaluation(state, self._evaluate(jax.device_get(state.params)))

    def _finish(self, state: TrainState, logger: Logger) -> None:
        """The evaluation of a whole run's weights, unless that is there already."""
        if self._evaluate is None or distributed.agree(logger.is_evaluated)[0, 0]:
            return
        logger.say("evaluating" if self._random is None else "evaluating, beside `random` in the same world")
        evaluation = self._evaluate(jax.device_get(state.params))
        if self._random is not None:
            evaluation |= {"random": self._random()}
        logger.add_evaluation(state, evaluation)
        logger.save_policy(state, evaluation)

    def _diverged(self, logger: Logger, state: TrainState, number: int, where: str) -> DivergedError:
        """Saves the state before the call in which numbers stopped being finite; the error to raise."""
        logger.save_state(distributed.gathered(state))
        logger.save_policy(state)
        return DivergedError(
            f"update {number}: numbers are not finite" + (f", first in {where}" if where else ""),
            hint=f"a smaller learning rate with another `out`; the last good state, after "
            f"{int(state.num_updates)} updates, is in {self.folder / 'last'}",
        )


def with_encoder(params: Any, folder: Path) -> Any:
    """A policy's parameters with the point encoders' weights from `folder`: of objects and of scenes alike.

    Raises:
      PoolError: the weights are missing, damaged, or of other sizes.
    """
    inner = dict(params["params"])
    if ENCODER in inner:
        inner[ENCODER] = {name: read_policy(folder, net) for name, net in inner[ENCODER].items()}
    else:
        inner[_SET_ENCODER] = read_policy(folder, inner[_SET_ENCODER])
    return params | {"params": inner}
