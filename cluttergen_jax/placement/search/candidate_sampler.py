"""Placers that draw uniformly among the candidate poses that are trusted to stand."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.related import carriers_of
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.entropy_tilt import shortfall, tilt_logits
from cluttergen_jax.placement.search.features import Placing, remaining_and_added, safe_poses
from cluttergen_jax.placement.search.fit import Candidates
from cluttergen_jax.placement.search.related_candidates import is_related, related_candidates
from cluttergen_jax.placement.search.search import (
    FORBIDDEN,
    Search,
    SearchScene,
    TopCandidates,
    draw_candidates,
)
from cluttergen_jax.placement.search.support_graph import Supporters, find_supporters
from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

_ABOVE = 96
_MANY_ABOVE = 192
_MANY = 0.3
"""Candidates over placed objects where some shall lie on others, and where more than `_MANY` of all shall."""
_INSIDE = 192

_RELATED = 192
"""Candidates where relations hold that are asked for."""

_TIDY_FINALISTS = 96
_CLOSER = 1e-6

_AREA_POWER = 2.0
_BASE_POWER = 1.0
_LEAST_BASE = 0.02
_HIGHEST_COST = 10.0


@dataclass(frozen=True)
class CandidateConfig:
    """How many candidates are looked at, and which are trusted.

    Attributes:
      num_uniform: uniform over region and turn.
      num_finalists: the cheapest of many by the search's cost (`SearchConfig.num_candidates`).
      num_above: over a placed object drawn for each.
      thresholds: the trust asked for at an object's first attempt, its second, and so on; the last one holds
        for all further ones. Where no candidate has it, the most trusted one is taken.
      least_trust: the trust asked for where a candidate with no more comes nearer to what `Clutter` asks.
    """

    num_uniform: int = 80
    num_finalists: int = 16
    num_above: int = 0
    thresholds: tuple[float, ...] = (0.9, 0.8, 0.6)
    least_trust: float = 0.3


class CandidateSet(struct.PyTreeNode):
    """N candidates for one attempt, wholly looked at.

    Attributes:
      found: where they are and how they would lie.
      supporters: what would carry them.
      is_allowed: bool[N], those that would count.
    """

    found: TopCandidates
    supporters: Supporters
    is_allowed: Array


class CandidateSampler(struct.PyTreeNode, eq=False):
    """A proposer: candidates from three sources, a uniform draw among those that a subclass trusts.

    With poses drawn uniformly, an exact judge of what stands, and what stands as the only condition, scenes
    would be those of rejection sampling; how near a judge comes is what `evaluate` measures.

    Attributes:
      search: finds the finalists and looks at all candidates; its rules keep what carries what.
      config: how many, and the trust that is asked for.
    """

    search: Search
    config: CandidateConfig = struct.field(pytree_node=False, default=CandidateConfig())

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """f32[N], 0 to 1: how likely each candidate is to stand and to disturb nothing."""
        raise NotImplementedError

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        key_draw, key_choice = jax.random.split(key)
        candidates = self.candidates(key_draw, episode)
        trust = jnp.where(candidates.is_allowed, self.trust(episode, candidates), -1.0)
        thresholds = jnp.array(self.config.thresholds)
        asked = thresholds[jnp.minimum(episode.attempt, len(thresholds) - 1)]
        noise = jax.random.gumbel(key_choice, trust.shape)
        if self.search.rules.config.tidy:
            noise = -jnp.minimum(candidates.found.cost, _HIGHEST_COST)
        if self.is_tilted:
            logits, asked = self.tilt(episode, candidates, trust, asked)
            noise += logits
        # Whoever is trusted comes before all others, and among the others the most trusted.
        rank = jnp.where(trust >= asked, 2.0 + noise - jnp.min(noise), trust)
        return candidates.found.action[jnp.argmax(rank)]

    @property
    def is_tilted(self) -> bool:
        """Whether the draw is other than uniform: features are asked for, or what looks natural."""
        asked = self.search.rules.config
        return asked.clutter is not None or asked.natural

    def tilt(
        self, episode: Episode, candidates: CandidateSet, trust: Array, asked: Array
    ) -> tuple[Array, Array]:
        """f32[N]: logits of the draw among the trusted candidates; f32: the trust that is asked for.

        Each scene is steered by itself: at every attempt the expected change of each asked feature is what is
        still missing of it, shared by the objects left to place. Where a candidate that is trusted less comes
        nearer to that than any that is trusted as asked, f32, `least_trust` holds.
        """
        rules = self.search.rules
        focus = rules.focus(episode)
        found = candidates.found
        logits = jnp.zeros(trust.shape)
        if rules.config.natural:
            logits = natural_logits(rules.geometry, focus, candidates.supporters)
        if rules.config.clutter is None:
            return logits, asked
        rest = found.scores.fit.rest
        quaternion = rules.body(episode).quaternion
        at = Placing.of(
            episode,
            rules.geometry,
            focus,
            quaternion,
            found.candidates,
            rest,
            candidates.supporters,
        )
        remaining, added = remaining_and_added(rules.config.clutter, at)
        least = self.config.least_trust
        missed, missed_by_all = (
            shortfall(remaining, added, trust >= level) for level in (asked, least)
        )
        is_nearer = missed_by_all < missed - _CLOSER
        asked = jnp.where(jnp.any(is_nearer), jnp.minimum(asked, least), asked)
        return tilt_logits(logits, added, remaining, trust >= asked), asked

    @property
    def num_above(self) -> int:
        """Candidates over placed objects: more than the config's where objects are to lie on others."""
        asked = self.search.rules.config
        if asked.clutter is None:
            return self.config.num_above
        most = max(
            each or 0.0
            for each in (asked.clutter.stack, asked.clutter.depth, asked.clutter.contacts)
        )
        number = _MANY_ABOVE if most > _MANY * asked.num_objects else _ABOVE if most else 0
        return max(self.config.num_above, number)

    @property
    def _num_inside(self) -> int:
        """Candidates over hollows, where objects are to be inside of others."""
        asked = self.search.rules.config.clutter
        return _INSIDE if asked is not None and asked.contained else 0

    def candidates(self, key: Array, episode: Episode) -> CandidateSet:
        """The candidates for the episode's next attempt."""
        search = self.search
        config = self.config
        keys = jax.random.split(key, 3)
        scene = search.scene(episode, with_owner=True)
        drawn = [draw_candidates(keys[0], episode.region, config.num_uniform)]
        if number := _TIDY_FINALISTS if search.rules.config.tidy else config.num_finalists:
            many = draw_candidates(keys[1], episode.region, search.config.num_candidates)
            drawn.append(search.best(scene, many, number))
        if self.num_above:
            drawn.append(above_objects(keys[2], scene, search.rules, self.num_above))
        if number := self._num_inside:
            drawn.append(inside_objects(jax.random.fold_in(key, 4), scene, search.rules, number))
        if (related := search.rules.related) is not None:
            of_relations = jax.random.fold_in(key, 3)
            geometry = search.rules.geometry
            drawn.append(related_candidates(of_relations, scene, related, geometry, _RELATED))
        return self._look(scene, jax.tree.map(lambda *parts: jnp.concatenate(parts), *drawn))

    def look(self, episode: Episode, candidates: Candidates) -> CandidateSet:
        """Given candidates for the episode's next attempt."""
        return self._look(self.search.scene(episode, with_owner=True), candidates)

    def _look(self, scene: SearchScene, candidates: Candidates) -> CandidateSet:
        search = self.search
        found = search.closely(scene, candidates)
        geometry = search.rules.geometry
        episode = scene.episode
        rest = found.scores.fit.rest
        supporters = find_supporters(scene, geometry, candidates, rest)
        is_allowed = found.cost < FORBIDDEN / 2
        if (related := search.rules.related) is not None:
            assert episode.roles is not None
            carriers = carriers_of(related, episode.roles, scene.focus, episode.is_placed)
            is_allowed &= is_related(scene, related, geometry, candidates, rest)
            is_allowed &= jnp.all(supporters.touched | ~carriers, axis=1)
        return CandidateSet(found=found, supporters=supporters, is_allowed=is_allowed)


