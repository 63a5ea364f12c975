"""Updates compiled together: one program makes as many as it is asked for, and the same bits however many."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.agent.health import SOUND, Health
from cluttergen_jax.agent.ppo import PPO, TrainState
from cluttergen_jax.agent.sharding import ManyDevices
from cluttergen_jax.training.places import places_of
from cluttergen_jax.types import Array

Figures = dict[str, np.ndarray]


class Progress(struct.PyTreeNode):
    """What a compiled call carries.

    Attributes:
      state: the learner's.
      figures: of each update, with a leading axis; rows from `num_done` on are zero.
      health: of the latest update.
      num_done: i32, updates made by this call.
    """

    state: TrainState
    figures: dict[str, Array]
    health: Health
    num_done: Array


class Updates:
    """Compiled updates of one learner.

    Args:
      ppo: the learner.
      state: any of its states, for shapes and places.
      most: updates per call at most.
    """

    def __init__(self, ppo: PPO, state: TrainState, most: int) -> None:
        self.most = most
        # The state given is not donated, so that the last good one outlives a call that ends in NaN; within
        # a call the loop writes over what it carries, and a state is small beside what an update makes.
        many = jax.jit(_many(ppo, most), **_places(ppo, state))
        self._compiled = many.lower(state, np.int32(1)).compile()

    def __call__(self, state: TrainState, num: int) -> tuple[TrainState, list[Figures], Health]:
        """`num` updates, or fewer if one of them was not sound: it is then the last.

        Returns:
          The new state, the figures of each update made, and the health of the last one.
        """
        if not 1 <= num <= self.most:
            raise ValueError(f"{num} updates asked for, 1 to {self.most} can be made")
        done = self._compiled(state, np.int32(num))
        figures, health, num_done = jax.device_get((done.figures, done.health, done.num_done))
        rows = [{name: values[row] for name, values in figures.items()} for row in range(int(num_done))]
        return done.state, rows, health


def _many(ppo: PPO, most: int) -> Callable[[TrainState, Array], Progress]:
    update = jax.jit(ppo.checked_update)

    def many(state: TrainState, num: Array) -> Progress:
        _, figures, health = jax.eval_shape(update, state)
        blank = Progress(
            state,
            jax.tree.map(lambda one: jnp.zeros((most, *one.shape), one.dtype), figures),
            jax.tree.map(lambda one: jnp.full(one.shape, SOUND, one.dtype), health),
            jnp.int32(0),
        )

        def one_more(progress: Progress) -> Progress:
            state, figures, health = update(progress.state)
            row = progress.num_done
            kept = jax.tree.map(lambda rows, now: rows.at[row].set(now), progress.figures, figures)
            return Progress(state, kept, health, row + 1)

        return jax.lax.while_loop(lambda p: (p.num_done < num) & p.health.is_sound, one_more, blank)

    return many


def _places(ppo: PPO, state: TrainState) -> dict[str, Any]:
    """Where arguments and results of the program lie; nothing to say of one device."""
    if not isinstance(ppo.devices, ManyDevices):
        return {}
    places, everywhere = places_of(ppo, state), ppo.devices.everywhere
    return {
        "in_shardings": (places, everywhere),
        "out_shardings": Progress(places, everywhere, everywhere, everywhere),  # type: ignore[arg-type]
    }


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
