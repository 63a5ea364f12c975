"""`packed`: objects upright, shoulder to shoulder, each outline a clearance away from the next."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.placement.boxes import askew
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.outlines import (
    NUM_DIRECTIONS,
    Obstacles,
    Outlines,
    directions,
    reach_of,
)
from cluttergen_jax.placement.region import action_of_pose, from_pose, safe_poses
from cluttergen_jax.placement.search import CLEARANCE, FORBIDDEN, Candidates, SearchScene
from cluttergen_jax.placement.types import Episode
from cluttergen_jax.types import Array

# Turns that are tried: along the region's sides, and others.
_SQUARE = 4
_OTHER = 8
# Places at which each is tried: anywhere, and next to what stands there.
_ANYWHERE = 64
_BESIDE = 128
_SLID = 96
"""Places from which the object is slid as far as it goes."""
_ROUNDS = 3
# Metres beyond the clearance at which outlines count as side by side; of float32.
_TOUCHING = 0.002
_ROUNDING = 1e-5

# Cost of the far corner over that of an outline that touches nothing; noise after a failed attempt, and
# of the choice of places to slide from.
_FAR = 0.6
_SHY = 0.5


class Packed(LowestFit, eq=False):
    """Puts an object where most of its outline is next to others and to the region's sides.

    Outlines are seen from above, as convex pieces. From many free places the object is slid into the corner
    that depends on the scene's objects, until it touches on both sides (bottom-left: Baker, Coffman and
    Rivest, 1980); of where it ends up, the place with the most contact near that corner is taken (touching
    perimeter: Lodi, Martello and Vigo, 1999). Where the top has no room, the object is lowered to where it
    lies lowest, as by `drop`.
    """

    outlines: Outlines | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.outlines is None:
            object.__setattr__(self, "outlines", Outlines.of(self.rules.geometry))

    def __call__(self, key: Array, episode: Episode) -> Array:
        """See `placement.rules.Proposer`."""
        key_turn, key_place, key_slide, key_cost, key_drop = jax.random.split(key, 5)
        assert self.outlines is not None
        region = episode.region
        room = region.half_extents
        focus = self.rules.focus(episode)
        clearance = self.rules.config.clearance
        yaws = _turns(key_turn)
        own = self.outlines.corners[focus] @ _rotation(yaws)[:, None]
        placed, is_there = self._standing(episode)
        obstacles = Obstacles.of(own, placed, is_there)
        reach = jnp.max(reach_of(own), axis=1)
        quarter = NUM_DIRECTIONS // 4
        high = room - reach[:, [0, quarter]] - clearance
        low = -room + reach[:, [2 * quarter, 3 * quarter]] + clearance
        # Where all begin again, each goes into any of the corners.
        has_failed = episode.counts.attempts.sum() > episode.slot - self.rules.num_started
        any_corner = jax.random.randint(jax.random.fold_in(key, 5), (), 0, 4)
        which = jnp.where(has_failed, any_corner, episode.object_index[0] % 4)
        corner = jnp.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])[which]
        turn, xy = _places(key_place, own, placed, is_there, low, high, clearance)

        def cost_of_corner(xy: Array) -> Array:
            return jnp.linalg.norm(xy - corner * room, axis=1) / (2 * jnp.linalg.norm(room))

        def is_free(turn: Array, xy: Array) -> Array:
            is_within = jnp.all(
                (xy >= low[turn] - _ROUNDING) & (xy <= high[turn] + _ROUNDING), axis=1
            )
            return is_within & (obstacles.least_gap(turn, xy) >= clearance - _ROUNDING)

        rank = cost_of_corner(xy) + _SHY * jax.random.uniform(key_slide, turn.shape)
        start = jax.lax.top_k(-jnp.where(is_free(turn, xy), rank, FORBIDDEN), _SLID)[1]
        turn = turn[start]
        xy = _slide(obstacles, turn, xy[start], corner, (low[turn], high[turn]), clearance)
        allowed = is_free(turn, xy)
        yaw = yaws[turn]
        allowed &= self._is_allowed(self.scene(episode), Candidates(xy, yaw))
        touched = obstacles.contact_at(turn, xy, clearance + _TOUCHING)
        touched += _beside_walls(obstacles, turn, xy, low, high)
        perimeter = reach.sum(1)[turn] * (2 * np.pi / NUM_DIRECTIONS)
        noise = jax.random.uniform(key_cost, yaw.shape) * _SHY * (episode.attempt > 0)
        cost = _FAR * cost_of_corner(xy) - touched / perimeter + noise
        best = jnp.argmin(jnp.where(allowed, cost, FORBIDDEN))
        height = self.rules.geometry.half_extents[focus, 2] + CLEARANCE
        position = jnp.append(xy[best], height)
        action = action_of_pose(position, yaw[best], region, self.rules.height_range(episode))
        return jnp.where(allowed.any(), action, super().__call__(key_drop, episode))

    def _is_allowed(self, scene: SearchScene, candidates: Candidates) -> Array:
        """bool[N]: see `Search`; and the outline is wholly in the region: nothing lies on a tray's rim."""
        assert self.outlines is not None
        corners = self.outlines.corners[scene.focus].reshape(-1, 2)
        turned = jnp.stack(candidates.turned(corners), axis=-1) + candidates.xy[:, None]
        is_within = jnp.all(jnp.abs(turned) <= scene.episode.region.half_extents, axis=(1, 2))
        return super()._is_allowed(scene, candidates) & is_within

    def _standing(self, episode: Episode) -> tuple[Array, Array]:
        """f32[S, P, V, 2], corners of what stands on the same surface, region frame, and bool[S]."""
        assert self.outlines is not None
        index = jnp.maximum(episode.object_index, 0)
        is_there = (jnp.arange(len(index)) < episode.slot) & (episode.object_index >= 0)
        if episode.surface is not None:
            own = episode.surface[self.rules.focus(episode)]
            is_there &= (episode.surface[index] == own) | (episode.surface[index] < 0)
        pose = safe_poses(episode.poses[index], is_there)
        T_region_world = episode.region.T_world_region.inverse()
        T_region_object = jax.vmap(lambda each: T_region_world @ from_pose(each))(pose)
        turn = T_region_object.rotation().as_matrix()[:, :2, :2]
        shift = T_region_object.translation()[:, None, None, :2]
        corners = jnp.einsum("sij,spvj->spvi", turn, self.outlines.corners[index])
        return corners + shift, is_there


