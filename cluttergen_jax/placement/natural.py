"""Natural draws: what a table of sense says of a world's objects, in compiled code.

Candidates are weighed by physics and sense, never refused, but for what carries nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.sense import TURNS, UNUSUAL, USUAL, SenseArrays, sense_of
from cluttergen_jax.placement.boxes import Boxes, footprint_area
from cluttergen_jax.placement.features import Supporters
from cluttergen_jax.placement.search import Candidates, SearchScene
from cluttergen_jax.placement.types import Episode, Geometry, choose
from cluttergen_jax.types import Array

if TYPE_CHECKING:
    from cluttergen_jax.placement.candidate_sampler import CandidateSet

SEATS = {"-y": -math.pi / 2, "+y": math.pi / 2, "-x": math.pi, "+x": 0.0}
"""Radians: where the seat is, as seen from the middle of the region, in the region's frame."""

_AREA_POWER = 2.0
_BASE_POWER = 1.0
_LEAST_BASE = 0.02

_EXACT = 0.8
"""The share of candidates that have the usual turn to `_NEARLY` radians; of the others those with a front are
turned from it by up to `_ROUGHLY`, and all else is turned anyhow."""
_NEARLY = math.radians(3.5)
_ROUGHLY = math.radians(25.0)
_NEAR = 0.06
"""Metres between circles around objects; what is usually beside another is drawn to it where it is nearer."""
_ZONE_POWER = 2.5
_HANGING_POWER = 25.0
_INSIST = 3
"""Attempts of an object, the first ones, at which it must not come to rest on anything unusual."""
_TALL = 1.5
"""Times its smaller side in plan: what is taller carries nothing usually."""
_FARTHEST = 0.05
"""Metres from a neighbour, at most, at which candidates beside it are tried."""
_FREE, _EDGE, _ALONG, _TOWARDS, _FRONT = map(
    TURNS.index, ("free", "edge", "along", "towards", "front")
)


