"""Where an object could go, by geometry alone: lowered vertically to first contact at many random poses.

All are looked at coarsely, with some of the object's columns, the best of them closely.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from flax import struct

from cluttergen_jax.placement.heightmap import (
    VOID,
    HeightMap,
    HeightMapper,
    most_beyond,
    on_map,
    share_beyond,
)
from cluttergen_jax.placement.region import Region, action_of_pose, is_inside, is_kept_out, to_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.types import Body, Episode, Geometry, Orientations, look_up, take
from cluttergen_jax.types import Array

_CONTACT_GAP = 0.0015
_BASE = 0.003
_BARE = 0.003
_DEEP = -0.03
_DIRECTIONS = 12

CLEARANCE = 0.001
"""Metres above its rest at which an object is released."""
FORBIDDEN = 1e6
"""Added to the cost of poses that would not count."""
_EDGE = 0.002
_WINDOW_DOUBLINGS = 3


class Candidates(struct.PyTreeNode):
    """Positions and turns in the region frame. N candidates.

    Attributes:
      xy: f32[N, 2], metres; yaw: f32[N], radians.
    """

    xy: Array
    yaw: Array

    def take(self, index: Array) -> Candidates:
        """The candidates at `index`, i32[M]."""
        return take(self, index)

    def turned(self, xy: Array) -> tuple[Array, Array]:
        """f32[N, C] each: x and y of an object's points f32[C, 2], turned as at each candidate, metres."""
        cos = jnp.cos(self.yaw)[:, None]
        sin = jnp.sin(self.yaw)[:, None]
        return cos * xy[:, 0] - sin * xy[:, 1], sin * xy[:, 0] + cos * xy[:, 1]


class UnderSide(struct.PyTreeNode):
    """What of an object can touch what lies below: a sample of its columns, object frame, metres.

    Attributes:
      xy: f32[C, 2]; bottom: f32[C]; is_column: bool[C].
      center_of_mass: f32[2].
      lean: f32[2], of the region frame: how far the centre of mass is from there, down the slope, where a
        plumb line through it meets the base; None on a level surface.
    """

    xy: Array
    bottom: Array
    is_column: Array
    center_of_mass: Array
    lean: Array | None = None

    @property
    def lowest(self) -> Array:
        """f32: the bottom of the lowest column."""
        return jnp.min(jnp.where(self.is_column, self.bottom, jnp.inf))

    @property
    def is_base(self) -> Array:
        """bool[C]: the base, the lowest of the columns."""
        return self.is_column & (self.bottom < self.lowest + _BASE)

    def first(self, number: int) -> UnderSide:
        """A coarser sample."""
        return self.replace(
            xy=self.xy[:number], bottom=self.bottom[:number], is_column=self.is_column[:number]
        )


class LoweredFit(struct.PyTreeNode):
    """How N candidates would lie.

    Attributes:
      rest: f32[N], height of the object's origin above the top when it first touches something, metres.
      blocked: f32[N], share of its columns over other objects.
      hanging: f32[N], share of its columns over nothing at all.
      gap: f32[N], mean distance from its base, the lowest of its columns, down to what lies below, metres.
      room: f32[N], the lowest height over its columns at which the support hangs over it; None where it does
        nowhere.
    """

    rest: Array
    blocked: Array
    hanging: Array
    gap: Array
    room: Array | None = None


def lower_onto(under: UnderSide, heights: HeightMap, candidates: Candidates) -> LoweredFit:
    """Lowers an object vertically to first contact with a height map, at each candidate."""
    cells = cells_under(under, heights, candidates)
    below = heights.at(cells)
    is_column = under.is_column
    lowest = under.lowest
    is_base = is_column & (under.bottom < lowest + _BASE)
    rest, blocked, hanging, base = _reduce(
        (jnp.where(is_column, below - under.bottom, VOID), jnp.maximum, VOID),
        (((below > _BARE) & is_column).astype(jnp.float32), jnp.add, 0.0),
        (((below <= VOID) & is_column).astype(jnp.float32), jnp.add, 0.0),
        (jnp.where(is_base, jnp.maximum(below, _DEEP), 0.0), jnp.add, 0.0),
    )
    total = jnp.maximum(is_column.sum(), 1)
    gap = rest + lowest - base / jnp.maximum(is_base.sum(), 1)
    room = None
    if heights.ceiling is not None:
        above = look_up(heights.ceiling, cells)
        room = jnp.min(jnp.where(is_column, above, jnp.inf), axis=1)
    return LoweredFit(rest, blocked / total, hanging / total, gap, room)


