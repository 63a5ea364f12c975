"""Episodes of one step: objects dropped one after another by a plain loop, the rival of all methods."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from cluttergen_jax.config import Together
from cluttergen_jax.placement.methods.piles import PileSampler
from cluttergen_jax.placement.types import Counts, Episode, Transition, choose
from cluttergen_jax.types import Array, Piling, Verdict


def _upright(number: int) -> Array:
    """f32[K, 7]: objects as they stand in their own frames."""
    return jnp.zeros((number, 7)).at[:, 3].set(1.0)


class SettleSampler(PileSampler, eq=False):
    """`PileSampler` whose scenes are made by `physics.drops`: a function of the episode's key alone.

    An object that finds no place ends its scene: what is there until then stays in the record.
    """

    how: ClassVar[Together | None] = "drop"

    def ask(self, episode: Episode, is_due: Array) -> tuple[Episode, *tuple[Array, ...]]:
        """What `HostPhysics.make` is asked, after the episode with its next key; see `PileSampler`."""
        rules = self.rules
        # The same split as that of `PileSampler`, whose draws are of no use here.
        key_draw, _ = jax.random.split(episode.key)
        asking, order, _, region, half_extents, whole, budget, is_made = super().ask(
            episode, is_due
        )
        return (
            asking,
            order,
            jax.random.key_data(key_draw),
            region,
            half_extents,
            whole,
            rules.asked_margins(_upright(rules.geometry.num_objects)),
            jnp.int32(rules.config.max_attempts),
            budget,
            is_made,
        )

    def finish_pile(
        self, before: Episode, asking: Episode, piling: Piling
    ) -> tuple[Episode, Transition]:
        """The episode after its scene was made, or as it was before where none was, and what came of it."""
        after, transition = super().finish_pile(before, asking, piling)
        slots = jnp.maximum(asking.object_index, 0)
        is_laid = (asking.object_index >= 0) & ~piling.is_left_out[slots]
        is_placed = asking.is_placed.at[slots].max(is_laid)
        counts: Counts = asking.counts
        number = len(counts.verdicts)
        verdicts = counts.verdicts + piling.rejected[:number]
        laid = is_placed & ~asking.is_placed
        changed = after.replace(
            slot=(asking.slot + is_laid.sum()).astype(jnp.int32),
            is_placed=is_placed,
            poses=jnp.where(laid[:, None], piling.poses, asking.poses),
            counts=after.counts.replace(
                rest_steps=jnp.where(is_laid, after.counts.rest_steps, 0),
                verdicts=verdicts.at[Verdict.STABLE].add(is_laid.sum()),
            ),
        )
        return choose(transition.is_made, changed, before), transition
