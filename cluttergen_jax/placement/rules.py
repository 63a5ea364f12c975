"""The rules of the problem, below any reinforcement-learning wrapper: begin an episode, make an attempt.

Which objects come in which order, what is asked of a place where one has come to rest beyond standing still,
what carries what and which are taken away again from a scene that is stuck, and what an attempt pays.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Protocol

import jax
import jax.numpy as jnp
from flax import struct

from cluttergen_jax.physics.host import HostPhysics, NumberedEngines, Physics
from cluttergen_jax.physics.standing import has_moved
from cluttergen_jax.placement import crowd
from cluttergen_jax.placement.arrangements import NEST, ROW, STACK
from cluttergen_jax.placement.boxes import footprint_area
from cluttergen_jax.placement.config import MAX_MARGIN, ORDER_POWER, PlacementConfig
from cluttergen_jax.placement.containers import draw_contents
from cluttergen_jax.placement.heightmap import map_below, most_beyond, on_map, shares_beyond
from cluttergen_jax.placement.region import (
    ChangedRegion,
    KeepOut,
    Region,
    box_corners,
    from_pose,
    is_in_polygon,
    is_inside,
    is_kept_out,
    no_keep_out,
    pose_of_action,
    safe_poses,
)
from cluttergen_jax.placement.related import RelatedObjects, carriers_of, holds_among
from cluttergen_jax.placement.surface_set import SurfaceSet
from cluttergen_jax.placement.types import (
    Body,
    Counts,
    DoorRecord,
    Episode,
    Geometry,
    History,
    Start,
    SupportGraph,
    SupportMap,
    Transition,
    choose,
)
from cluttergen_jax.types import Array, Closing, Piling, Settling, Standing, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.placement.natural import Natural

OWN_SHARE = 1 / 3
"""Of what a narrow object has on a flat table: so much support margin is asked of it at most. Of a round face
engines name four points or so, which can leave less than half of it."""
_SHARE = (0.5, 3.5)
"""Of the current object's footprint: so much is freed at least, drawn anew each time."""
_OF_TOP = 0.95
"""How often, in a crowded scene, only what carries nothing is taken away."""
_CODE_LAST_BONUS = 1000.0


def empty_graph(geometry: Geometry) -> SupportGraph:
    """Nothing leans on anything; all are trusted as they stand on a flat table."""
    number = geometry.num_objects
    return SupportGraph(
        leans_on=jnp.zeros((number, number), bool),
        level=jnp.zeros(number, jnp.int32),
        margin=jnp.asarray(geometry.own_margin, jnp.float32),
    )


def graph_after_settling(graph: SupportGraph, is_focus: Array, settling: Settling) -> SupportGraph:
    """What carries what once the focus object, bool[K], has come to rest."""
    highest = jnp.max(jnp.where(settling.bears, graph.level, -1), initial=-1)
    # Those that an attempt did not move have an infinite margin: nothing about them is new. A neighbour that
    # it moved may have come to lean on the new object.
    is_moved = ~jnp.isposinf(settling.margin) & ~is_focus
    leans_on = graph.leans_on | ((is_moved & settling.touches)[:, None] & is_focus)
    return SupportGraph(
        leans_on=jnp.where(is_focus[:, None], settling.touches, leans_on),
        level=jnp.where(is_focus, highest + 1, graph.level).astype(jnp.int32),
        margin=jnp.where(
            is_moved | is_focus, jnp.maximum(settling.margin, -MAX_MARGIN), graph.margin
        ),
    )


def graph_without(graph: SupportGraph, which: Array, geometry: Geometry) -> SupportGraph:
    """What carries what once the objects `which`, bool[K], are gone."""
    empty = empty_graph(geometry)
    return SupportGraph(
        leans_on=graph.leans_on & ~which[:, None] & ~which,
        level=jnp.where(which, empty.level, graph.level),
        margin=jnp.where(which, empty.margin, graph.margin),
    )


def supported_by(which: Array, leans_on: Array) -> Array:
    """These objects and all that leans on them, directly or by way of others: bool[K].

    Args:
      which: bool[K]; leans_on: bool[K, K], row k: what object k leans on.
    """

    def widen(state: tuple[Array, Array]) -> tuple[Array, Array]:
        now, _ = state
        return now | jnp.any(leans_on & now, axis=1), now

    def has_grown(state: tuple[Array, Array]) -> Array:
        return jnp.any(state[0] != state[1])

    return jax.lax.while_loop(has_grown, widen, (which, which & False))[0]


class Proposer(Protocol):
    """Proposes poses for the current object; pure, one episode at a time: a baseline, a policy, a person."""

    def __call__(self, key: Array, episode: Episode) -> Array:
        """An action f32[4] in [0, 1] (docs/contract.md) for `episode`, drawn with `key`."""
        ...


def _instead_of_stable(verdict: Array, is_worse: Array, other: Verdict) -> Array:
    """i32: another verdict where it is STABLE and something speaks against it."""
    return jnp.where((verdict == Verdict.STABLE) & is_worse, int(other), verdict)