def mean_under(under: UnderSide, field: HeightMap, candidates: Candidates) -> Array:
    """f32[N]: the mean of any map over the object's columns at each candidate."""
    values = jnp.where(under.is_column, field.at(cells_under(under, field, candidates)), 0.0)
    return values.sum(1) / jnp.maximum(under.is_column.sum(), 1)


def support_share(
    under: UnderSide, heights: HeightMap, candidates: Candidates, rest: Array
) -> Array:
    """f32[N]: how far inside what carries it the centre of mass is, over the same on flat ground.

    1 is as good as the bare top; below 0 it tips. Distances are the smallest over some directions.

    Args:
      rest: f32[N], from `lower_onto`.
    """
    touches = touching(under, heights, candidates, rest)
    on_ground = (under.bottom < under.lowest + _CONTACT_GAP) & under.is_column
    yaw = None if under.lean is None else candidates.yaw
    return _margin(under, touches, yaw) / jnp.maximum(_margin(under, on_ground[None]), 1e-3)


def touching(under: UnderSide, heights: HeightMap, candidates: Candidates, rest: Array) -> Array:
    """bool[N, C]: the columns that would touch what lies below, at the heights `rest`, f32[N]."""
    below = heights.at(cells_under(under, heights, candidates))
    return (rest[:, None] + under.bottom - below < _CONTACT_GAP) & under.is_column


def base_share(under: UnderSide, touches: Array) -> Array:
    """f32[N]: the share of the base, the lowest of the columns, that touches; bool[N, C] from `touching`."""
    is_base = under.is_base
    return jnp.sum(touches & is_base, axis=1) / jnp.maximum(is_base.sum(), 1)


def _margin(under: UnderSide, touches: Array, yaw: Array | None = None) -> Array:
    """f32[N], metres: how far the centre of mass is inside the columns that touch, bool[N, C].

    Args:
      yaw: f32[N], of the candidates, where it leans down a slope.
    """
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    offset = under.xy - under.center_of_mass
    reach = [np.cos(angle) * offset[:, 0] + np.sin(angle) * offset[:, 1] for angle in angles]
    farthest = _reduce(*((jnp.where(touches, one, -1.0), jnp.maximum, -1.0) for one in reach))
    if yaw is not None and under.lean is not None:
        cos = jnp.cos(yaw)
        sin = jnp.sin(yaw)
        x = cos * under.lean[0] + sin * under.lean[1]
        y = cos * under.lean[1] - sin * under.lean[0]
        farthest = tuple(
            each - (np.cos(angle) * x + np.sin(angle) * y)
            for each, angle in zip(farthest, angles, strict=True)
        )
    return jnp.min(jnp.stack(farthest), axis=0)


def _reduce(*terms: tuple[Array, Callable[[Array, Array], Array], float]) -> tuple[Array, ...]:
    """Reduces several arrays along their last axis in one pass.

    Reduced one by one, each would look up the height map again: on a CPU that is most of the cost.

    Args:
      terms: f32[N, C], the function that joins two entries, and its neutral element.
    """
    joins = [join for _, join, _ in terms]
    return jax.lax.reduce(
        tuple(array for array, _, _ in terms),
        tuple(jnp.float32(start) for _, _, start in terms),
        lambda left, right: tuple(
            join(a, b) for join, a, b in zip(joins, left, right, strict=True)
        ),
        (1,),
    )


def cells_under(under: UnderSide, heights: HeightMap, candidates: Candidates) -> Array:
    """i32[N, C]: the cell under each column at each candidate."""
    x, y = candidates.turned(under.xy)
    return heights.index_of(x + candidates.xy[:, 0, None], y + candidates.xy[:, 1, None])


@dataclass(frozen=True)
class SearchConfig:
    """How long to look.

    Attributes:
      num_candidates: random poses.
      num_coarse: columns of the object that are lowered at each of them.
      num_finalists: the poses among them at which the whole under-side is.
    """

    num_candidates: int = 768
    num_coarse: int = 24
    num_finalists: int = 48


class CandidateScores(struct.PyTreeNode):
    """What is known of N candidates when they are ranked.

    Attributes:
      fit: how they would lie.
      lift: f32[N], metres higher than on the bare top.
      support: f32[N], `fit.support_share`; 1 where it was not looked at.
      crowd: f32[N], how much of their surroundings is taken or beyond the support, 0 to 1.
      attempt: i32, attempts of this object that have failed.
    """

    fit: LoweredFit
    lift: Array
    support: Array
    crowd: Array
    attempt: Array


