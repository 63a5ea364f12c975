"""Episodes of one step: all objects let fall into a pile, which the native engine makes as a whole."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from cluttergen_jax.config import Together
from cluttergen_jax.physics.host import HostPhysics, empty_settling
from cluttergen_jax.placement.region import is_inside, is_kept_out, to_pose
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.placement.types import Counts, Episode, Transition, choose
from cluttergen_jax.types import Array, Piling, Verdict


class PileSampler(BlockSampler, eq=False):
    """`BlockSampler` whose episodes are over after one step, in which the engine makes the whole pile.

    A pile is a function of the episode's key alone. What `Rules` says of an attempt holds for it as far as it
    can: a release is an attempt, `max_attempts` and `budget` limit releases, and the last check is the same.
    """

    how: ClassVar[Together | None] = "pile"

    def begin(self, key: Array, indices: Array, is_wanted: Array) -> Episode:
        """See `BlockSampler`; of piles that are stored it is counted what touches from the side."""
        episodes = super().begin(key, indices, is_wanted)
        return episodes.replace(num_beside=jnp.zeros(len(indices), jnp.int32))

    def step_one(self, episode: Episode) -> tuple[Episode, Transition]:
        """See `BlockSampler`."""
        asking, *asked = self.ask(episode, jnp.bool_(True))
        physics = self.rules.simulator
        assert isinstance(physics, HostPhysics)
        assert self.how is not None
        return self.finish_pile(episode, asking, physics.make(self.how, *asked))

    def ask(self, episode: Episode, is_due: Array) -> tuple[Episode, *tuple[Array, ...]]:
        """What `HostPhysics.make` is asked, after the episode with its next key.

        Args:
          is_due: bool, whether the pile is to be made now, unless the episode is over.
        """
        rules = self.rules
        key_draw, key_next = jax.random.split(episode.key)
        key_turn, key_place = jax.random.split(key_draw)
        shape = (rules.config.max_attempts, rules.num_slots)
        turn = jax.random.normal(key_turn, (*shape, 4))
        place = jax.random.uniform(key_place, (*shape, 2), minval=-1.0)
        region = jnp.append(to_pose(episode.region.T_world_region), episode.region.half_extents)
        return (
            episode.replace(key=key_next),
            episode.object_index,
            jnp.concatenate([turn, place], axis=-1),
            region,
            rules.geometry.half_extents,
            jnp.float32(rules.config.containment == "footprint"),
            jnp.int32(rules.config.max_scene_attempts),
            is_due & ~episode.is_over,
        )

    def finish_pile(
        self, before: Episode, asking: Episode, piling: Piling
    ) -> tuple[Episode, Transition]:
        """The episode after its pile was made, or as it was before where none was, and what came of it."""
        is_made = piling.verdict != Verdict.NONE
        verdict = self._judge_places(asking, piling)
        is_stable = verdict == Verdict.STABLE
        is_filled = is_stable | (verdict == Verdict.CREPT)
        last = jnp.where(is_filled, int(Verdict.STABLE), verdict)
        slots = jnp.maximum(asking.object_index, 0)
        counts = asking.counts
        is_slot = asking.object_index >= 0
        is_member = jnp.any((slots == jnp.arange(len(piling.releases))[:, None]) & is_slot, axis=1)
        releases = jnp.where(is_slot, piling.releases[slots], 0).astype(jnp.int32)
        steps = jnp.where(is_slot, piling.steps[slots], 0).astype(jnp.int32)
        # All releases but the last of each object ended outside.
        again = jnp.maximum(releases - 1, 0).sum()
        verdicts = counts.verdicts.at[Verdict.OUTSIDE].add(again)
        graph = asking.support_graph
        num_beside = asking.num_beside
        if num_beside is not None:
            num_beside = jnp.where(is_filled, piling.num_beside, 0)
        after = asking.replace(
            slot=jnp.where(is_filled, asking.num_slots, asking.slot).astype(jnp.int32),
            poses=jnp.where((is_member & is_filled)[:, None], piling.poses, asking.poses),
            is_placed=asking.is_placed | (is_member & is_filled),
            is_over=jnp.bool_(True),
            is_success=is_stable,
            verdict=verdict.astype(jnp.int32),
            drift=jnp.where(is_filled, piling.drift, 0.0),
            num_beside=num_beside,
            support_graph=graph.replace(
                leans_on=jnp.where(is_filled, piling.touches, graph.leans_on),
                level=jnp.where(is_filled, piling.level, graph.level),
            ),
            counts=Counts(
                attempts=releases,
                steps=steps,
                rest_steps=jnp.where(is_filled, steps, 0),
                verdicts=verdicts.at[last].add((releases > 0).sum()),
                simulated_steps=piling.num_steps + piling.check_steps,
                reward=jnp.float32(0),
            ),
        )
        config = self.rules.physics.config
        settling = empty_settling(jnp, (), len(piling.releases), config).replace(
            verdict=last.astype(jnp.int32),
            num_steps=piling.num_steps,
            poses=piling.poses,
            is_quiet=is_filled,
        )
        transition = Transition(
            slot=asking.first_slot,
            object_index=slots[0],
            ordinal=jnp.int32(1),
            action=jnp.zeros(4, jnp.float32),
            settling=settling,
            verdict=verdict.astype(jnp.int32),
            reward=jnp.float32(0),
            is_made=is_made,
        )
        return choose(is_made, after, before), transition

    def _judge_places(self, episode: Episode, piling: Piling) -> Array:
        """The pile's verdict once the queried region and keep-out boxes have their say, i32."""
        half = self.rules.geometry.half_extents

        def lies_well(index: Array) -> Array:
            pose = piling.poses[index]
            size = half[index]
            inside = is_inside(pose, size, episode.region, self.rules.config.containment)
            return (index < 0) | (inside & ~is_kept_out(pose, size, episode.keep_out))

        is_well = jnp.all(jax.vmap(lies_well)(episode.object_index))
        return jnp.where(
            (piling.verdict == Verdict.STABLE) & ~is_well, int(Verdict.OUTSIDE), piling.verdict
        )