def _key_of_attempt(key: Array, purpose: int, episode: Episode) -> Array:
    """A key for a purpose, anew after every attempt: those who step an episode need not change its own."""
    return jax.random.fold_in(jax.random.fold_in(key, purpose), episode.counts.attempts.sum())


def choose_removal(
    episode: Episode, geometry: Geometry, is_started: Array, *, is_crowded: bool = False
) -> Array:
    """The placed objects nearest to a random one, until enough footprint is free: bool[K].

    In a crowded scene they are mostly objects that carry nothing: with the bottom of a heap, all of it would
    have to be placed again.

    Drawn with the episode's key, anew after every attempt. What leans on them is for `remove` to find.

    Args:
      is_started: bool[K], those that stood there from the beginning and stay.
    """
    key_center, key_share = jax.random.split(_key_of_attempt(episode.key, 2, episode))
    is_mine = episode.is_placed & ~is_started
    if is_crowded:
        carries = jnp.any(episode.support_graph.leans_on & is_mine[:, None], axis=0)
        is_of_top = jax.random.uniform(jax.random.fold_in(key_center, 1)) < _OF_TOP
        is_mine &= ~(carries & is_of_top)
    noise = jax.random.gumbel(key_center, is_mine.shape)
    center = jnp.argmax(noise + jnp.where(is_mine, 0.0, -jnp.inf))
    offset = episode.poses[:, :2] - episode.poses[center, :2]
    order = jnp.argsort(jnp.where(is_mine, jnp.sum(offset**2, axis=1), jnp.inf))
    area = footprint_area(geometry.half_extents)
    slot = jnp.minimum(episode.slot, len(episode.object_index) - 1)
    focus = jnp.maximum(episode.object_index[slot], 0)
    share = jax.random.uniform(key_share, minval=_SHARE[0], maxval=_SHARE[1])
    wanted = area[focus] * share
    freed = jnp.cumsum(area[order])
    is_taken = freed - area[order] < wanted
    return jnp.zeros_like(is_mine).at[order].set(is_taken) & is_mine


def remove(
    episode: Episode, which: Array, geometry: Geometry, related: RelatedObjects | None = None
) -> Episode:
    """The episode without some placed objects, and without all that leans on them.

    They come again, after the current object. What was spent on them stays counted, in their new slots.

    Args:
      which: bool[K]; of what stood there from the beginning nothing is taken.
    """
    is_mine = episode.is_placed & ~episode.is_started
    leans_on = episode.support_graph.leans_on & is_mine[:, None]
    if related is not None and related.is_arranged and episode.roles is not None:
        # What was put beside or upon a thing has lost its place with it.
        leans_on |= related.dependence(episode.roles) & is_mine[:, None]
    which = supported_by(which & is_mine, leans_on)
    slots = jnp.arange(len(episode.object_index))
    index = jnp.maximum(episode.object_index, 0)
    is_kept = (slots < episode.slot) & ~which[index]
    group = jnp.where(is_kept, 0, jnp.where(slots == episode.slot, 1, 2))
    last = 3
    if related is not None and episode.roles is not None:
        # Nothing comes before that to which it is placed.
        group = jnp.where(is_kept, 0, 1 + related.priority(episode.roles)[index])
        last = related.num_roles + 2
    order = jnp.argsort(jnp.where(episode.object_index < 0, last, group), stable=True)
    counts = episode.counts
    return episode.replace(
        object_index=episode.object_index[order],
        slot=is_kept.sum().astype(jnp.int32),
        attempt=jnp.int32(0),
        poses=jnp.where(which[:, None], Start.empty(len(which)).poses, episode.poses),
        is_placed=episode.is_placed & ~which,
        history=jax.tree.map(jnp.zeros_like, episode.history),
        counts=counts.replace(
            attempts=counts.attempts[order],
            steps=counts.steps[order],
            rest_steps=jnp.where(is_kept, counts.rest_steps, 0)[order],
        ),
        support_graph=graph_without(episode.support_graph, which, geometry),
    )


def reward_of(
    settling: Settling, is_stable: Array, ordinal: Array, is_last: Array, config: PlacementConfig
) -> Array:
    """The reward of one attempt, f32.

    "paper": -c sum_t (|v_t| + |a_t|) + n R0 1[stable], n the object's ordinal from 1 (paper, equation 1).
    "code": -c sum_t |v_t|_1 + R0 1[stable], and 1,000 more for the last object (its published code).
    "compressed": 1[stable] - log(1 + c sum_t (|v_t| + |a_t|)) / 10. The paper's penalty on a failed attempt
      is 69 in the median and up to 1,600; its logarithm keeps the order and spares the critic.

    Args:
      ordinal: i32, 1 for the first object.
    """
    stable = is_stable.astype(jnp.float32)
    if config.reward == "paper":
        return -config.motion_cost * settling.motion_sum + ordinal * config.success_reward * stable
    if config.reward == "code":
        bonus = config.success_reward + _CODE_LAST_BONUS * is_last
        return -config.motion_cost * settling.speed_sum + bonus * stable
    return stable - jnp.log1p(config.motion_cost * settling.motion_sum) / 10


