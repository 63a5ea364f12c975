"""Many random poses looked at coarsely, the best of them closely."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import jaxlie
from flax import struct

from cluttergen_jax.placement.heightmap import HeightMap, HeightMapper
from cluttergen_jax.placement.region import Region, action_of_pose, is_inside, is_kept_out, to_pose
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search.fit import (
    Candidates,
    LoweredFit,
    UnderSide,
    lower_onto,
    mean_under,
    support_share,
)
from cluttergen_jax.placement.support_map import most_beyond, on_map, share_beyond
from cluttergen_jax.placement.types import Body, Episode
from cluttergen_jax.types import Array

CLEARANCE = 0.001
"""Metres above its rest at which an object is released."""

FORBIDDEN = 1e6
"""Added to the cost of poses that would not count."""

_EDGE = 0.002
_BARE = 0.003
_WINDOW_DOUBLINGS = 3


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
            object.__setattr__(
                self, "mapper", HeightMapper.of(rules.geometry, rules.region, rules.map_radius)
            )

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
        cos = jnp.cos(candidates.yaw)[:, None]
        sin = jnp.sin(candidates.yaw)[:, None]
        x = under.xy[:, 0]
        y = under.xy[:, 1]
        xy = jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + candidates.xy[:, None]
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
        if (
            containment == "center"
            and not episode.keep_out.yaw.shape[0]
            and self.rules.polygon is None
        ):
            return jnp.ones_like(candidates.yaw, bool)

        def is_allowed(xy: Array, yaw: Array) -> Array:
            rotation = jaxlie.SO3.from_z_radians(yaw)
            if scene.body.quaternion is not None:
                rotation = rotation @ jaxlie.SO3(scene.body.quaternion)
            T_region_object = jaxlie.SE3.from_rotation_and_translation(
                rotation, jnp.append(xy, 0.0)
            )
            pose = to_pose(episode.region.T_world_region @ T_region_object)
            is_kept_in = is_inside(pose, half, episode.region, containment)
            placed = on_map(self.rules.support_map_of(episode), pose)
            is_kept_in &= self.rules.acceptance.is_in_polygon(placed, half)
            return is_kept_in & ~is_kept_out(placed, half, episode.keep_out)

        return jax.vmap(is_allowed)(candidates.xy, candidates.yaw)


def under_side(body: Body) -> UnderSide:
    """The under-side of an object as it is released."""
    return UnderSide(body.column_xy, body.column_bottom, body.is_column, body.center_of_mass[:2])


def _lean(body: Body, region: Region) -> Array:
    """f32[2]: see `UnderSide`."""
    down = region.T_world_region.rotation().inverse().apply(jnp.array([0.0, 0.0, -1.0]))
    return (body.center_of_mass[2] + body.height) * down[:2] / -down[2]


def draw_candidates(key: Array, region: Region, number: int) -> Candidates:
    """Uniform over one turn and over the region, but for 2 mm along its sides."""
    key_xy, key_yaw = jax.random.split(key)
    xy = jax.random.uniform(key_xy, (number, 2), minval=-1.0) * jnp.maximum(
        region.half_extents - _EDGE, 0.0
    )
    return Candidates(xy, jax.random.uniform(key_yaw, (number,), maxval=2 * jnp.pi))


def crowding(heights: HeightMap) -> HeightMap:
    """How much of the 8 x 8 cells around each cell is not bare top, 0 to 1; nothing beyond the map."""
    taken = (jnp.abs(heights.height) > _BARE).astype(jnp.float32)
    for axis in (0, 1):
        for step in (2**power for power in range(_WINDOW_DOUBLINGS)):
            sides = [(0, 0), (0, 0)]
            sides[axis] = ((step + 1) // 2, step // 2)
            padded = jnp.pad(taken, sides)
            size = taken.shape[axis]
            before = jax.lax.slice_in_dim(padded, 0, size, axis=axis)
            taken = before + jax.lax.slice_in_dim(padded, step, step + size, axis=axis)
    return heights.replace(height=taken / 4**_WINDOW_DOUBLINGS)
