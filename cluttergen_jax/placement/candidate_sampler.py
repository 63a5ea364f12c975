"""Placers that draw among the candidate poses that are trusted to stand.

The draw is uniform, or tilted as little as it takes for the clutter that is asked for (maximum entropy).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.placement.arranged_places import ArrangedPlaces
from cluttergen_jax.placement.boxes import Boxes, footprint_area
from cluttergen_jax.placement.containers import openings_of
from cluttergen_jax.placement.features import (
    Placing,
    Supporters,
    find_supporters,
    proposed_boxes,
    remaining_and_added,
)
from cluttergen_jax.placement.related import (
    ALIGNED,
    CONE,
    CONE_SPREAD,
    DIRECTIONS,
    IN,
    ON,
    TURN_SPREAD,
    USUAL_GAP,
    RelatedObjects,
    allowed_at,
    carriers_of,
    heading_of,
    leaves_room,
    preference,
    usual_heading,
)
from cluttergen_jax.placement.relations import KINDS
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search import (
    FORBIDDEN,
    Candidates,
    Search,
    SearchScene,
    TopCandidates,
    draw_candidates,
)
from cluttergen_jax.placement.types import Episode, Geometry
from cluttergen_jax.types import Array

_ABOVE = 96
_MANY_ABOVE = 192
_MANY = 0.3
"""Candidates over placed objects where some shall lie on others, and where more than `_MANY` of all shall."""
_INSIDE = 192

_RELATED = 192
"""Candidates where relations hold that are asked for."""

_USUAL = 96
"""Candidates besides, near to where people put what is so related."""
_NEARER = 3.0
"""Power of their distance from the usual one, as a share of what is allowed."""
_NEARER_MIDDLE = 0.5
"""Of the reach of what is tried on or in a thing."""
_TRUST_UNUSUAL = 0.3
"""By which the trust is multiplied in what lies on or in what usually does not carry it."""
_NATURAL = 96
"""Candidates on and beside what an object usually is on and beside."""

_TIDY_FINALISTS = 96
_CLOSER = 1e-6

_HIGHEST_COST = 10.0

_SPREAD = 0.09
"""Radians by which what is to be aligned is turned from it at most: half of what is allowed."""
_WITHIN = {"on": 0.9, "in": 0.5}
"""Of half the diagonal of a box: over so much of it things are tried that lie on it or in it."""

# Of the tilt: Newton steps, the penalty on a slope, the steepest, and shares of a step that are tried.
_STEPS = 12
_RIDGE = 1e-3
_STEEPEST = 12.0
_DAMPING = (1.0, 0.5, 0.25, 0.06)


@dataclass(frozen=True)
class CandidateConfig:
    """How many candidates are looked at, and which are trusted.

    Attributes:
      num_uniform: uniform over region and turn.
      num_finalists: the cheapest of many by the search's cost (`SearchConfig.num_candidates`).
      thresholds: the trust asked for at an object's first attempt, its second, and so on; the last one holds
        for all further ones. Where no candidate has it, the most trusted one is taken.
      least_trust: the trust asked for where a candidate with no more comes nearer to what `Clutter` asks.
    """

    num_uniform: int = 80
    num_finalists: int = 16
    thresholds: tuple[float, ...] = (0.9, 0.8, 0.6)
    least_trust: float = 0.3


class CandidateSet(struct.PyTreeNode):
    """N candidates for one attempt, wholly looked at.

    Attributes:
      found: where they are and how they would lie.
      supporters: what would carry them.
      is_allowed: bool[N], those that would count.
      preference: f32[N], log weights of places by relations (`related.preference`); None where all are alike.
    """

    found: TopCandidates
    supporters: Supporters
    is_allowed: Array
    preference: Array | None = None


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
        if (natural := self.search.rules.natural) is not None:
            rules = self.search.rules
            at = (episode, rules.geometry, rules.focus(episode), candidates.supporters)
            trust = jnp.where(natural.is_sensible(*at), trust, _TRUST_UNUSUAL * trust)
        thresholds = jnp.array(self.config.thresholds)
        asked = thresholds[jnp.minimum(episode.attempt, len(thresholds) - 1)]
        noise = jax.random.gumbel(key_choice, trust.shape)
        if self.search.rules.config.tidy:
            noise = -jnp.minimum(candidates.found.cost, _HIGHEST_COST)
        if self.is_tilted:
            logits, asked = self.tilt(episode, candidates, trust, asked)
            noise += logits
        elif candidates.preference is not None:
            noise += candidates.preference
        # Whoever is trusted comes before all others, and among the others the most trusted.
        rank = jnp.where(trust >= asked, 2.0 + noise - jnp.min(noise), trust)
        if candidates.preference is not None:
            # Where none would count, at least one near to where it is to be: it may settle there.
            rank += jnp.where(candidates.is_allowed, 0.0, candidates.preference)
        action = candidates.found.action[jnp.argmax(rank)]
        related = self.search.rules.related
        if related is None or not related.is_arranged:
            return action
        places = ArrangedPlaces(self.search, related)
        arranged, is_next = places(jax.random.fold_in(key, 7), episode)
        return jnp.where(is_next, arranged, action)

    @property
    def is_tilted(self) -> bool:
        """Whether the draw is other than uniform: features are asked for, or what looks natural."""
        asked = self.search.rules.config
        return asked.drawn_clutter is not None or asked.natural

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
        may_count = None
        if (natural := rules.natural) is not None:
            logits = natural.logits(episode, rules.geometry, focus, candidates)
            # Targets are met by what makes sense, or not at all.
            may_count = natural.is_sensible(episode, rules.geometry, focus, candidates.supporters)
        if candidates.preference is not None:
            logits += candidates.preference
        if rules.config.drawn_clutter is None:
            return logits, asked
        at = Placing.of(
            episode,
            rules.geometry,
            focus,
            rules.body(episode).quaternion,
            found.candidates,
            found.scores.fit.rest,
            candidates.supporters,
        )
        remaining, added = remaining_and_added(rules.config.drawn_clutter, at)
        least = self.config.least_trust
        if may_count is not None:
            trust = jnp.where(may_count, trust, -1.0)
        missed = shortfall(remaining, added, trust >= asked)
        is_nearer = shortfall(remaining, added, trust >= least) < missed - _CLOSER
        asked = jnp.where(jnp.any(is_nearer), jnp.minimum(asked, least), asked)
        return tilt_logits(logits, added, remaining, trust >= asked), asked

    @property
    def _num_above(self) -> int:
        """Candidates over placed objects, where objects are to lie on others, or have to."""
        asked = self.search.rules.config
        clutter = asked.drawn_clutter
        if asked.is_crowded:
            return _MANY_ABOVE
        if clutter is None:
            return 0
        most = max(clutter.stack or 0.0, clutter.depth or 0.0, clutter.contacts or 0.0)
        if most > _MANY * asked.num_objects:
            return _MANY_ABOVE
        return _ABOVE if most else 0

    @property
    def _num_inside(self) -> int:
        """Candidates over hollows, where objects are to be inside of others."""
        asked = self.search.rules.config.drawn_clutter
        return _INSIDE if asked is not None and asked.contained else 0

    def candidates(self, key: Array, episode: Episode) -> CandidateSet:
        """The candidates for the episode's next attempt."""
        search = self.search
        config = self.config
        keys = jax.random.split(key, 3)
        scene = search.scene(episode, with_owner=True)
        natural = search.rules.natural
        drawn = [draw_candidates(keys[0], episode.region, config.num_uniform)]
        if natural is not None:
            drawn[0] = natural.turn_candidates(jax.random.fold_in(key, 7), scene, drawn[0])
        if number := _TIDY_FINALISTS if search.rules.config.tidy else config.num_finalists:
            many = draw_candidates(keys[1], episode.region, search.config.num_candidates)
            if natural is not None:
                many = natural.turn_candidates(jax.random.fold_in(key, 8), scene, many)
            drawn.append(search.best(scene, many, number))
        if number := self._num_above:
            above = above_objects(keys[2], scene, search.rules, number)
            if natural is not None:
                above = natural.turn_candidates(jax.random.fold_in(key, 9), scene, above)
            drawn.append(above)
        if number := self._num_inside:
            drawn.append(inside_objects(jax.random.fold_in(key, 4), scene, search.rules, number))
        if natural is not None:
            of_sense = jax.random.fold_in(key, 10)
            drawn.append(natural.candidates(of_sense, scene, search.rules.geometry, _NATURAL))
        if (related := search.rules.related) is not None:
            of_relations = jax.random.fold_in(key, 3)
            geometry = search.rules.geometry
            beside = [related_candidates(of_relations, scene, related, geometry, _RELATED)]
            if search.rules.config.relations_prefer:
                usual = jax.random.fold_in(key, 5)
                beside.append(usual_candidates(usual, scene, related, geometry, _USUAL))
            if natural is not None:
                keys = jax.random.split(jax.random.fold_in(key, 11), len(beside))
                beside = [
                    natural.face_seat(each, scene, some)
                    for each, some in zip(keys, beside, strict=True)
                ]
            drawn += beside
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
        weights = None
        if (natural := search.rules.natural) is not None:
            is_allowed &= natural.is_allowed(scene.focus, supporters)
        if (related := search.rules.related) is not None:
            half = geometry.half_extents
            proposed = proposed_boxes(
                episode.region, half[scene.focus], scene.body.quaternion, candidates, rest
            )
            is_allowed &= leaves_room(related, episode, scene.focus, candidates.xy, geometry)
            is_allowed &= allowed_at(related, episode, scene.focus, proposed, geometry)
            carriers = carriers_of(related, episode, scene.focus)
            is_allowed &= jnp.all(supporters.touched | ~carriers, axis=1)
            if search.rules.config.relations_prefer:
                weights = preference(related, episode, scene.focus, proposed, geometry)
        return CandidateSet(found, supporters, is_allowed, weights)


