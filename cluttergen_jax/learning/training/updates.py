"""Compiled updates: one program makes as many as asked for, bit for bit the same in calls of any length."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.learning.ppo.ppo import PPO, TrainState
from cluttergen_jax.learning.ppo.sharding import state_sharding, whole_sharding
from cluttergen_jax.types import Array

Figures = dict[str, np.ndarray]
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
