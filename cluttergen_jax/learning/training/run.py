"""One training run: compiled updates, a live display, checkpoints, and Ctrl-C at any time."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.learning.agents import ENCODER, make_agent
from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.policies.policy import TrainedPolicy, make_policy
from cluttergen_jax.learning.ppo.checkpoint import read_policy
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig, TrainState
from cluttergen_jax.learning.ppo.sharding import (
    agree,
    broadcast,
    gather,
    is_writer,
    make_mesh,
    state_sharding,
    whole_sharding,
    with_keys,
    without_keys,
)
from cluttergen_jax.learning.training.run_folder import SAVE_EVERY, Interrupt, RunFolder
from cluttergen_jax.learning.training.run_logger import (
    Evaluate,
    Evaluation,
    Figures,
    Logger,
    NullLogger,
    RunConfig,
    RunLogger,
    SuccessRate,
)
from cluttergen_jax.numerics import new_key
from cluttergen_jax.physics import make_physics
from cluttergen_jax.placement import Problem, Proposer, Rules
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.rollout import BLOCK_SIZE, BlockSampler, Rollout
from cluttergen_jax.progress import waiting
from cluttergen_jax.statistics import wilson
from cluttergen_jax.types import Array

_PACKAGE = str(Path(__file__).parents[2])


class Carry(struct.PyTreeNode):
    """What a compiled call carries from update to update.

    Attributes:
      state: the learner's.
      figures: of each update, with a leading axis; rows from `num_done` on are zero.
      is_finite: bool, whether all numbers of the latest update were.
      num_done: i32, updates made by this call.
    """

    state: TrainState
    figures: dict[str, Array]
    is_finite: Array
    num_done: Array


class Updates:
    """Compiled updates of one learner.

    Args:
      ppo: the learner.
      state: any of its states, for shapes and shardings.
      most: updates per call at most.

    Attributes:
      compiled: the program.
    """

    def __init__(self, ppo: PPO, state: TrainState, most: int) -> None:
        self._ppo = ppo
        self.most = most
        # The state given is not donated, so that the last good one outlives a call that ends in NaN; within
        # a call the loop writes over what it carries, and a state is small beside what an update makes.
        self.compiled = _jit(ppo, state, most).lower(state, np.int32(1)).compile()

    def __call__(self, state: TrainState, num: int) -> tuple[TrainState, list[Figures], bool]:
        """`num` updates, or fewer if numbers of one of them were not finite: it is then the last.

        Returns:
          The new state, the figures of each update made, and whether all numbers of the last one were finite.
        """
        if not 1 <= num <= self.most:
            raise ValueError(f"{num} updates asked for, 1 to {self.most} can be made")
        done = self.compiled(state, np.int32(num))
        figures, is_finite, num_done = jax.device_get((done.figures, done.is_finite, done.num_done))
        rows = [
            {name: values[row] for name, values in figures.items()} for row in range(int(num_done))
        ]
        return done.state, rows, bool(is_finite)

    def where_not_finite(self, state: TrainState, num: int) -> str:
        """The line of this package at which update number `num` from `state` makes its first NaN.

        The update is made once more under `jax_debug_nans`; "" if no NaN is seen there, as with infinities.
        """
        if jax.process_count() > 1:
            return ""
        before = self(state, num - 1)[0] if num > 1 else state
        try:
            with jax.debug_nans(True):
                jax.block_until_ready(jax.jit(self._ppo.update)(before))
        except FloatingPointError as error:
            frames = traceback.extract_tb(error.__traceback__)
            own = [frame for frame in frames if frame.filename.startswith(_PACKAGE)][-1]
            return f"{own.name} ({Path(own.filename).relative_to(_PACKAGE)}:{own.lineno})"
        return ""


def _many(ppo: PPO, most: int) -> Callable[[TrainState, Array], Carry]:
    update = jax.jit(ppo.checked_update)

    def many(state: TrainState, num: Array) -> Carry:
        _, figures, _ = jax.eval_shape(update, state)
        blank = jax.tree.map(lambda one: jnp.zeros((most, *one.shape), one.dtype), figures)

        def one_more(carry: Carry) -> Carry:
            state, figures, is_finite = update(carry.state)
            row = carry.num_done
            kept = jax.tree.map(lambda rows, now: rows.at[row].set(now), carry.figures, figures)
            return Carry(state, kept, is_finite, row + 1)

        start = Carry(state, blank, jnp.bool_(True), jnp.int32(0))
        return jax.lax.while_loop(
            lambda carry: (carry.num_done < num) & carry.is_finite, one_more, start
        )

    return many


def _jit(ppo: PPO, state: TrainState, most: int) -> Any:
    """The program, its arguments and results divided among the devices if there are several."""
    many = _many(ppo, most)
    if ppo.mesh is None:
        return jax.jit(many)
    of_state = state_sharding(ppo.mesh, state)
    whole = whole_sharding(ppo.mesh)
    results = Carry(of_state, whole, whole, whole)  # type: ignore[arg-type]
    return jax.jit(many, in_shardings=(of_state, whole), out_shardings=results)


def num_updates(seconds: float | None, most: int, longest: float) -> int:
    """Updates for the next call, at least one.

    Args:
      seconds: what an update took lately; None if that is not known.
      most: updates at most.
      longest: seconds that a call may take.
    """
    if seconds is None:
        return 1
    return max(1, min(most, int(longest / max(seconds, 1e-9))))


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
      folder: with the recipe that every checkpoint has.
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
        folder: RunFolder,
        evaluate: Evaluate | None = None,
        encoder_weights: Path | None = None,
        random: Callable[[], SuccessRate] | None = None,
    ) -> None:
        self.config = config
        self.folder = folder
        self.agent = make_agent(rules, network)
        env = PlacementEnv(rules, self.agent.observation)
        self.ppo = PPO(env, self.agent.apply, ppo, make_mesh(ppo.num_envs), self.agent.encode)
        self._encoder_weights = encoder_weights
        self._evaluate = evaluate
        self._random = random
        folder.path.mkdir(parents=True, exist_ok=True)

    def start(self) -> TrainState:
        """The state to go on from: the last checkpoint's, or a fresh one."""
        key_init, key_run = jax.random.split(new_key(self.config.seed))
        fresh = fresh_state(self.ppo, key_run, self._init(key_init))
        if not agree(self.folder.is_begun)[0, 0]:
            return fresh
        whole = gather(fresh)
        return put_state(
            self.ppo,
            broadcast(self.folder.load(whole) if is_writer() else whole),
        )

    def _init(self, key: Any) -> Any:
        params = self.agent.init(key, jax.eval_shape(self.ppo.env.reset, key).obs)
        if self._encoder_weights is None:
            return params
        return with_encoder(params, self._encoder_weights)

    def train(
        self, show: Callable[[str], None] = print, interrupt: Interrupt | None = None
    ) -> TrainState:
        """Runs to the end, or until Ctrl-C, which saves and is passed on.

        Raises:
          ConfigError: the run will not fit into memory.
          DivergedError: numbers are not finite any more; the last state whose numbers were is saved.
          KeyboardInterrupt: on Ctrl-C, once everything is saved.
        """
        with _waiting("preparing", "the first state of all environments, compiled first", show):
            state = self.start()
        logger = self._logger(int(state.num_updates), show)
        try:
            with interrupt or Interrupt() as interrupt:
                state = self._work(state, logger, interrupt)
            if agree(interrupt.is_asked).any():
                number = int(state.num_updates)
                logger.say(f"stopped at update {number}; everything is saved")
                is_trained = number >= self.ppo.config.num_updates
                raise KeyboardInterrupt(*((_EVALUATE,) if is_trained else ()))
            self._finish(state, logger)
        finally:
            logger.close()
        return state

    def _logger(self, first: int, show: Callable[[str], None]) -> Logger:
        if not is_writer():
            return NullLogger()
        return RunLogger(self.folder, self.config, self.ppo.config, first, show)

    def _work(self, state: TrainState, logger: Logger, interrupt: Interrupt) -> TrainState:
        """Updates to the end, or until an interrupt asks for it; the latest state, which is saved."""
        config = self.config
        number = int(state.num_updates)
        total = self.ppo.config.num_updates
        if number >= total:
            logger.complete_policy(state)
            return state
        with _waiting("compiling", _COMPILING, logger.say):
            updates = interrupt.run_compiling(Updates, self.ppo, state, config.window)
        seconds = None
        saved = time.monotonic()
        logger.say(f"memory     {check_memory(updates.compiled, config.memory_limit)}")
        logger.begin()
        while number < total:
            wanted = num_updates(seconds, self._until_mark(number), config.longest_call)
            is_due = time.monotonic() - saved > SAVE_EVERY
            asked = agree(wanted, interrupt.is_asked, is_due)
            if asked[:, 1].any():
                break
            if asked[0, 2]:
                logger.save_state(gather(state))
                saved = time.monotonic()
            started = time.monotonic()
            after, rows, is_finite = updates(state, int(asked[0, 0]))
            seconds = (time.monotonic() - started) / len(rows)
            if not is_finite:
                logger.add(rows[:-1], number, seconds)
                where = updates.where_not_finite(state, len(rows))
                raise self._diverged_error(logger, state, number + len(rows) - 1, where)
            logger.add(rows, number, seconds)
            state = after
            number = number + len(rows)
            self._mark(logger, state, number)
        logger.save_state(gather(state))
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
        if (
            self._evaluate
            and every
            and number % every == 0
            and number < self.ppo.config.num_updates
        ):
            logger.add_evaluation(state, self._evaluate(jax.device_get(state.params)))

    def _finish(self, state: TrainState, logger: Logger) -> None:
        """The evaluation of a whole run's weights, unless one of as many episodes is there already."""
        if self._evaluate is None:
            return
        asked = getattr(self._evaluate, "num_episodes", 1)
        if agree(logger.num_evaluated >= asked)[0, 0]:
            return
        beside = "" if self._random is None else ", beside `random` in the same world"
        reason = f"{asked} episodes, each with its whole last check{beside}; compiled first"
        with _waiting("evaluating", reason, logger.say):
            evaluation = self._evaluate(jax.device_get(state.params))
            if self._random is not None:
                evaluation["random"] = self._random()
        logger.add_evaluation(state, evaluation)
        logger.save_policy(state, evaluation)

    def _diverged_error(
        self, logger: Logger, state: TrainState, number: int, where: str
    ) -> DivergedError:
        """Saves the state before the call in which numbers stopped being finite; the error to raise."""
        logger.save_state(gather(state))
        logger.save_policy(state)
        return DivergedError(
            f"update {number}: numbers are not finite" + (f", first in {where}" if where else ""),
            hint=f"a smaller learning rate with another `out`; the last good state, after "
            f"{int(state.num_updates)} updates, is in {self.folder.path / 'last'}",
        )


