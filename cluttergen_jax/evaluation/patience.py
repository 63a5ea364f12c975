"""Attempts that run to their end, although the rules look only at what decided them."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp

from cluttergen_jax.physics.protocol import Physics
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array, Settling, Standing


class PatientPhysics:
    """`physics.protocol.Physics` whose attempts run to step 240, shown to the rules as if they had not.

    A policy that was trained on attempts cut off at step 60 reads histories of that length; stable steps, as
    the paper counts them, need the rest.

    Args:
      physics: an engine with `stop_when_decided` off.
    """

    def __init__(self, physics: Physics) -> None:
        self._physics = physics
        self.config = replace(physics.config, stop_when_decided=True)

    def settle(self, poses: Array, is_placed: Array, focus: Array, is_active: Array) -> Settling:
        """See `Physics.settle`."""
        return self._physics.settle(poses, is_placed, focus, is_active)

    def stand(self, poses: Array, is_placed: Array, is_active: Array) -> Standing:
        """See `Physics.stand`."""
        return self._physics.stand(poses, is_placed, is_active)


class PatientRules(Rules):
    """Rules over `PatientPhysics`: all steps are counted, and the history says what a cut attempt would."""

    def attempt(self, episode: Episode, action: Array) -> tuple[Episode, Array]:
        """See `Rules.attempt`."""
        after, reward = super().attempt(episode, action)
        steps = jnp.minimum(after.history.num_steps, self.physics.config.last_step)
        return after.replace(history=after.history.replace(num_steps=steps)), reward