def above_objects(key: Array, scene: SearchScene, rules: Rules, number: int) -> Candidates:
    """Candidates around placed objects, uniform over the square of one drawn by footprint; region frame.

    With nothing placed they are over the region's centre.
    """
    episode = scene.episode
    half = rules.geometry.half_extents
    chance = jnp.where(episode.is_placed, jnp.log(footprint_area(half)), -jnp.inf)
    # Boxes are turned about z and sometimes tipped: a square with the box's diagonal is near enough.
    reach = jnp.linalg.norm(half[:, :2], axis=1) / jnp.sqrt(2.0)
    return _over(key, scene, rules, (episode.poses[:, :3], reach, chance), number)


def inside_objects(key: Array, scene: SearchScene, rules: Rules, number: int) -> Candidates:
    """Candidates over the hollows of placed objects into which the current one fits; region frame."""
    episode = scene.episode
    hollows = rules.geometry.hollows
    assert hollows is not None
    openings = hollows.boxes(episode.safe_poses)
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
    middle, reach, chance = places
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
        share = jnp.append(jnp.linspace(0.0, 1.0, num_central), jnp.ones(number - num_central))
        offset *= share[:, None]
    xy = center + reach[which, None] * offset
    xy = jnp.where(jnp.any(jnp.isfinite(chance)), xy, 0.0)
    limit = episode.region.half_extents
    yaw = jax.random.uniform(key_yaw, (number,), maxval=2 * jnp.pi)
    return Candidates(jnp.clip(xy, -limit, limit), yaw)