_EVALUATE = "all attempts are made, and the policy is there; rerun the command to evaluate it"
_COMPILING = (
    "one update as one program, half a minute on two cores where it was not compiled before"
)


def _waiting(phase: str, reason: str, say: Callable[[str], None]) -> AbstractContextManager[None]:
    """`progress.waiting` in the process that shows what is done; nothing in the others."""
    return waiting(phase, reason, say) if is_writer() else nullcontext()


def fresh_state(ppo: PPO, key: Any, params: Any) -> TrainState:
    """`ppo.start`, compiled, each environment made where it belongs."""
    if ppo.mesh is None:
        return jax.jit(ppo.start)(key, params)
    data = np.asarray(jax.random.key_data(key))
    params = jax.device_get(params)
    implementation = jax.random.key_impl(key)

    def start(data: Any, params: Any) -> TrainState:
        return ppo.start(jax.random.wrap_key_data(data, impl=implementation), params)

    sharding = state_sharding(ppo.mesh, jax.eval_shape(start, data, params))
    return jax.jit(start, out_shardings=sharding)(data, params)


def put_state(ppo: PPO, state: TrainState) -> TrainState:
    """A state that every process holds whole, put where it belongs."""
    if ppo.mesh is None:
        return state
    data = jax.tree.map(np.asarray, without_keys(state))
    return jax.jit(
        lambda data: with_keys(data, state), out_shardings=state_sharding(ppo.mesh, state)
    )(data)


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


