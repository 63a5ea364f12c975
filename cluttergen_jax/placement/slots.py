"""Which objects an episode places, and in which order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.config import ORDER_POWER, PlacementConfig
from cluttergen_jax.placement.containers import draw_contents
from cluttergen_jax.placement.related import RelatedObjects
from cluttergen_jax.placement.types import Geometry
from cluttergen_jax.types import Array


@dataclass(frozen=True, eq=False)
class SlotDraw:
    """Draws the objects of an episode.

    Attributes:
      config: what is asked of it. geometry: K objects.
      num_started: the most objects that may stand there already.
      related: the relations that scenes must fulfil; None for none.
    """

    config: PlacementConfig
    geometry: Geometry
    num_started: int
    related: RelatedObjects | None

    @property
    def num_slots(self) -> int:
        """S: slots of those that stand there already, then of those to be placed."""
        return self.num_started + self.config.num_objects

    def draw(self, key: Array, is_taken: Array, roles: Array | None) -> Array:
        """i32[S]: the objects that stand, then those to place, then -1 for slots without an object.

        Those to place are a uniform subset of the objects not taken, whatever their order but "fixed"; those
        of roles are among them and come first, each after those to which it is placed. Where objects are to
        be inside of others, so many that fit are among them, and what they fit into comes first.
        """
        ranks = jnp.arange(self.geometry.num_objects, dtype=jnp.float32)
        if self.config.order != "fixed":
            ranks = jax.random.uniform(key, ranks.shape)
        ranks = jnp.where(is_taken, jnp.inf, ranks)
        if roles is not None:
            ranks = ranks.at[roles].set(-1.0)
        is_container = None
        if self.num_contained and self.config.order != "fixed":
            # No search finds room inside of others where nothing that is drawn fits into anything.
            is_content, is_container = draw_contents(
                jax.random.fold_in(key, 6),
                self.geometry,
                is_taken,
                self.num_contained,
                self.config.num_objects,
            )
            ranks = jnp.where((is_content | is_container) & ~is_taken, ranks - 1.0, ranks)
        chosen = jnp.argsort(ranks)[: self.config.num_objects].astype(jnp.int32)
        chosen = jnp.where(jnp.isfinite(ranks[chosen]), chosen, -1)
        if self.config.order in ("largest", "weighted"):
            chosen = chosen[jnp.argsort(-self._weight(key)[chosen])]
        if is_container is not None:
            chosen = chosen[jnp.argsort(~is_container[chosen], stable=True)]
        if roles is not None and self.related is not None:
            chosen = chosen[jnp.argsort(self.related.priority(roles)[chosen], stable=True)]
        standing = jnp.nonzero(is_taken, size=self.num_started, fill_value=-1)[0].astype(jnp.int32)
        slots = jnp.concatenate([standing, chosen])
        slots = jnp.pad(slots, (0, self.num_slots - slots.shape[0]), constant_values=-1)
        return slots[jnp.argsort(slots < 0, stable=True)]

    @property
    def num_contained(self) -> int:
        """Objects that are drawn to be inside of others: one more than are asked for, for want of room."""
        clutter = self.config.clutter
        asked = math.ceil((clutter and clutter.contained) or 0)
        return min(asked + 1, self.config.num_objects - 1) if asked else 0

    def _weight(self, key: Array) -> Array:
        """f32[K]: who comes first, highest first. With noise of Gumbel's it is a draw by Plackett-Luce."""
        weight = jnp.log(footprint_area(self.geometry.half_extents))
        if self.config.order == "largest":
            return weight
        noise = jax.random.gumbel(jax.random.fold_in(key, 1), weight.shape)
        return ORDER_POWER * weight + noise