def above_objects(key: Array, scene: SearchScene, rules: Rules, number: int) -> Candidates:
    """Candidates around placed objects, uniform over the square of one drawn by footprint; region frame.

    With nothing placed they are over the region's centre.
    """
    episode = scene.episode
    half = rules.geometry.half_extents
    chance = jnp.where(
        episode.is_placed, jnp.log(footprint_area(rules.geometry.half_extents)), -jnp.inf
    )
    # Boxes are turned about z and sometimes tipped: a square with the box's diagonal is near enough.
    reach = jnp.linalg.norm(half[:, :2], axis=1) / jnp.sqrt(2.0)
    return _over(key, scene, rules, (episode.poses[:, :3], reach, chance), number)


def inside_objects(key: Array, scene: SearchScene, rules: Rules, number: int) -> Candidates:
    """Candidates over the hollows of placed objects into which the current one fits; region frame."""
    episode = scene.episode
    hollows = rules.geometry.hollows
    assert hollows is not None
    openings = hollows.boxes(safe_poses(episode.poses, episode.is_placed))
    chance = jnp.where(episode.is_placed & hollows.fits[scene.focus], 0.0, -jnp.inf)
    reach = jnp.linalg.norm(hollows.half_extents[:, :2], axis=1) / jnp.sqrt(2.0)
    # Round floors are flat in the middle alone.
    return _over(key, scene, rules, (openings.center, reach, chance), number, number // 2)


def _over(
    key: Array,
    scene: SearchScene,
    rules: Rules,
    places: tuple[Array, Array, Array],
    number: int,
    num_central: int = 0,
) -> Candidates:
    """Candidates over K places: f32[K, 3], centres, world; f32[K], half sides; f32[K], log chances.

    Args:
      num_central: so many of them are the nearer to the centre.
    """
    episode = scene.episode
    (middle, reach, chance) = places
    key_which, key_at, key_yaw = jax.random.split(key, 3)
    noise = jax.random.gumbel(key_which, (number, len(chance)))
    which = jnp.argmax(chance + noise, axis=1)
    T_region_world = episode.region.T_world_region.inverse()
    turn = T_region_world.rotation().as_matrix()
    shift = T_region_world.translation()[:2]
    center = middle[which, :2] @ turn[:2, :2].T + shift
    support_map = rules.support_map_of(episode)
    if support_map is not None and support_map.T_map_world is not None:
        center += middle[which, 2:3] * turn[:2, 2]
    offset = jax.random.uniform(key_at, (number, 2), minval=-1.0)
    if num_central:
        offset *= jnp.append(jnp.linspace(0.0, 1.0, num_central), jnp.ones(number - num_central))[
            :, None
        ]
    xy = center + reach[which, None] * offset
    xy = jnp.where(jnp.any(jnp.isfinite(chance)), xy, 0.0)
    limit = episode.region.half_extents
    yaw = jax.random.uniform(key_yaw, (number,), maxval=2 * jnp.pi)
    return Candidates(jnp.clip(xy, -limit, limit), yaw)


def natural_logits(geometry: Geometry, focus: Array, supporters: Supporters) -> Array:
    """f32[N]: log weights of candidates, 0 on the support alone and at most 0 elsewhere.

    The weight of what lies on objects is min(1, A / a)^2 s, with a the footprint of the current object's box,
    A that of the largest object that would carry it, and s the share of its base that would touch.
    """
    area = footprint_area(geometry.half_extents)
    widest = jnp.max(jnp.where(supporters.touched, area, 0.0), axis=1)
    width = jnp.minimum(jnp.log(jnp.maximum(widest, 1e-8) / area[focus]), 0.0)
    base = jnp.log(jnp.clip(supporters.base, _LEAST_BASE, 1.0))
    return jnp.where(supporters.is_on, _AREA_POWER * width + _BASE_POWER * base, 0.0)