def check_memory(compiled: Any, limit: int | None = None) -> str:
    """A sentence on what a compiled program needs on each device and what there is.

    Simulations of the native engine come on top: they lie outside of the program.

    Args:
      compiled: from `jax.jit(...).lower(...).compile()`; its arguments lie in memory already.
      limit: bytes that it may need; None asks the device, or the host where the device is its processor.

    Raises:
      ConfigError: it will not fit.
    """
    sizes = compiled.memory_analysis()
    if sizes is None:
        return "not reported by this device"
    arguments = sizes.argument_size_in_bytes
    results = sizes.output_size_in_bytes - sizes.alias_size_in_bytes
    needed = arguments + results + sizes.temp_size_in_bytes
    limit = free_bytes() + arguments if limit is None else limit
    text = (
        f"{_amount(needed)}: state {_amount(arguments)} before and {_amount(results)} after an update, "
        f"{_amount(sizes.temp_size_in_bytes)} within it"
    )
    if needed > limit:
        raise ConfigError(
            f"a run that needs {text}",
            f"{_amount(limit)} of memory",
            "fewer environments (`num_envs`), a smaller network, or a higher `memory_limit` where one is set",
        )
    return f"{text} (of {_amount(limit)})"


def free_bytes() -> int:
    """Bytes that a run may take: of the accelerator, or of this machine (and its control group)."""
    stats = jax.local_devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0))
    return min(_available(), _left_in_group())


