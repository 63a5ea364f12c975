"""Attempts as labelled examples: what was known of a candidate beforehand, and what came of it."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.learning.networks.stability import features_of
from cluttergen_jax.learning.policies.guided import Guided
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.search.trusted import CandidateSet
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.types import Array, Verdict

_FAR = 0.1


class Examples(struct.PyTreeNode):
    """N attempts, arrays of JAX or NumPy.

    Attributes:
      features: f32[N, NUM_FEATURES], of the pose that was tried (`features_of`).
      stands: bool[N], it was stable, with the support margin that the rules ask for.
      is_robust: bool[N], it was, and stayed so under change; knows_robust: bool[N], where that was looked at.
      disturbs: bool[N], a placed object was moved.
      shift: f32[N], metres in plan from where the object was released to where it came to rest, at most 0.1.
      margin: f32[N], metres, its support margin at rest, -0.1 to 0.1; 0 where it did not come to rest.
      is_on: bool[N], it would have been carried by another object.
    """

    features: Array
    stands: Array
    is_robust: Array
    knows_robust: Array
    disturbs: Array
    shift: Array
    margin: Array
    is_on: Array


class Explorer(Guided, eq=False):
    """A guided placer that sometimes tries any candidate, so that its network sees what it mistrusts.

    Attributes:
      exploration: f32, how often.
    """

    exploration: Any = 0.3

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """See `TrustedSearch`: the network's trust, or one in everything."""
        key = jax.random.fold_in(episode.key, 3)
        tries_any = jax.random.uniform(key) < self.exploration
        return jnp.where(tries_any, 1.0, Guided.trust(self, episode, candidates))


def begin(explorer: Explorer, key: Array, number: int) -> Episode:
    """So many fresh episodes of the explorer's rules, side by side."""
    return _begin(explorer.search.rules, jax.random.split(key, number))


@jax.jit
def _begin(rules: Rules, keys: Array) -> Episode:
    return jax.vmap(lambda key: rules.begin(key))(keys)


def collect_step(explorer: Explorer, episodes: Episode) -> tuple[Episode, Examples]:
    """One attempt in each episode, and what it teaches; to be compiled."""
    return jax.vmap(_step, (None, 0))(explorer, episodes)


def _step(explorer: Explorer, episode: Episode) -> tuple[Episode, Examples]:
    rules = explorer.search.rules
    key_propose, key_next, key_begin = jax.random.split(episode.key, 3)
    action = explorer(key_propose, episode)
    after, transition = rules.attempt(episode.replace(key=key_next), action)
    fresh = rules.begin(key_begin)
    next_episode = jax.tree.map(lambda new, old: jnp.where(after.is_over, new, old), fresh, after)
    return next_episode, example_of(explorer, episode, transition)


def example_of(explorer: Guided, before: Episode, transition: Transition) -> Examples:
    """What one attempt teaches, without a leading axis."""
    rules, settling = explorer.search.rules, transition.settling
    lower, size = action_scale(before.region, rules.height_range(before))
    xy = (lower + transition.action[:3] * size)[:2]
    candidates = Candidates(xy[None], 2 * jnp.pi * transition.action[3:])
    tried = explorer.look(before, candidates)
    focus = transition.object_index
    released = settling.trajectory[0, :2]
    is_at_rest = settling.is_quiet
    is_stable = transition.verdict == Verdict.STABLE
    is_fragile = transition.verdict == Verdict.FRAGILE
    stands = is_stable | (is_fragile & rules.is_supported(before, focus, settling))
    return Examples(
        features=features_of(rules, before, tried)[0],
        stands=stands,
        is_robust=is_stable,
        knows_robust=jnp.bool_(rules.physics.config.robust_tilt > 0) | ~stands,
        disturbs=transition.verdict == Verdict.DISPLACED,
        shift=jnp.minimum(jnp.linalg.norm(settling.poses[focus, :2] - released), _FAR),
        margin=jnp.where(is_at_rest, jnp.clip(settling.margin[focus], -_FAR, _FAR), 0.0),
        is_on=tried.bearers.is_on[0],
    )