def related_candidates(
    key: Array, scene: SearchScene, related: RelatedObjects, geometry: Geometry, number: int
) -> Candidates:
    """Candidates around what the current object is related to, each for one relation; region frame.

    They are uniform over the region where it has none with what is placed, and fit one relation, not all.
    """
    return _around_related(key, scene, related, geometry, number)


def usual_candidates(
    key: Array, scene: SearchScene, related: RelatedObjects, geometry: Geometry, number: int
) -> Candidates:
    """Likewise, near to where and turned as people put what is so related (`related.preference`)."""
    return _around_related(key, scene, related, geometry, number, is_usual=True)


def _around_related(
    key: Array,
    scene: SearchScene,
    related: RelatedObjects,
    geometry: Geometry,
    number: int,
    is_usual: bool = False,
) -> Candidates:
    episode = scene.episode
    region = episode.region
    assert episode.roles is not None
    key_which, key_xy, key_angle, key_far, key_yaw = jax.random.split(key, 5)
    is_subject, is_reference, other, is_table = related.pairs(episode.roles, scene.focus)
    is_mine = is_subject | is_reference
    is_there = is_mine & episode.is_placed[other] & ~is_table
    is_place = is_there & jnp.isin(related.kind, jnp.array(_PLACES))
    which = jax.random.categorical(key_which, jnp.where(is_place, 0.0, -jnp.inf), shape=(number,))
    kind = related.kind[which]
    placed = Boxes.of(geometry.half_extents, episode.safe_poses)
    openings = openings_of(geometry, episode.safe_poses)
    T_region_world = region.T_world_region.inverse()
    turn = T_region_world.rotation().as_matrix()

    def of_other(boxes: Boxes) -> tuple[Array, Array]:
        """f32[N, 2] the centre of the other object's box, f32[N, 3] its sides in plan, ascending."""
        middle = jax.vmap(T_region_world.apply)(boxes.center)[other[which], :2]
        plan = jnp.sort(jnp.linalg.norm(boxes.sides[..., :2], axis=-1), axis=-1)
        return middle, plan[other[which]]

    is_in = (kind == IN)[:, None]
    opening_center, opening_plan = of_other(openings)
    placed_center, placed_plan = of_other(placed)
    center = jnp.where(is_in, opening_center, placed_center)
    plan = jnp.where(is_in, opening_plan, placed_plan)
    own = scene.body.half_extents[:2]
    diagonal = jnp.linalg.norm(plan[:, 1:], axis=1)
    unit = jax.random.uniform(key_xy, (number, 2), minval=-1.0)
    # Beside it, in the direction of the relation, from touching to as far away as is allowed.
    angle = jnp.array(_ANGLES)[kind] + jnp.where(is_subject[which], 0.0, jnp.pi)
    aside = jax.random.uniform(key_angle, (number,), minval=-1.0)
    if is_usual:
        usual = jax.random.truncated_normal(key_angle, -2.5, 2.5, (number,))
        aside = jnp.where(jnp.array(_HAS_SIDE)[kind], usual * CONE_SPREAD / CONE, aside)
    angle += jnp.array(_CONES)[kind] * aside
    nearest = plan[:, 1] + jnp.min(own)
    farthest = diagonal + jnp.linalg.norm(own) + jnp.nan_to_num(related.gap[which])
    share = jax.random.uniform(key_far, (number,))
    if is_usual:
        share = share**_NEARER
        nearest += USUAL_GAP * jnp.nan_to_num(related.gap[which])
        unit *= _NEARER_MIDDLE
    far = nearest + (farthest - nearest) * share
    beside = far[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    over = unit * (jnp.array(_OVER)[kind] * diagonal / jnp.sqrt(2.0))[:, None]
    is_over = (kind == ON) | (kind == IN)
    xy = center + jnp.where(is_over[:, None], over, beside)
    xy = jnp.where(jnp.any(is_place), xy, unit * region.half_extents)
    is_aligned = is_mine & (related.kind == ALIGNED) & (episode.is_placed[other] | is_table)
    first = jnp.argmax(is_aligned)
    heading = heading_of(placed, turn)[other[first]]
    yaw = _aligned_yaws(key_yaw, scene, jnp.any(is_aligned), heading, is_table[first], number)
    if is_usual:
        line = jnp.where(jnp.array(_HAS_SIDE)[kind], jnp.array(_ANGLES)[kind], angle)
        wanted = usual_heading(line + jnp.pi / 2, placed.take(other[which]), turn)
        beside_yaw = _yaws_along(jax.random.fold_in(key_yaw, 0), scene, wanted)
        is_turned = jnp.any(is_place) & ~jnp.any(is_aligned) & ~is_over
        yaw = jnp.where(is_turned, beside_yaw, yaw)
    return Candidates(jnp.clip(xy, -region.half_extents, region.half_extents), yaw)


def _yaws_along(key: Array, scene: SearchScene, heading: Array) -> Array:
    """f32[N]: turns with the current object's longest side along headings f32[N], to either side."""
    key_side, key_spread = jax.random.split(key)
    half = scene.body.half_extents
    yaw = heading - jnp.where(half[1] > half[0], jnp.pi / 2, 0.0)
    yaw += jnp.pi * jax.random.randint(key_side, heading.shape, 0, 2)
    return yaw + TURN_SPREAD * jax.random.truncated_normal(key_spread, -2.0, 2.0, heading.shape)


_PLACES = [place for place, kind in enumerate(KINDS) if kind not in ("far_from", "aligned")]
# By kind: radians, the direction in which the subject is, and to either side of it.
_ANGLES = [math.atan2(y, x) for x, y in DIRECTIONS]
_CONES = [CONE if any(direction) else math.pi for direction in DIRECTIONS]
_HAS_SIDE = [any(direction) for direction in DIRECTIONS]
_OVER = [_WITHIN.get(kind, 0.0) for kind in KINDS]


def _aligned_yaws(
    key: Array,
    scene: SearchScene,
    is_asked: Array,
    heading: Array,
    is_table: Array,
    number: int,
) -> Array:
    """f32[N]: turns along a heading, f32 radians, or the region's sides; any turn where none is asked for."""
    key_turn, key_side, key_spread = jax.random.split(key, 3)
    along = jnp.where(is_table, 0.0, heading)
    half = scene.body.half_extents
    along -= jnp.where(half[1] > half[0], jnp.pi / 2, 0.0)
    period = jnp.where(is_table, jnp.pi / 2, jnp.pi)
    aligned = along + period * jax.random.randint(key_side, (number,), 0, 4)
    aligned += _SPREAD * jax.random.uniform(key_spread, (number,), minval=-1.0)
    any_turn = jax.random.uniform(key_turn, (number,), maxval=2 * jnp.pi)
    return jnp.where(is_asked, aligned, any_turn)


def tilt_logits(logits: Array, values: Array, asked: Array, is_allowed: Array) -> Array:
    """f32[N]: logits of weights w of those allowed, nearest to softmax(logits), with w . values = asked.

    w is proportional to exp(logits + values . lambda), lambda the minimum of the convex
    logsumexp(logits + values . lambda) - asked . lambda + 0.0005 |lambda|^2 by damped Newton steps, values in
    units of their standard deviation. What is out of reach is met as nearly as |lambda| <= 12 can.

    Args:
      logits: f32[N], of the weights to stay near to; 0 for equal ones.
      values: f32[N, F]; asked: f32[F].
      is_allowed: bool[N]; if none is, the logits come back as they are.
    """
    any_allowed = jnp.any(is_allowed)
    counts = is_allowed | ~any_allowed
    base = jnp.where(counts, logits, -jnp.inf)
    number = counts.sum()
    mean = jnp.sum(jnp.where(counts[:, None], values, 0.0), axis=0) / number
    offset = jnp.where(counts[:, None], values - mean, 0.0)
    scale = jnp.sqrt(jnp.sum(offset**2, axis=0) / number)
    unit = jnp.where(scale > 1e-6, scale, 1.0)
    # A feature in which all are alike decides nothing, whatever is asked.
    features = jnp.where(scale > 1e-6, offset / unit, 0.0)
    target = jnp.where(scale > 1e-6, (asked - mean) / unit, 0.0)
    target = jnp.clip(target, features.min(0), features.max(0))

    def objective(slope: Array) -> Array:
        fit = jax.nn.logsumexp(base + features @ slope) - target @ slope
        return fit + _RIDGE / 2 * slope @ slope

    def step(_: int, slope: Array) -> Array:
        weight = jax.nn.softmax(base + features @ slope)
        expected = weight @ features
        gradient = expected - target + _RIDGE * slope
        spread = features - expected
        curvature = (spread * weight[:, None]).T @ spread + _RIDGE * jnp.eye(len(slope))
        newton = jnp.linalg.solve(curvature, gradient)
        tries = slope - jnp.array([*_DAMPING, 0.0])[:, None] * newton
        tries = jnp.clip(tries, -_STEEPEST, _STEEPEST)
        return tries[jnp.argmin(jax.vmap(objective)(tries))]

    slope = jax.lax.fori_loop(0, _STEPS, step, jnp.zeros(values.shape[1]))
    return jnp.where(any_allowed, logits + features @ slope, logits)


def shortfall(asked: Array, values: Array, is_allowed: Array) -> Array:
    """f32[F]: how far each of f32[F] is from the range of f32[N, F] among those allowed; inf if none is."""
    low = jnp.min(jnp.where(is_allowed[:, None], values, jnp.inf), axis=0)
    high = jnp.max(jnp.where(is_allowed[:, None], values, -jnp.inf), axis=0)
    return jnp.maximum(jnp.maximum(low - asked, asked - high), 0.0)