def _turns(key: Array) -> Array:
    """f32[Y], radians."""
    key_square, key_other = jax.random.split(key)
    square = jnp.arange(_SQUARE) * (2 * jnp.pi / _SQUARE)
    square += askew(key_square, _SQUARE)
    return jnp.append(square, jax.random.uniform(key_other, (_OTHER,), maxval=2 * jnp.pi))


def _rotation(yaws: Array) -> Array:
    """f32[Y, 2, 2]: what turns rows of points."""
    cos = jnp.cos(yaws)
    sin = jnp.sin(yaws)
    return jnp.stack([jnp.stack([cos, sin], -1), jnp.stack([-sin, cos], -1)], axis=1)


def _places(
    key: Array,
    own: Array,
    placed: Array,
    is_there: Array,
    low: Array,
    high: Array,
    clearance: float,
) -> tuple[Array, Array]:
    """i32[N], turns, and f32[N, 2], where the object is tried: anywhere, and next to others.

    Args:
      own: f32[Y, P, V, 2] and placed: f32[S, P, V, 2], corners; is_there: bool[S].
      low, high: f32[Y, 2], between which it is in the region.
    """
    key_any, key_other, key_way, key_piece = jax.random.split(key, 4)
    num = len(own)
    share = jax.random.uniform(key_any, (num, _ANYWHERE, 2))
    anywhere = low[:, None] + share * (high - low)[:, None]
    shape = (num, _BESIDE)
    logits = jnp.where(is_there, 0.0, -jnp.inf)
    other = jax.random.categorical(key_other, logits, shape=shape)
    way = jax.random.randint(key_way, shape, 0, NUM_DIRECTIONS)
    piece = jax.random.randint(key_piece, (2, *shape), 0, own.shape[1])
    # Corners are the farthest points along directions of each one's own frame, not of the region's.
    ways = jnp.asarray(directions(), jnp.float32)
    of_other = _farthest(placed, ways)[other, piece[0], way]
    of_own = _farthest(own, -ways)[jnp.arange(num)[:, None], piece[1], way]
    beside = of_other - of_own + (clearance + _ROUNDING) * ways[way]
    turn = jnp.repeat(jnp.arange(num), _ANYWHERE + _BESIDE)
    return turn, jnp.concatenate([anywhere, beside], axis=1).reshape(-1, 2)


def _farthest(corners: Array, ways: Array) -> Array:
    """f32[..., D, 2]: the corner of f32[..., V, 2] that is farthest along each of f32[D, 2]."""
    which = jnp.argmax(corners @ ways.T, axis=-2)
    return jnp.take_along_axis(corners, which[..., None], axis=-2)


def _slide(
    obstacles: Obstacles,
    turn: Array,
    xy: Array,
    corner: Array,
    limits: tuple[Array, Array],
    clearance: float,
) -> Array:
    """f32[N, 2]: where objects at f32[N, 2] end up that are slid into a corner, f32[2], as far as they go."""
    low, high = limits
    signs = corner.astype(jnp.float32)
    ways = [signs / jnp.sqrt(2.0), signs * jnp.array([1.0, 0.0]), signs * jnp.array([0.0, 1.0])]
    end = jnp.where(signs > 0, high, low)

    def go(xy: Array, way: Array) -> tuple[Array, None]:
        left = jnp.where(
            jnp.abs(way) > 0, (end - xy) * signs / jnp.maximum(jnp.abs(way), 1e-6), jnp.inf
        )
        free = obstacles.way_free(turn, xy, way, clearance)
        length = jnp.maximum(jnp.minimum(free, jnp.min(left, axis=1)), 0.0)
        return xy + length[:, None] * way, None

    return jax.lax.scan(go, xy, jnp.stack(ways * _ROUNDS))[0]


def _beside_walls(obstacles: Obstacles, turn: Array, xy: Array, low: Array, high: Array) -> Array:
    """f32[N], metres: the length of the outline that is next to the region's sides."""
    face = obstacles.own_face
    length = jnp.max(face[..., 1], axis=1) - jnp.min(face[..., 0], axis=1)
    quarter = NUM_DIRECTIONS // 4
    at = jnp.stack([high[turn] - xy, xy - low[turn]], axis=1).reshape(len(turn), 4)
    sides = length[:, [0, quarter, 2 * quarter, 3 * quarter]][turn]
    return jnp.sum(jnp.where(at < _TOUCHING, sides, 0.0), axis=1)