class TopCandidates(struct.PyTreeNode):
    """The most promising poses of one search, M of them.

    Attributes:
      candidates: positions and turns, region frame.
      scores: what is known of them, wholly looked at.
      cost: f32[M], what the search keeps low; at least FORBIDDEN for poses that would not count.
      action: f32[M, 4], the actions that propose them.
    """

    candidates: Candidates
    scores: CandidateScores
    cost: Array
    action: Array


class SearchScene(struct.PyTreeNode):
    """What a search knows of an episode before it looks at candidates.

    Attributes:
      episode: its state; focus: i32, the current object.
      height_range: f32, metres, of actions (`Rules.height_range`).
      heights: the scene from above; crowded: how much of each cell's surroundings is taken (`crowding`).
      body: the current object as it is released; under: its under-side; sparse: some of its columns.
    """

    episode: Episode
    focus: Array
    body: Body
    height_range: Array
    heights: HeightMap
    crowded: HeightMap
    under: UnderSide
    sparse: UnderSide


class Search(struct.PyTreeNode, eq=False):
    """Proposes the cheapest of many poses, uniform over region and turn; a subclass says what is cheap.

    Attributes:
      rules: of the world; config: how long to look.
      mapper: makes height maps of its scenes; made here if not given.
    """

    rules: Rules
    config: SearchConfig = struct.field(pytree_node=False, default=SearchConfig())
    mapper: HeightMapper | None = None

    def __post_init__(self) -> None:
        if self.mapper is None:
            rules = self.rules
            mapper = HeightMapper.of(rules.geometry, rules.region, rules.map_radius)
            object.__setattr__(self, "mapper", mapper)

    def cost(self, scores: CandidateScores) -> Array:
        """f32[N]: what to keep low. Among equals the first is taken, which is a random one."""
        raise NotImplementedError

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        candidates = draw_candidates(key, episode.region, self.config.num_candidates)
        found = self.closely(self.scene(episode), candidates, self.config.num_finalists)
        return found.action[jnp.argmin(found.cost)]

    def scene(self, episode: Episode, with_owner: bool = False) -> SearchScene:
        """What there is to know of an episode before candidates are looked at."""
        focus = self.rules.focus(episode)
        mapper = self.mapper
        support_map = self.rules.support_map_of(episode)
        assert mapper is not None
        if episode.surface is not None:
            mapper = mapper.replace(support_map=support_map)
        heights = mapper(episode.region, episode.poses, episode.is_placed, with_owner)
        body = self.rules.body(episode)
        under = under_side(body)
        if support_map is not None and support_map.T_map_world is not None:
            under = under.replace(lean=_lean(body, episode.region))
        return SearchScene(
            episode=episode,
            focus=focus,
            body=body,
            height_range=self.rules.height_range(episode),
            heights=heights,
            crowded=crowding(heights),
            under=under,
            sparse=under.first(self.config.num_coarse),
        )

    def best(self, scene: SearchScene, candidates: Candidates, number: int) -> Candidates:
        """The cheapest of many candidates, looked at coarsely."""
        fit = lower_onto(scene.sparse, scene.heights, candidates)
        _, cost = self._rank(scene, candidates, fit, jnp.ones_like(fit.rest))
        return candidates.take(jax.lax.top_k(-cost, number)[1])

    def closely(
        self, scene: SearchScene, candidates: Candidates, number: int | None = None
    ) -> TopCandidates:
        """Candidates wholly looked at: those that `best` finds, or all of them."""
        finalists = candidates if number is None else self.best(scene, candidates, number)
        fit = lower_onto(scene.under, scene.heights, finalists)
        support = support_share(scene.under, scene.heights, finalists, fit.rest)
        scores, cost = self._rank(scene, finalists, fit, support)
        position = jnp.concatenate([finalists.xy, fit.rest[:, None] + CLEARANCE], axis=1)
        action = jax.vmap(action_of_pose, in_axes=(0, 0, None, None))(
            position, finalists.yaw, scene.episode.region, scene.height_range
        )
        return TopCandidates(finalists, scores, cost, action)

    def _rank(
        self, scene: SearchScene, candidates: Candidates, fit: LoweredFit, support: Array
    ) -> tuple[CandidateScores, Array]:
        """What is known of candidates, and f32[N] what each costs."""
        crowd = mean_under(scene.sparse, scene.crowded, candidates)
        scores = CandidateScores(
            fit, fit.rest - scene.body.height, support, crowd, scene.episode.attempt
        )
        is_allowed = self._is_allowed(scene, candidates)
        is_allowed &= fit.rest + CLEARANCE <= scene.height_range
        if fit.room is not None:
            upper = 2 * scene.body.half_extents[2] - scene.body.height
            is_allowed &= fit.rest + upper + 2 * CLEARANCE <= fit.room
        cost = self.cost(scores)
        return scores, jnp.where(is_allowed, cost, cost + FORBIDDEN)

    def _is_allowed(self, scene: SearchScene, candidates: Candidates) -> Array:
        """bool[N]: where the object would count as inside, out of every keep-out box and on the support."""
        is_in_region = self._is_in_region(scene, candidates)
        if self.rules.config.overhang == "any":
            return is_in_region
        support_map = self.rules.support_map_of(scene.episode) or self.rules.support_map
        assert support_map is not None
        under = scene.under
        xy = jnp.stack(candidates.turned(under.xy), axis=-1) + candidates.xy[:, None]
        T_map_region = support_map.place(scene.episode.region.T_world_region)
        turn = T_map_region.rotation().as_matrix()[:2, :2]
        shift = T_map_region.translation()[:2]
        share = share_beyond(support_map, xy @ turn.T + shift, under.is_column)
        return is_in_region & (share <= most_beyond(self.rules.config.overhang))

    def _is_in_region(self, scene: SearchScene, candidates: Candidates) -> Array:
        """bool[N]: where the object would be inside and out of every keep-out box."""
        episode = scene.episode
        half = self.rules.geometry.half_extents[scene.focus]
        containment = self.rules.config.containment
        is_bounded = episode.keep_out.yaw.shape[0] or self.rules.polygon is not None
        if containment == "center" and not is_bounded:
            return jnp.ones_like(candidates.yaw, bool)

        def is_allowed(xy: Array, yaw: Array) -> Array:
            rotation = jaxlie.SO3.from_z_radians(yaw)
            if scene.body.quaternion is not None:
                rotation = rotation @ jaxlie.SO3(scene.body.quaternion)
            position = jnp.append(xy, 0.0)
            T_region_object = jaxlie.SE3.from_rotation_and_translation(rotation, position)
            pose = to_pose(episode.region.T_world_region @ T_region_object)
            is_kept_in = is_inside(pose, half, episode.region, containment)
            placed = on_map(self.rules.support_map_of(episode), pose)
            is_kept_in &= self.rules.is_in_polygon(placed, half)
            return is_kept_in & ~is_kept_out(placed, half, episode.keep_out)

        return jax.vmap(is_allowed)(candidates.xy, candidates.yaw)