def _available() -> int:
    """What the kernel says can be had without swapping; all there is, where it does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _left_in_group() -> int:
    """What a container's limit leaves."""
    folder = Path("/sys/fs/cgroup")
    try:
        return int((folder / "memory.max").read_text()) - int(
            (folder / "memory.current").read_text()
        )
    except (OSError, ValueError):
        return 1 << 62


def _amount(num_bytes: float) -> str:
    return f"{num_bytes / 1e9:.1f} GB" if num_bytes >= 1e9 else f"{num_bytes / 1e6:.1f} MB"


_FRESH = 0x5EED
"""Folded into the seed's key, so that no episode of training comes back."""


@dataclass(frozen=True, eq=False)
class Evaluator:
    """Success of weights, judged as sampling and saving judge: with the whole last check.

    Attributes:
      problem: the one that is trained on; its last check may be shorter.
      network: the network's sizes.
      num_episodes: how many fresh episodes.
      is_sampled: draw actions, as `generate` does; else take the mean.
      seed: of the episodes.
    """

    problem: Problem
    network: NetworkConfig
    num_episodes: int = 256
    is_sampled: bool = True
    seed: int = 0

    @cached_property
    def rules(self) -> Rules:
        """Those of training with an engine that makes the whole last check."""
        config = self.problem.config
        whole = replace(config.stability, stand_full_steps=StabilityConfig().stand_full_steps)
        physics = make_physics(self.problem.world.layout, whole, config.engine, config.num_threads)
        return replace(self.problem.rules, physics=physics)

    @cached_property
    def _policy(self) -> TrainedPolicy:
        return make_policy(self.rules, self.network, None, self.is_sampled)

    @cached_property
    def _rollout(self) -> Rollout:
        return Rollout()

    def __call__(self, params: Any) -> Evaluation:
        """Success with its 95 % interval, and how it was found: JSON values.

        Args:
          params: the weights; they are evaluated at half precision, as they are stored.
        """
        params = jax.tree.map(lambda leaf: np.float32(np.float16(leaf)), params)
        return {
            **self._success(replace(self._policy, params=params)),
            "action": "sampled" if self.is_sampled else "mean",
            "last_check_steps": self.rules.physics.config.stand_full_steps,
        }

    def random(self) -> SuccessRate:
        """The success of `random` in as many episodes of the same world: what a policy has to beat."""
        return self._success(make_proposer("random", self.rules))

    def _success(self, proposer: Proposer) -> SuccessRate:
        key = jax.random.fold_in(new_key(self.seed), _FRESH)
        width = min(BLOCK_SIZE, self.num_episodes)
        scenes = self._rollout.run_all(
            BlockSampler(self.rules, proposer), key, self.num_episodes, width
        )
        found = scenes.is_success
        low, high = wilson(int(found.sum()), len(found))
        return {
            "success": float(found.mean()),
            "low95": low,
            "high95": high,
            "filled": float(scenes.is_filled.mean()),
            "episodes": len(found),
        }