class Rules(struct.PyTreeNode, eq=False):
    """The decision process for one compiled world; pure functions of episodes, one at a time.

    A pytree, so that what is compiled for one world serves all worlds of the same sizes.

    Attributes:
      config: what is asked of an episode.
      physics: the simulator, or several of which `engine` says which (`simulator` is the one).
      geometry: the world's objects.
      region: the queried region of every episode that is not given another; the largest of drawn ones.
      num_started: the most objects that may stand there already when an episode begins.
      draw_region: draws an episode's region from a key; None where all take `region`.
      support_map: the support alone, where overhang is limited (`PlacementConfig.overhang`).
      history_steps: of an attempt that took longer the history tells so many steps, as if it had been cut
        off then; None tells them all. A policy reads histories of the length that it was trained with.
      engine: i32, the number of this world's engine where there are several.
      map_radius: metres, that of the largest object that height maps are made for; its own if None.
      related: the relations that scenes must fulfil; None for none.
      surfaces: of which one is drawn for each attempt, with its region; None where there is one.
      natural: what is known of how people leave the objects, where scenes are to be natural; else None.
      polygon: f32[E, 2], what of the region counts, world x and y, or the surface's frame where it is not
        level; None for all of it.
      num_doors: D, doors that are closed when all slots are filled.
    """

    config: PlacementConfig = struct.field(pytree_node=False)
    physics: Physics | NumberedEngines = struct.field(pytree_node=False)
    geometry: Geometry
    region: Region
    num_started: int = struct.field(pytree_node=False, default=0)
    draw_region: ChangedRegion | None = struct.field(pytree_node=False, default=None)
    history_steps: int | None = struct.field(pytree_node=False, default=None)
    support_map: SupportMap | None = None
    engine: Array | None = None
    map_radius: float | None = struct.field(pytree_node=False, default=None)
    related: RelatedObjects | None = None
    surfaces: SurfaceSet | None = None
    polygon: Array | None = None
    num_doors: int = struct.field(pytree_node=False, default=0)
    natural: Natural | None = None

    @property
    def simulator(self) -> Physics:
        """The simulator of this world."""
        if isinstance(self.physics, NumberedEngines):
            assert self.engine is not None
            return self.physics.with_number(self.engine)
        return self.physics

    def begin(
        self,
        key: Array,
        region: Region | None = None,
        keep_out: KeepOut | None = None,
        start: Start | None = None,
        key_objects: Array | None = None,
    ) -> Episode:
        """A new episode on an empty support, or around objects that already stand there.

        Args:
          key: consumed.
          region: where to place; the default region, or a drawn one, if None.
          keep_out: where not to place.
          start: objects that already stand; they count as neighbours and are not drawn again.
          key_objects: draws which objects are placed: all episodes with this key have the same. `key` draws
            them if None, and else their order alone.
        """
        key_order, key_episode = jax.random.split(key)
        key_chosen = None if key_objects is None else jax.random.split(key_objects)[0]
        start = Start.empty(self.geometry.num_objects) if start is None else start
        first_slot = start.is_placed.sum().astype(jnp.int32)
        if region is None and self.draw_region is not None:
            # Orders are those of unchanged regions; `fold_in` of 0 or 1 would be a key of the split again.
            region = self.draw_region(jax.random.fold_in(key, 2))
        key_roles = jax.random.fold_in(key if key_objects is None else key_objects, 4)
        roles = None if self.related is None else self.related.draw(key_roles)
        episode = Episode(
            key=key_episode,
            region=self.region if region is None else region,
            keep_out=no_keep_out() if keep_out is None else keep_out,
            object_index=self._draw_slots(key_order, start.is_placed, roles, key_chosen),
            first_slot=first_slot,
            slot=first_slot,
            attempt=jnp.int32(0),
            poses=start.poses,
            is_placed=start.is_placed,
            history=self._empty_history(),
            counts=Counts(
                attempts=jnp.zeros(self.num_slots, jnp.int32),
                steps=jnp.zeros(self.num_slots, jnp.int32),
                rest_steps=jnp.zeros(self.num_slots, jnp.int32),
                verdicts=jnp.zeros(self._num_counted, jnp.int32),
                simulated_steps=jnp.int32(0),
                reward=jnp.float32(0),
            ),
            is_over=jnp.bool_(False),
            is_success=jnp.bool_(False),
            verdict=jnp.int32(Verdict.NONE),
            drift=jnp.float32(0),
            support_graph=empty_graph(self.geometry),
            roles=roles,
        )
        if self.is_crowded:
            episode = episode.replace(num_beside=jnp.int32(0), num_leaning=jnp.int32(0))
        if self.num_doors:
            episode = episode.replace(doors=DoorRecord.empty(self.num_doors))
        if self.surfaces is not None:
            nowhere = jnp.full(self.geometry.num_objects, -1, jnp.int32)
            episode = episode.replace(surface=nowhere)
        episode = self._with_surface(episode, jax.random.fold_in(key, 5))
        return self._with_orientation(episode, jax.random.fold_in(key, 3))

    def _draw_slots(
        self, key: Array, is_taken: Array, roles: Array | None, key_chosen: Array | None
    ) -> Array:
        """i32[S]: the objects that stand, then those to place, then -1 for slots without an object.

        Those to place are a uniform subset of the objects not taken, whatever their order but "fixed"; those
        of roles are among them and come first, each after those to which it is placed. Where objects are to
        be inside of others, so many that fit are among them, and what they fit into comes first.

        Args:
          key_chosen: draws which are placed, where `key` draws their order alone; `key` draws both if None.
        """
        key_drawn = key if key_chosen is None else key_chosen
        ranks = self._ranks(key_drawn, is_taken, roles)
        is_container = None
        if self.num_contained and self.config.order != "fixed":
            # No search finds room inside of others where nothing that is drawn fits into anything.
            is_content, is_container = draw_contents(
                jax.random.fold_in(key_drawn, 6),
                self.geometry,
                is_taken,
                self.num_contained,
                self.config.num_objects,
            )
            ranks = jnp.where((is_content | is_container) & ~is_taken, ranks - 1.0, ranks)
        chosen = jnp.argsort(ranks)[: self.config.num_objects].astype(jnp.int32)
        chosen = jnp.where(jnp.isfinite(ranks[chosen]), chosen, -1)
        if key_chosen is not None:
            # The same objects, in an order of this scene's own; -1 last, as above.
            own = self._ranks(key, is_taken, roles)
            chosen = chosen[jnp.argsort(jnp.where(chosen < 0, jnp.inf, own[chosen]))]
        if self.config.order in ("largest", "weighted"):
            chosen = chosen[jnp.argsort(-self._order_weight(key)[chosen])]
        if is_container is not None:
            chosen = chosen[jnp.argsort(~is_container[chosen], stable=True)]
        if roles is not None and self.related is not None:
            chosen = chosen[jnp.argsort(self.related.priority(roles)[chosen], stable=True)]
        standing = jnp.nonzero(is_taken, size=self.num_started, fill_value=-1)[0].astype(jnp.int32)
        slots = jnp.concatenate([standing, chosen])
        slots = jnp.pad(slots, (0, self.num_slots - slots.shape[0]), constant_values=-1)
        return slots[jnp.argsort(slots < 0, stable=True)]

    def _ranks(self, key: Array, is_taken: Array, roles: Array | None) -> Array:
        """f32[K]: the objects of the lowest ranks are placed, in the order of their ranks; inf: never."""
        ranks = jnp.arange(self.geometry.num_objects, dtype=jnp.float32)
        if self.config.order != "fixed":
            ranks = jax.random.uniform(key, ranks.shape)
        if self.natural is not None:
            ranks = jnp.where(self.natural.on_table, ranks, ranks + len(ranks))
        ranks = jnp.where(is_taken, jnp.inf, ranks)
        return ranks if roles is None else ranks.at[roles].set(-1.0)

    @property
    def num_contained(self) -> int:
        """Objects that are drawn to be inside of others: one more than are asked for, for want of room."""
        clutter = self.config.clutter
        asked = math.ceil((clutter and clutter.contained) or 0)
        return min(asked + 1, self.config.num_objects - 1) if asked else 0

    def _order_weight(self, key: Array) -> Array:
        """f32[K]: who comes first, highest first. With noise of Gumbel's it is a draw by Plackett-Luce."""
        weight = jnp.log(footprint_area(self.geometry.half_extents))
        if self.config.order == "largest":
            return weight
        noise = jax.random.gumbel(jax.random.fold_in(key, 1), weight.shape)
        return ORDER_POWER * weight + noise

    @property
    def is_crowded(self) -> bool:
        """Whether objects are drawn together once all are placed (`placement.crowd`)."""
        return self.config.crowd_targets is not None

    @property
    def _num_counted(self) -> int:
        # What is not asked for is not counted, and stored states have the shapes they had.
        is_sensed = self.natural is not None
        if self.related is not None or self.config.most_stacked is not None or is_sensed:
            return int(Verdict.UNRELATED) + 1
        if self.physics.config.robust_tilt:
            return int(Verdict.FRAGILE) + 1
        last = Verdict.UNSUPPORTED if self.config.min_margin else Verdict.NON_FINITE
        return int(last) + 1

    @property
    def history_rows(self) -> int:
        """H: rows kept of each failed attempt's trajectory."""
        stride = self.config.history_stride
        last = self.physics.config.last_step if self.history_steps is None else self.history_steps
        return last // stride + 1 if stride else 0

    def _empty_history(self) -> History:
        """No attempt yet: all rows zero."""
        num_rows = self.history_rows
        most = self.config.max_attempts if num_rows else 0
        return History(
            action=jnp.zeros((most, 4), jnp.float32),
            region=jnp.zeros((most, 3), jnp.float32),
            trajectory=jnp.zeros((most, num_rows, 13), jnp.float32),
            num_steps=jnp.zeros(most, jnp.int32),
            is_tried=jnp.zeros(most, bool),
        )

    @property
    def num_slots(self) -> int:
        """S: slots of those that stand there already, then of those to be placed."""
        return self.num_started + self.config.num_objects

    def focus(self, episode: Episode) -> Array:
        """i32: the current object (of a finished episode: some object)."""
        return jnp.maximum(episode.object_index[self._slot(episode)], 0)

    def body(self, episode: Episode) -> Body:
        """The current object as it is released next (of a finished episode: some object)."""
        return Body.of(self.geometry, self.focus(episode), episode.orientation)

    def _with_draws(self, episode: Episode, key: Array) -> Episode:
        """The episode with all that is drawn for its current object before each attempt."""
        return self._with_surface(self._with_orientation(episode, key), jax.random.fold_in(key, 5))

    def _with_orientation(self, episode: Episode, key: Array) -> Episode:
        """The episode with an orientation drawn for its current object, where not all are upright."""
        if self.geometry.orientations is None:
            return episode
        focus = self.focus(episode)
        drawn = self.geometry.orientations.draw(key, focus)
        if self.related is not None and episode.roles is not None:
            drawn = self.related.draw_way_in(key, episode.roles, focus, drawn)
        if self.related is not None and self.related.is_arranged:
            drawn = self._arranged_orientation(self.related, episode, focus, drawn)
        return episode.replace(orientation=drawn)

    def _arranged_orientation(
        self, related: RelatedObjects, episode: Episode, focus: Array, drawn: Array
    ) -> Array:
        """i32: as it stands in a row, upright in a stack or a nest, else the one that was drawn."""
        orientations = self.geometry.orientations
        assert episode.roles is not None
        assert orientations is not None
        is_subject, is_reference, _, _ = related.pairs(episode.roles, focus)
        kind = jnp.where(is_subject | is_reference, related.kind, -1)
        is_upright = jnp.any((kind == STACK) | (kind == NEST))
        drawn = jnp.where(is_upright, 0, drawn)
        if orientations.in_row is None:
            return drawn
        return jnp.where(jnp.any(kind == ROW), orientations.in_row[focus], drawn)

    def _with_surface(self, episode: Episode, key: Array) -> Episode:
        """The episode with a surface drawn for its current object, where there are several."""
        if self.surfaces is None:
            return episode
        assert episode.surface is not None
        focus = self.focus(episode)
        footprint = footprint_area(self.geometry.half_extents)
        drawn = self.surfaces.draw(key, episode, focus, footprint)
        if self.num_contained and self.surfaces.number is None:
            assert self.config.clutter is not None
            asked = self.config.clutter.contained or 0
            drawn = self.surfaces.beside_container(key, episode, focus, self.geometry, asked, drawn)
        if self.related is not None and episode.roles is not None:
            # The next of an arrangement goes where the one before is.
            before = self.related.dependence(episode.roles)[focus] & episode.is_placed
            drawn = jnp.where(jnp.any(before), episode.surface[jnp.argmax(before)], drawn)
        own = jnp.where(episode.is_placed[focus], episode.surface[focus], drawn)
        surface = episode.surface.at[focus].set(own)
        return episode.replace(surface=surface, region=self.surfaces.region(drawn))

    def support_map_of(self, episode: Episode) -> SupportMap | None:
        """The map of the surface that the current object goes on; None for a flat top."""
        return map_below(self.geometry, episode.surface, self.focus(episode))

    def _slot(self, episode: Episode) -> Array:
        """i32: the current slot (of a finished episode: some slot)."""
        return jnp.minimum(episode.slot, self.num_slots - 1)

    def height_range(self, episode: Episode) -> Array:
        """f32, metres: the tallest placed object's height plus that of the current object."""
        heights = 2 * self.geometry.half_extents[:, 2]
        if self.geometry.orientations is not None:
            heights = jnp.max(2 * self.geometry.orientations.half_extents[..., 2], axis=1)
        return jnp.max(jnp.where(episode.is_placed, heights, 0.0)) + heights[self.focus(episode)]

    def attempt(self, episode: Episode, action: Array) -> tuple[Episode, Transition]:
        """One attempt: propose, let go, judge, commit or revert. A finished episode is left as it is.

        Args:
          action: f32[4] in (0, 1): x, y, z and turn in the queried region (docs/contract.md).

        Returns:
          The episode after the attempt, and what came of it.
        """
        simulator = self.simulator
        settling = simulator.settle(*self.release(episode, action))
        after, transition, is_filled = self.judge(episode, action, settling)
        if self.is_crowded:
            assert isinstance(simulator, HostPhysics)
            piling = simulator.make("crowd", *crowd.ask(self, after, is_filled))
            return crowd.conclude(self, after, piling, is_filled), transition
        standing = simulator.stand(after.poses, after.is_placed, is_filled)
        return self.conclude(after, standing, is_filled), transition

    def release(self, episode: Episode, action: Array) -> tuple[Array, Array, Array, Array]:
        """What `Physics.settle` is asked in an attempt: its four arguments, in their order."""
        focus = self.focus(episode)
        quaternion = self.body(episode).quaternion
        proposed = pose_of_action(action, episode.region, self.height_range(episode), quaternion)
        poses = episode.poses.at[focus].set(proposed)
        is_placed = episode.is_placed.at[focus].set(True)
        return poses, is_placed, focus, ~episode.is_over

    def judge(
        self, episode: Episode, action: Array, settling: Settling
    ) -> tuple[Episode, Transition, Array]:
        """Judges what settled, and commits or reverts it.

        Returns:
          The episode before its last check, what came of the attempt, and bool: whether it filled the last
          slot, so that the last check is due.
        """
        is_active = ~episode.is_over
        focus = self.focus(episode)
        height_range = self.height_range(episode)
        verdict = self.verdict_of_place(episode, focus, settling)
        is_stable = verdict == Verdict.STABLE
        is_last = episode.slot + 1 >= episode.num_slots
        ordinal = episode.slot - episode.first_slot + 1
        reward = reward_of(settling, is_stable, ordinal, is_last, self.config)
        after = self._push(episode, action, height_range, settling)
        after = self._commit(after, focus, settling, is_stable)
        after = self._count(after, episode.slot, settling, verdict, reward)
        after = self._take_apart(after)
        after = self._with_draws(after, _key_of_attempt(episode.key, 3, after))
        after = choose(is_active, after, episode)
        transition = Transition(
            slot=self._slot(episode),
            object_index=focus,
            ordinal=episode.attempt + 1,
            action=action,
            settling=settling,
            verdict=verdict,
            reward=jnp.where(is_active, reward, 0.0),
            is_made=is_active,
        )
        return after, transition, is_stable & is_last & is_active

    def verdict_of_place(self, episode: Episode, focus: Array, settling: Settling) -> Array:
        """The attempt's verdict, i32: the simulator's, where nothing graver is found."""
        verdict = settling.verdict
        if self.config.min_margin:
            is_poor = ~self.is_supported(episode, focus, settling)
            verdict = _instead_of_stable(verdict, is_poor, Verdict.UNSUPPORTED)
        pose = settling.poses[focus]
        half_extents = self.geometry.half_extents[focus]
        inside = is_inside(pose, half_extents, episode.region, self.config.containment)
        support_map = map_below(self.geometry, episode.surface, focus)
        placed = on_map(support_map, pose)
        inside &= ~is_kept_out(placed, half_extents, episode.keep_out)
        inside &= self.is_in_polygon(placed, half_extents)
        if self.surfaces is not None:
            inside &= self.surfaces.has_room(episode, focus)
        if support_map is not None:
            center = from_pose(pose).apply(self.geometry.center_of_mass[focus])
            height = episode.region.T_world_region.inverse().apply(center)[2]
            # Physics knows the lowest point of a surface alone.
            is_graver = (verdict == Verdict.OVERFLOW) | (verdict == Verdict.NON_FINITE)
            has_fallen = (height < 0) & ~is_graver & (verdict != Verdict.NONE)
            verdict = jnp.where(has_fallen, int(Verdict.FELL), verdict)
            if support_map.ceiling is not None:
                cell = support_map.index_of(placed[0], placed[1])
                inside &= height < support_map.ceiling.reshape(-1)[cell]
        if self.config.overhang != "any":
            is_beyond = self.reaches_beyond(episode, settling.poses)
            inside &= ~jnp.any(self._is_ours(episode, focus) & is_beyond)
        verdict = _instead_of_stable(verdict, ~inside, Verdict.OUTSIDE)
        if self.config.most_stacked is not None:
            is_stacked = jnp.any(settling.bears & episode.is_placed)
            num_stacked = jnp.sum(episode.is_placed & (episode.support_graph.level > 0))
            is_one_more = is_stacked & (num_stacked >= self.config.most_stacked)
            verdict = _instead_of_stable(verdict, is_one_more, Verdict.UNRELATED)
        if self.natural is not None:
            is_refused = self.natural.is_refused(episode, self.geometry, focus)
            is_carried = jnp.any(settling.bears & is_refused)
            verdict = _instead_of_stable(verdict, is_carried, Verdict.UNRELATED)
        if self.related is None:
            return verdict
        is_related = self._is_related(self.related, episode, focus, settling)
        return _instead_of_stable(verdict, ~is_related, Verdict.UNRELATED)

    def _is_related(
        self, related: RelatedObjects, episode: Episode, focus: Array, settling: Settling
    ) -> Array:
        """Whether all relations hold of which both objects are placed, the focus object included; bool."""
        assert episode.roles is not None
        is_placed = episode.is_placed.at[focus].set(True)
        poses = safe_poses(settling.poses, is_placed)
        is_carried = jnp.all(settling.bears | ~carriers_of(related, episode, focus))
        return is_carried & holds_among(
            related, episode.roles, self.geometry, poses, is_placed, episode.region
        )

    def is_in_polygon(self, pose: Array, half_extents: Array) -> Array:
        """bool: whether an object, its pose f32[7] in the polygon's frame, is in it as far as is asked."""
        if self.polygon is None:
            return jnp.bool_(True)
        is_center = self.config.containment == "center"
        points = pose[None, :2] if is_center else box_corners(pose, half_extents)[:, :2]
        return jnp.all(is_in_polygon(points, self.polygon))

    def reaches_beyond(self, episode: Episode, poses: Array) -> Array:
        """Which objects, at `poses` f32[K, 7], reach too far beyond the support's edge; bool[K]."""
        assert self.support_map is not None
        if episode.surface is None:
            shares = shares_beyond(self.support_map, self.geometry, poses)
        else:
            on_one = partial(shares_beyond, geometry=self.geometry, poses=poses)
            each = jax.vmap(on_one)(self.support_map)
            shares = each[jnp.maximum(episode.surface, 0), jnp.arange(each.shape[1])]
        return shares > most_beyond(self.config.overhang)

    def _is_ours(self, episode: Episode, focus: Array) -> Array:
        """bool[K]: what this episode placed, the focus object included."""
        is_focus = jnp.arange(self.geometry.num_objects) == focus
        return (episode.is_placed | is_focus) & ~episode.is_started

    def is_supported(self, episode: Episode, focus: Array, settling: Settling) -> Array:
        """Whether all that this episode placed, the focus object included, has the margin asked for; bool."""
        return ~jnp.any(self._is_ours(episode, focus) & self.lacks_margin(settling))

    def lacks_margin(self, rest: Settling | Piling) -> Array:
        """Which objects have a smaller margin than is asked for, bool[K]; nothing of what is not placed."""
        return rest.margin < self.asked_margins(rest.poses)

    def asked_margins(self, poses: Array) -> Array:
        """f32[K], metres: the support margin asked of objects at `poses`, f32[K, 7]; -inf for none."""
        if not self.config.min_margin:
            return jnp.full(self.geometry.num_objects, -jnp.inf)
        own = self.geometry.own_margins_at(poses)
        return jnp.minimum(self.config.min_margin, OWN_SHARE * own)

    def _push(
        self, episode: Episode, action: Array, height_range: Array, settling: Settling
    ) -> Episode:
        """The episode with the attempt at the end of the object's history."""
        if not self.history_rows:
            return episode
        rows = settling.trajectory[:: self.config.history_stride][: self.history_rows]
        row = episode.attempt
        history = episode.history
        num_steps = settling.num_steps
        if self.history_steps is not None:
            num_steps = jnp.minimum(num_steps, self.history_steps)
        region = jnp.append(episode.region.half_extents, height_range)
        return episode.replace(
            history=History(
                action=history.action.at[row].set(action),
                region=history.region.at[row].set(region),
                trajectory=history.trajectory.at[row].set(rows),
                num_steps=history.num_steps.at[row].set(num_steps),
                is_tried=history.is_tried.at[row].set(True),
            )
        )

    def _commit(
        self, episode: Episode, focus: Array, settling: Settling, is_stable: Array
    ) -> Episode:
        """Stable: the settled poses of all stay and the next slot begins. Else: as it was before."""
        is_focus = jnp.arange(self.geometry.num_objects) == focus
        is_placed = episode.is_placed | is_focus
        support_graph = graph_after_settling(episode.support_graph, is_focus, settling)
        # Where neighbours are not judged, the paper's looser count puts them back by hand.
        moves = is_placed if self.physics.config.judge_neighbours else is_focus
        attempt = jnp.where(is_stable, 0, episode.attempt + 1)
        return episode.replace(
            poses=jnp.where((moves & is_stable)[:, None], settling.poses, episode.poses),
            is_placed=jnp.where(is_stable, is_placed, episode.is_placed),
            slot=episode.slot + is_stable.astype(jnp.int32),
            attempt=attempt,
            support_graph=choose(is_stable, support_graph, episode.support_graph),
            history=choose(
                is_stable, jax.tree.map(jnp.zeros_like, episode.history), episode.history
            ),
        )

    def _count(
        self, episode: Episode, slot: Array, settling: Settling, verdict: Array, reward: Array
    ) -> Episode:
        """The episode with the attempt added to its figures."""
        counts = episode.counts
        return episode.replace(
            verdict=verdict.astype(jnp.int32),
            counts=Counts(
                attempts=counts.attempts.at[slot].add(1),
                steps=counts.steps.at[slot].add(settling.num_steps),
                rest_steps=counts.rest_steps.at[slot].set(
                    jnp.where(verdict == Verdict.STABLE, settling.num_steps, 0)
                ),
                verdicts=counts.verdicts.at[verdict].add(1),
                simulated_steps=counts.simulated_steps + settling.num_steps + settling.check_steps,
                reward=counts.reward + reward,
            ),
        )

    def _take_apart(self, episode: Episode) -> Episode:
        """After failures: the episode is over, or some objects are taken away and come again."""
        config = self.config
        is_over = self.is_spent(episode)
        if not config.ruin_after:
            return episode.replace(is_over=is_over | (episode.attempt >= config.max_attempts))
        stays = episode.is_started
        if episode.surface is not None:
            stays |= episode.surface != episode.surface[self.focus(episode)]
        if config.most_stacked is None:
            which = choose_removal(episode, self.geometry, stays, is_crowded=config.is_crowded)
            ruined = remove(episode, which, self.geometry, self.related)
        else:
            # Where nothing may lie on others, what is large finds no room any more: all begin again.
            ruined = self._largest_first(remove(episode, ~stays, self.geometry, self.related))
        # What could not be filled again within the budget is not worth taking apart.
        is_ruined = (episode.attempt >= config.ruin_after) & ~self.is_spent(ruined)
        return choose(is_ruined, ruined, episode).replace(is_over=is_over)

    def _largest_first(self, episode: Episode) -> Episode:
        """The episode with what is still to be placed drawn into a new order, where that goes by size."""
        if self.config.order not in ("largest", "weighted"):
            return episode
        index = episode.object_index
        weight = self._order_weight(_key_of_attempt(episode.key, 8, episode))
        slots = jnp.arange(len(index))
        rank = jnp.where(slots < episode.slot, -jnp.inf, -weight[jnp.maximum(index, 0)])
        order = jnp.argsort(jnp.where(index < 0, jnp.inf, rank), stable=True)
        counts = episode.counts
        return episode.replace(
            object_index=index[order],
            counts=counts.replace(
                attempts=counts.attempts[order],
                steps=counts.steps[order],
                rest_steps=counts.rest_steps[order],
            ),
        )

    def is_spent(self, episode: Episode) -> Array:
        """Whether the attempts that are left are fewer than the slots to fill, bool."""
        left = episode.num_slots - episode.slot
        return episode.counts.attempts.sum() + left > self.config.max_scene_attempts

    def conclude(self, episode: Episode, standing: Standing, is_filled: Array) -> Episode:
        """The episode after the last check, where it was due (`is_filled`, bool); else as it is."""
        counts = episode.counts
        after = episode.replace(
            is_over=episode.is_over | is_filled,
            is_success=jnp.where(is_filled, standing.verdict == Verdict.STABLE, episode.is_success),
            verdict=jnp.where(is_filled, standing.verdict, episode.verdict),
            drift=jnp.where(is_filled, jnp.max(standing.shift), episode.drift),
            counts=counts.replace(simulated_steps=counts.simulated_steps + standing.num_steps),
        )
        if after.doors is not None and isinstance(standing, Closing):
            closed = after.doors.with_closing(standing)
            after = after.replace(doors=choose(is_filled, closed, after.doors))
        after = self._retry(after, standing, is_filled) if self.config.retry_last else after
        if not isinstance(standing, Closing):
            return after
        # What is placed again is placed with the doors open.
        is_last = is_filled & after.is_over
        assert after.doors is not None
        doors = after.doors.replace(travel=jnp.where(is_last, after.doors.travel, 0.0))
        return after.replace(
            poses=jnp.where(is_last, standing.poses, after.poses),
            doors=choose(is_filled, doors, after.doors),
        )

    def _retry(self, episode: Episode, standing: Standing, is_filled: Array) -> Episode:
        """What moved in the last check is taken away and comes again, if attempts are left."""
        moved = has_moved(standing.shift, standing.turn, self.physics.config)
        if isinstance(standing, Closing):
            moved |= jnp.arange(self.geometry.num_objects) == standing.hit
        moved &= episode.is_placed & ~episode.is_started
        fewer = self.place_again(episode, moved, 6)
        is_crept = standing.verdict == Verdict.CREPT
        if isinstance(standing, Closing):
            is_crept |= standing.verdict == Verdict.BLOCKED
        is_crept &= is_filled
        again = is_crept & jnp.any(moved) & ~self.is_spent(fewer)
        return choose(again, fewer, episode)

    def place_again(self, episode: Episode, which: Array, purpose: int) -> Episode:
        """The episode without the objects `which`, bool[K], and what leans on them, which come again.

        Args:
          purpose: of the key with which the next object's surface and orientation are drawn.
        """
        fewer = remove(episode, which, self.geometry, self.related)
        key = self.new_key(episode, purpose)
        return self._with_draws(fewer.replace(is_over=jnp.bool_(False)), key)

    def new_key(self, episode: Episode, purpose: int) -> Array:
        """A key for a purpose, anew after every attempt."""
        return _key_of_attempt(episode.key, purpose, episode)