def under_side(body: Body | Geometry | Orientations) -> UnderSide:
    """The under-side of an object as it is released, or those of several: leading axes as they are."""
    center = body.center_of_mass[..., :2]
    return UnderSide(body.column_xy, body.column_bottom, body.is_column, center)


def _lean(body: Body, region: Region) -> Array:
    """f32[2]: see `UnderSide`."""
    down = region.T_world_region.rotation().inverse().apply(jnp.array([0.0, 0.0, -1.0]))
    return (body.center_of_mass[2] + body.height) * down[:2] / -down[2]


def draw_candidates(key: Array, region: Region, number: int) -> Candidates:
    """Uniform over one turn and over the region, but for 2 mm along its sides."""
    key_xy, key_yaw = jax.random.split(key)
    reach = jnp.maximum(region.half_extents - _EDGE, 0.0)
    xy = jax.random.uniform(key_xy, (number, 2), minval=-1.0) * reach
    return Candidates(xy, jax.random.uniform(key_yaw, (number,), maxval=2 * jnp.pi))


def crowding(heights: HeightMap) -> HeightMap:
    """How much of the 8 x 8 cells around each cell is not bare top, 0 to 1; nothing beyond the map."""
    taken = (jnp.abs(heights.height) > _BARE).astype(jnp.float32)
    for axis in (0, 1):
        for power in range(_WINDOW_DOUBLINGS):
            step = 2**power
            sides = [(0, 0), (0, 0)]
            sides[axis] = ((step + 1) // 2, step // 2)
            padded = jnp.pad(taken, sides)
            size = taken.shape[axis]
            before = jax.lax.slice_in_dim(padded, 0, size, axis=axis)
            taken = before + jax.lax.slice_in_dim(padded, step, step + size, axis=axis)
    return heights.replace(height=taken / 4**_WINDOW_DOUBLINGS)