class Natural(struct.PyTreeNode):
    """What is known of how K objects are left by people.

    Attributes:
      log_on, log_in: f32[K, K], row: an object, column: what would carry or hold it: logarithms of weights.
      is_usual: bool[K, K], the same: it is usually on or in it; is_beside: bool[K, K], usually beside it.
      is_banned: bool[K, K], the same: the column carries nothing, this object included.
      turn: i32[K], places in `assets.sense.TURNS`.
      heading: f32[K], radians, of its longer side in plan, object frame.
      zone: f32[K], 1 at the front of the region, -1 at its back, 0 anywhere.
      on_table: bool[K], False for what belongs on no table: it is drawn where nothing else is left.
      seat: radians, see `SEATS`.
    """

    log_on: Array
    log_in: Array
    is_usual: Array
    is_beside: Array
    is_banned: Array
    turn: Array
    heading: Array
    zone: Array
    on_table: Array
    seat: float = struct.field(pytree_node=False, default=SEATS["-y"])

    @staticmethod
    def of(objects: Sequence[ObjectAsset], sense: str = "", seat: str = "-y") -> Natural:
        """For a world's objects, by a table of sense: a file, the package's if empty.

        Raises:
          ConfigError: the table cannot be read, or is not as it should be.
        """
        found: SenseArrays = sense_of(objects, sense)
        weight = np.maximum(found.weight_on, found.weight_in)
        return Natural(
            log_on=jnp.asarray(np.log(found.weight_on), jnp.float32),
            log_in=jnp.asarray(np.log(found.weight_in), jnp.float32),
            is_usual=jnp.asarray(weight >= USUAL),
            is_beside=jnp.asarray(found.weight_beside >= USUAL),
            is_banned=jnp.asarray(found.never_carries),
            turn=jnp.asarray(found.turn),
            heading=jnp.asarray(found.heading),
            zone=jnp.asarray(found.zone),
            on_table=jnp.asarray(found.on_table),
            seat=SEATS[seat],
        )

    def logits(
        self, episode: Episode, geometry: Geometry, focus: Array, candidates: CandidateSet
    ) -> Array:
        """f32[N]: log weights of candidates for the current object, up to a constant.

        On objects the weight is w min(1, A / a)^2 s: w of the table, the least of all that would carry it;
        a the footprint of the object's box, A that of the largest object that would carry it, s the share of
        its base that would touch. On the support it is larger beside what it usually is beside. Both times
        exp(2.5 z t - 25 h): z its zone, t from -1 at the back of the region to 1 at the front, h the share
        of the object that would hang beyond the support.
        """
        supporters = candidates.supporters
        found = candidates.found
        xy = found.candidates.xy
        area = footprint_area(geometry.half_extents)
        widest = jnp.max(jnp.where(supporters.touched, area, 0.0), axis=1)
        width = jnp.minimum(jnp.log(jnp.maximum(widest, 1e-8) / area[focus]), 0.0)
        base = jnp.log(jnp.clip(supporters.base, _LEAST_BASE, 1.0))
        log_carried = self._log_carried(episode, geometry, focus)
        carried = jnp.min(jnp.where(supporters.touched, log_carried, jnp.inf), axis=1)
        on_objects = _AREA_POWER * width + _BASE_POWER * base + carried
        near = jnp.any(self._is_near(episode, geometry, focus, xy), axis=1)
        on_support = jnp.where(near, math.log(USUAL), 0.0)
        front = jnp.array([math.cos(self.seat), math.sin(self.seat)])
        reach = jnp.maximum(jnp.abs(front) @ episode.region.half_extents, 1e-3)
        zone = _ZONE_POWER * self.zone[focus] * (xy @ front) / reach
        hanging = _HANGING_POWER * found.scores.fit.hanging
        return jnp.where(supporters.is_on, on_objects, on_support) + zone - hanging

    def _log_carried(self, episode: Episode, geometry: Geometry, focus: Array) -> Array:
        """f32[K]: logarithms of the weights with which objects carry or hold the current one.

        What stands taller than it is wide carries nothing usually, whatever its kind does when it lies.
        """
        sides = jnp.abs(Boxes.of(geometry.half_extents, episode.safe_poses).sides)
        upright = jnp.argmax(sides[..., 2], axis=1)
        lengths = 2 * geometry.half_extents
        height = jnp.take_along_axis(lengths, upright[:, None], axis=1)[:, 0]
        is_side = jnp.arange(3) != upright[:, None]
        width = jnp.min(jnp.where(is_side, lengths, jnp.inf), axis=1)
        is_tall = height > _TALL * width
        log_on = self.log_on[focus] + jnp.where(is_tall, math.log(UNUSUAL), 0.0)
        return jnp.maximum(log_on, self.log_in[focus])

    def is_sensible(
        self, episode: Episode, geometry: Geometry, focus: Array, supporters: Supporters
    ) -> Array:
        """bool[N]: nothing unusual would carry the current object."""
        is_unusual = self._log_carried(episode, geometry, focus) < math.log(UNUSUAL) / 2
        return ~jnp.any(supporters.touched & is_unusual, axis=1)

    def is_refused(self, episode: Episode, geometry: Geometry, focus: Array) -> Array:
        """bool[K]: on which objects the current one must not come to rest at this attempt."""
        is_unusual = self._log_carried(episode, geometry, focus) < math.log(UNUSUAL) / 2
        return self.is_banned[focus] | (is_unusual & (episode.attempt < _INSIST))

    def is_allowed(self, focus: Array, supporters: Supporters) -> Array:
        """bool[N]: nothing that carries nothing would carry the current object."""
        return ~jnp.any(supporters.touched & self.is_banned[focus], axis=1)

    def _is_near(self, episode: Episode, geometry: Geometry, focus: Array, xy: Array) -> Array:
        """bool[N, K]: which of its usual neighbours each candidate is near to."""
        center = self._centers(episode)
        radius = jnp.mean(geometry.half_extents[:, :2], axis=1)
        distance = jnp.linalg.norm(xy[:, None] - center, axis=-1) - radius - radius[focus]
        return (distance < _NEAR) & self.is_beside[focus] & episode.is_placed

    def _centers(self, episode: Episode) -> Array:
        """f32[K, 2], where objects are in the region's frame, metres."""
        T_region_world = episode.region.T_world_region.inverse()
        return jax.vmap(T_region_world.apply)(episode.safe_poses[:, :3])[:, :2]

    def yaws(self, key: Array, scene: SearchScene, number: int) -> Array:
        """f32[number]: turns of the current object in the region's frame, radians, mostly usual ones."""
        key_turn, key_side, key_exact, key_spread = jax.random.split(key, 4)
        half = scene.body.half_extents
        orientation = scene.episode.orientation
        is_upright = jnp.bool_(True) if orientation is None else orientation == 0
        turn = self.turn[scene.focus]
        has_front = (turn == _FRONT) & is_upright
        side = jax.random.randint(key_side, (number,), 0, 4) * (jnp.pi / 2)
        end = jnp.mod(side, jnp.pi) * 2
        lengthwise = jnp.where(half[1] > half[0], jnp.pi / 2, 0.0)
        lengthwise = jnp.where(is_upright, self.heading[scene.focus], lengthwise)
        usual = jnp.where(turn == _TOWARDS, self.seat - lengthwise + end, side - lengthwise)
        usual = jnp.where(turn == _ALONG, self.seat + jnp.pi / 2 - lengthwise + end, usual)
        # The front is the -y side, as in glTF; its sides may be askew in its frame.
        askew = jnp.mod(lengthwise + jnp.pi / 4, jnp.pi / 2) - jnp.pi / 4
        usual = jnp.where(has_front, self.seat + jnp.pi / 2 - askew, usual)
        spread = jax.random.uniform(key_spread, (number,), minval=-1.0)
        any_turn = jax.random.uniform(key_turn, (number,), maxval=2 * jnp.pi)
        other = jnp.where(has_front, usual + _ROUGHLY * spread, any_turn)
        is_exact = jax.random.uniform(key_exact, (number,)) < _EXACT
        return jnp.where(is_exact & (turn != _FREE), usual + _NEARLY * spread, other)

    def turn_candidates(self, key: Array, scene: SearchScene, candidates: Candidates) -> Candidates:
        """The same places, with usual turns."""
        return Candidates(candidates.xy, self.yaws(key, scene, candidates.yaw.shape[0]))

    def face_seat(self, key: Array, scene: SearchScene, candidates: Candidates) -> Candidates:
        """The same places; with usual turns, if the current object is turned to the seat."""
        turn = self.turn[scene.focus]
        turned = self.turn_candidates(key, scene, candidates)
        return choose((turn == _FRONT) | (turn == _TOWARDS), turned, candidates)

    def candidates(
        self, key: Array, scene: SearchScene, geometry: Geometry, number: int
    ) -> Candidates:
        """Candidates over what usually carries the current object and beside what is usually near it.

        They are uniform over the region where nothing of the kind is placed.
        """
        episode = scene.episode
        region = episode.region
        key_which, key_at, key_far, key_yaw = jax.random.split(key, 4)
        carriers = episode.is_placed & self.is_usual[scene.focus]
        neighbours = episode.is_placed & self.is_beside[scene.focus]
        is_place = jnp.concatenate([carriers, neighbours])
        chance = jnp.where(is_place, 0.0, -jnp.inf)
        which = jax.random.categorical(key_which, chance, shape=(number,))
        is_over = which < geometry.num_objects
        which = which % geometry.num_objects
        center = self._centers(episode)[which]
        half = geometry.half_extents[which, :2]
        unit = jax.random.uniform(key_at, (number, 2), minval=-1.0)
        over = center + unit * jnp.linalg.norm(half, axis=1, keepdims=True) / math.sqrt(2.0)
        angle = jnp.pi * unit[:, 0]
        own = jnp.mean(scene.body.half_extents[:2])
        far = jnp.mean(half, axis=1) + own + _FARTHEST * jax.random.uniform(key_far, (number,))
        beside = center + far[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
        xy = jnp.where(is_over[:, None], over, beside)
        xy = jnp.where(jnp.any(is_place), xy, unit * region.half_extents)
        yaw = self.yaws(key_yaw, scene, number)
        return Candidates(jnp.clip(xy, -region.half_extents, region.half_extents), yaw)
