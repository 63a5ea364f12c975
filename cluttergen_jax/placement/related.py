"""Relations in compiled code: who takes which role, which relations hold, and where they would."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.arranged import able_objects, hold_arranged, is_arranged, lift_of
from cluttergen_jax.placement.arrangements import (
    ALL_KINDS,
    ARRANGED,
    NEST,
    ROW,
    STACK,
    parse_arrangements,
)
from cluttergen_jax.placement.boxes import Boxes, gaps, is_over
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.containers import is_in, openings_of
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.relations import (
    KINDS,
    TABLE,
    Relation,
    can_be_filled,
    candidates_of,
    conditions_of,
    object_names,
    order_of,
)
from cluttergen_jax.placement.types import Episode, Geometry, choose
from cluttergen_jax.placement.world import MAX_OBJECTS
from cluttergen_jax.types import Array

MAX_ANGLE = np.radians(10.0).item()
"""By which what is aligned may differ."""
CONE = np.radians(45.0).item()
"""To either side of the direction in which a thing to the left, right, front or back of another is."""
CONE_SPREAD = np.radians(8.0).item()
"""Standard deviation of the angle from the middle of that cone at which people put things."""
TURN_SPREAD = np.radians(4.0).item()
"""Standard deviation of the turn from the axes of what a thing is put beside."""
USUAL_GAP = 0.15
"""Share of the gap that a relation allows that people leave: 2 cm beside a plate."""
_NEAR = 0.1
"""Share of it by which another gap weighs 1/e of that."""
_MIDDLE = 0.35
"""Standard deviation of the offset of what is on or in a thing, of that one's half side."""
_LEAST_LOGIT = -60.0
_LONG = 1.15
"""A longer side over the shorter one, in plan, from which it is seen how a thing is turned."""
ON, IN, ALIGNED = (KINDS.index(kind) for kind in ("on", "in", "aligned"))


_ROOM = 0.01
"""Metres beside an object that have to be free for one that is to come there."""
_SIDES = {
    "left_of": (-1.0, 0.0),
    "right_of": (1.0, 0.0),
    "in_front_of": (0.0, -1.0),
    "behind": (0.0, 1.0),
}
DIRECTIONS = [_SIDES.get(kind, (0.0, 0.0)) for kind in KINDS]
"""By kind: the direction in which the subject is, region frame; none of kinds without a side."""


class RelatedObjects(struct.PyTreeNode):
    """Relations among K objects by their roles: Q roles, R relations.

    Attributes:
      candidates: bool[Q, K], which object can take which role; in the order in which roles are placed.
      turn: i32[Q], in which order roles are given: those that few objects can take first.
      possible: i32[Q], objects that take all roles together, for draws that end in a dead end.
      subject, reference: i32[R], roles; the reference is Q for the table.
      kind: i32[R], of `arrangements.ALL_KINDS`; gap: f32[R], metres.
      ways_in: f32[K, K, P], log weights of the orientations in which an object, row, is released over a
        container, column, in which it is to be; None where it is released as anywhere. This and the next are
        those of `placement.ways_in.find_ways_in`.
      goes_in: bool[K, K], False where no such orientation was found.
      asset: i32[K], equal for copies of the same thing; lift: f32[K], metres, `arranged.lift_of` each. None
        where nothing is stacked or nested.
      is_arranged: whether there are rows, stacks or nests among them.
      is_against_back: rows stand before the back of a shelf.
    """

    candidates: Array
    turn: Array
    possible: Array
    subject: Array
    reference: Array
    kind: Array
    gap: Array
    ways_in: Array | None = None
    goes_in: Array | None = None
    asset: Array | None = None
    lift: Array | None = None
    is_arranged: bool = struct.field(pytree_node=False, default=False)
    is_against_back: bool = struct.field(pytree_node=False, default=False)

    @staticmethod
    def of(
        relations: Sequence[Relation],
        roles: Sequence[tuple[str, str]],
        facts: Sequence[ObjectFacts],
        able: Mapping[str, np.ndarray] | None = None,
    ) -> RelatedObjects:
        """For a world of objects.

        Args:
          able: bool[K] of roles, the objects that can do what an arrangement asks of them.

        Raises:
          ConfigError: a role fits no object, or there are not enough different objects for all roles.
        """
        from scipy.optimize import linear_sum_assignment

        conditions = conditions_of(roles, relations)
        placed = order_of(relations)
        names = [*placed, *(name for name in conditions if name not in placed)]
        candidates = _able_of({name: conditions[name] for name in names}, facts, able or {})
        if not can_be_filled(candidates):
            raise ConfigError(
                f"{len(names)} different objects ({', '.join(object_names(conditions))}), of which "
                "there are too few",
                "a different object for each",
                "repeat=True, or more objects",
            )
        number = {name: place for place, name in enumerate(names)} | {TABLE: len(names)}
        return RelatedObjects(
            candidates=jnp.asarray(candidates),
            turn=jnp.asarray(np.argsort(candidates.sum(1), kind="stable"), jnp.int32),
            possible=jnp.asarray(linear_sum_assignment(~candidates)[1], jnp.int32),
            subject=jnp.array([number[each.subject] for each in relations], jnp.int32),
            reference=jnp.array([number[each.reference] for each in relations], jnp.int32),
            kind=jnp.array([ALL_KINDS.index(each.kind) for each in relations], jnp.int32),
            gap=jnp.array([each.gap for each in relations], jnp.float32),
            is_arranged=any(each.kind in ARRANGED for each in relations),
        )

    def _below(self) -> Array:
        """i32[Q]: the role that the one of a stack or a nest is put upon; its own for all others."""
        own = jnp.arange(self.num_roles)
        is_upon = (self.kind == STACK) | (self.kind == NEST)
        place = jnp.where(is_upon, self.subject, self.num_roles)
        return own.at[place].set(self.reference, mode="drop")

    @property
    def in_row(self) -> np.ndarray:
        """bool[K]: the objects that may stand in a row; outside `jit`."""
        subject = np.asarray(self.subject)[np.asarray(self.kind) == ROW]
        return np.asarray(self.candidates)[subject].any(0)

    def dependence(self, objects: Array) -> Array:
        """bool[K, K], row k: what object k was put beside or upon by an arrangement.

        Args:
          objects: i32[Q], of each role.
        """
        subject, reference, is_table = self.ends(objects)
        number = self.candidates.shape[1]
        depends = is_arranged(self.kind) & ~is_table
        return jnp.zeros((number, number), bool).at[subject, reference].max(depends)

    @property
    def num_roles(self) -> int:
        """Q."""
        return self.candidates.shape[0]

    def draw(self, key: Array) -> Array:
        """i32[Q]: an object for each role, drawn one after another among those that are left."""
        noise = jax.random.gumbel(key, self.candidates.shape)

        before = self._below()

        def give(
            state: tuple[Array, Array, Array], role: Array
        ) -> tuple[tuple[Array, Array, Array], None]:
            objects, is_taken, is_stuck = state
            is_possible = self.candidates[role] & ~is_taken
            if self.asset is not None:
                # The one below has its object already: those of an arrangement are given in their order.
                is_equal = self.asset == self.asset[objects[before[role]]]
                is_possible &= is_equal | (before[role] == role)
            rank = jnp.where(is_possible, noise[role], -jnp.inf)
            chosen = jnp.argmax(rank).astype(jnp.int32)
            is_stuck |= ~jnp.isfinite(rank[chosen])
            return (objects.at[role].set(chosen), is_taken.at[chosen].set(True), is_stuck), None

        first = (
            jnp.zeros_like(self.possible),
            jnp.zeros(self.candidates.shape[1], bool),
            jnp.bool_(False),
        )
        (objects, _, is_stuck), _ = jax.lax.scan(give, first, self.turn)
        return jnp.where(is_stuck, self.possible, objects)

    def priority(self, objects: Array) -> Array:
        """i32[K]: the place of each object in the order of placing, Q for those without a role.

        Args:
          objects: i32[Q], of each role.
        """
        last = jnp.full(self.candidates.shape[1], self.num_roles, jnp.int32)
        return last.at[objects].set(jnp.arange(self.num_roles))

    def ends(self, objects: Array) -> tuple[Array, Array, Array]:
        """Of each relation: i32[R], its subject; i32[R], its reference; bool[R], that is the table."""
        full = jnp.append(objects, 0)
        is_table = self.reference == self.num_roles
        return full[self.subject], full[self.reference], is_table

    def pairs_of(self, kind: int) -> np.ndarray:
        """bool[K, K]: objects, rows, that may be the subject of a relation of a kind, and its references."""
        candidates = np.asarray(self.candidates)
        found = np.zeros((candidates.shape[1],) * 2, bool)
        for each in np.flatnonzero(np.asarray(self.kind) == kind).tolist():
            subject = candidates[int(self.subject[each])]
            found |= subject[:, None] & candidates[int(self.reference[each])]
        np.fill_diagonal(found, False)
        return found

    def draw_way_in(self, key: Array, objects: Array, focus: Array, usual: Array) -> Array:
        """i32: an orientation of the focus object, drawn for what it is to be in, else `usual`, i32."""
        if self.ways_in is None:
            return usual
        is_subject, _, other, _ = self.pairs(objects, focus)
        goes_in = is_subject & (self.kind == IN)
        container = other[jnp.argmax(goes_in)]
        drawn = jax.random.categorical(key, self.ways_in[focus, container]).astype(jnp.int32)
        return jnp.where(jnp.any(goes_in), drawn, usual)

    def pairs(self, objects: Array, focus: Array) -> tuple[Array, Array, Array, Array]:
        """What the relations say of one object.

        Returns:
          bool[R], it is the subject; bool[R], it is the reference; i32[R], the other object (any for the
          table); bool[R], the other is the table.
        """
        subject, reference, is_table = self.ends(objects)
        is_subject = subject == focus
        is_reference = (reference == focus) & ~is_table
        return is_subject, is_reference, jnp.where(is_subject, reference, subject), is_table


def relate_objects(
    objects: Sequence[ObjectAsset], config: PlacementConfig, may_repeat: bool
) -> tuple[Sequence[ObjectAsset], RelatedObjects | None]:
    """The objects, repeated until each role has its own if they may be, and what is related of them.

    Raises:
      ConfigError: a role fits no object, or there are too few.
    """
    relations = config.all_relations
    roles = config.all_roles
    if not relations and not roles:
        return objects, None
    conditions = conditions_of(roles, relations)
    facts = [ObjectFacts.of(each) for each in objects]
    able = {}
    if config.arrangements:
        able = able_objects(objects, facts, config.arrangements, config.sense)
    copies = 1
    while may_repeat and (copies + 1) * len(objects) <= MAX_OBJECTS:
        if can_be_filled(_able_of(conditions, facts * copies, able)):
            break
        copies += 1
    related = RelatedObjects.of(relations, roles, facts * copies, able)
    objects = (*objects,) * copies
    if any(each.kind in ("stack", "nest") for each in parse_arrangements(config.arrangements)):
        names = [each.name for each in objects]
        known = {name: lift_of(each) for name, each in zip(names, objects, strict=True)}
        related = related.replace(
            asset=jnp.array([names.index(name) for name in names], jnp.int32),
            lift=jnp.array([known[name] for name in names], jnp.float32),
        )
    return objects, related


def _able_of(
    conditions: Mapping[str, str], facts: Sequence[ObjectFacts], able: Mapping[str, np.ndarray]
) -> np.ndarray:
    """bool[Q, K]: which of K objects can take which role; `able` is of the first of their copies.

    Of a stack or a nest, whose objects are equal, are those of which there are enough.
    """
    found = candidates_of(conditions, facts)
    number = Counter(fact.name for fact in facts)
    for row, name in zip(found, conditions, strict=True):
        if name not in able:
            continue
        row &= np.tile(able[name], len(facts) // len(able[name]))
        kind, place, _ = name.split("-")
        if kind != "row":
            asked = sum(other.startswith(f"{kind}-{place}-") for other in able)
            row &= [number[fact.name] >= asked for fact in facts]
    return found


def hold(
    related: RelatedObjects, subjects: Boxes, references: Boxes, openings: Boxes, region: Region
) -> Array:
    """bool[R]: which relations hold of R pairs of boxes, as far as boxes tell; "on" is for contacts to tell.

    Args:
      subjects, references: R boxes each, world; those of the table may be anything.
      openings: of the references (`containers.openings_of`).
    """
    T_region_world = region.T_world_region.inverse()
    turn = T_region_world.rotation().as_matrix()
    offset = (subjects.center - references.center) @ turn.T

    def gap_of(one: Boxes, two: Boxes) -> Array:
        return gaps(_alone(one), _alone(two))[0, 0]

    gap = jax.vmap(gap_of)(subjects, references)
    x = offset[:, 0]
    y = offset[:, 1]
    is_near = gap <= related.gap
    # Seen by one who stands at the region's -y side and looks along +y.
    to_the_right = _in_cone(x, y)
    to_the_back = _in_cone(y, x)
    to_the_left = _in_cone(-x, y)
    to_the_front = _in_cone(-y, x)
    over = is_over(subjects.center, references, 1.0)
    by_kind = {
        "on": jnp.ones_like(over),
        "in": is_in(subjects, openings),
        "next_to": is_near & ~over,
        "far_from": gap >= related.gap,
        "left_of": to_the_left & is_near,
        "right_of": to_the_right & is_near,
        "in_front_of": to_the_front & is_near,
        "behind": to_the_back & is_near,
        "aligned": _is_aligned(related, subjects, references, turn),
    }
    table = jnp.stack([by_kind[kind] for kind in KINDS])
    holds = table[related.kind, jnp.arange(len(related.kind))]
    if not related.is_arranged:
        return holds
    is_table = related.reference == related.num_roles
    arranged = hold_arranged(related.kind, subjects, references, region, is_table)
    return jnp.where(is_arranged(related.kind), arranged, holds)


def _alone(box: Boxes) -> Boxes:
    return Boxes(box.center[None], box.sides[None])


def _in_cone(along: Array, across: Array) -> Array:
    return (along > 0) & (jnp.abs(across) <= jnp.tan(CONE) * along)


def heading_of(boxes: Boxes, turn: Array) -> Array:
    """f32[N]: the angle of each box's longest side in plan, in the region; modulo half a turn."""
    flat = (boxes.sides @ turn.T)[:, :, :2]
    longest = jnp.argmax(jnp.linalg.norm(flat, axis=-1), axis=1)
    side = flat[jnp.arange(len(longest)), longest]
    return jnp.arctan2(side[:, 1], side[:, 0])


def is_long(boxes: Boxes) -> Array:
    """bool[N]: whether it is seen how a box is turned: one side is longer than the other, in plan."""
    plan = jnp.sort(jnp.linalg.norm(boxes.sides[..., :2], axis=-1), axis=-1)
    return plan[:, 2] > _LONG * plan[:, 1]


def usual_heading(across: Array, references: Boxes, turn: Array) -> Array:
    """f32[N]: how people turn what is beside another, the angle of its longest side, modulo half a turn.

    It lies across the line between both, like cutlery beside a plate; along the nearest axis of the other
    where that one is long itself.

    Args:
      across: f32[N], radians, the angle of that line plus a quarter of a turn, region frame.
      turn: f32[3, 3], from the world to the region.
    """
    quarter = jnp.pi / 2
    heading = heading_of(references, turn)
    along = heading + quarter * jnp.round((across - heading) / quarter)
    return jnp.where(is_long(references), along, across)


class _PlacedPairs(NamedTuple):
    """The current object and, relation by relation, what it is related to. R relations.

    Attributes:
      is_subject: bool[R], the current object is the subject; counts: bool[R], the other is placed.
      others, openings: R boxes, of the other object, and of its hollow.
    """

    is_subject: Array
    counts: Array
    others: Boxes
    openings: Boxes

    @staticmethod
    def of(
        related: RelatedObjects, episode: Episode, focus: Array, geometry: Geometry
    ) -> _PlacedPairs:
        """Of the current object, i32, in an episode."""
        assert episode.roles is not None
        is_subject, is_reference, other, is_table = related.pairs(episode.roles, focus)
        counts = (is_subject | is_reference) & (episode.is_placed[other] | is_table)
        poses = episode.safe_poses
        others = Boxes.of(geometry.half_extents, poses).take(other)
        # What is in a thing comes after it.
        return _PlacedPairs(is_subject, counts, others, openings_of(geometry, poses).take(other))

    def boxes_at(self, box: Boxes) -> tuple[Boxes, Boxes, Boxes]:
        """The current object's box R times, and R boxes each of subjects and of references."""
        own = box.repeat(len(self.is_subject))
        subjects = jax.vmap(choose)(self.is_subject, own, self.others)
        references = jax.vmap(choose)(self.is_subject, self.others, own)
        return own, subjects, references


def preference(
    related: RelatedObjects, episode: Episode, focus: Array, proposed: Boxes, geometry: Geometry
) -> Array:
    """f32[N]: log weights, at most 0, of candidates by where people put what is so related; no bans.

    On a side: near the middle of its cone, close by. Next to: close by. On, in: over the middle. Beside in
    any way: turned by `usual_heading`. Aligned: exactly. Far from: anywhere.

    Args:
      focus: i32, the current object; proposed: N boxes of it.
    """
    pairs = _PlacedPairs.of(related, episode, focus, geometry)
    counts = pairs.counts
    turn = episode.region.T_world_region.inverse().rotation().as_matrix()
    side = jnp.array(DIRECTIONS)[related.kind]
    has_side = jnp.any(side != 0, axis=1)

    def is_kind(*names: str) -> Array:
        return jnp.isin(related.kind, jnp.array([KINDS.index(name) for name in names]))

    def at(box: Boxes) -> Array:
        own, subjects, references = pairs.boxes_at(box)
        offset = ((subjects.center - references.center) @ turn.T)[:, :2]
        gap = jax.vmap(lambda one, two: gaps(_alone(one), _alone(two))[0, 0])(subjects, references)
        line = jnp.where(has_side[:, None], side, offset)
        away = jnp.arctan2(
            offset[:, 0] * side[:, 1] - offset[:, 1] * side[:, 0], jnp.sum(offset * side, axis=1)
        )
        by_side = -((away / CONE_SPREAD) ** 2) / 2
        by_gap = -jnp.abs(gap / jnp.nan_to_num(related.gap, nan=1.0) - USUAL_GAP) / _NEAR
        hollows = jax.vmap(choose)(is_kind("in") & pairs.is_subject, pairs.openings, references)
        inner = ((subjects.center - hollows.center) @ turn.T)[:, :2]
        plan = jnp.sort(jnp.linalg.norm(hollows.sides[..., :2], axis=-1), axis=-1)[:, 1:]
        by_middle = -jnp.sum(inner**2, axis=1) / jnp.mean((_MIDDLE * plan) ** 2, axis=1) / 2
        across = jnp.arctan2(line[:, 0], -line[:, 1])
        wanted = usual_heading(across, pairs.others, turn)
        turned = jnp.mod(heading_of(own, turn) - wanted + jnp.pi / 2, jnp.pi) - jnp.pi / 2
        by_turn = jnp.where(is_long(own), -((turned / TURN_SPREAD) ** 2) / 2, 0.0)
        aligned = _turn_away(related, subjects, references, turn)
        is_beside = has_side | is_kind("next_to")
        is_turned = is_beside & ~jnp.any(counts & is_kind("aligned"))
        logit = jnp.where(has_side, by_side, 0.0)
        logit += jnp.where(is_beside, by_gap, 0.0)
        logit += jnp.where(is_kind("on", "in"), by_middle, 0.0)
        logit += jnp.where(is_turned, by_turn, 0.0)
        logit += jnp.where(is_kind("aligned"), -((aligned / TURN_SPREAD) ** 2) / 2, 0.0)
        return jnp.sum(jnp.where(counts, logit, 0.0))

    return jnp.maximum(jax.vmap(at)(proposed), _LEAST_LOGIT)


def _is_aligned(related: RelatedObjects, subjects: Boxes, references: Boxes, turn: Array) -> Array:
    return jnp.abs(_turn_away(related, subjects, references, turn)) <= MAX_ANGLE


def _turn_away(related: RelatedObjects, subjects: Boxes, references: Boxes, turn: Array) -> Array:
    """f32[R], radians: by how much the subject of each pair is turned from what it is aligned to."""
    angle = heading_of(subjects, turn)
    is_table = related.reference == related.num_roles
    angle -= jnp.where(is_table, 0.0, heading_of(references, turn))
    # To the table any side will do, to an object the longer one.
    period = jnp.where(is_table, jnp.pi / 2, jnp.pi)
    return jnp.mod(angle + period / 2, period) - period / 2


def holds_among(
    related: RelatedObjects,
    objects: Array,
    geometry: Geometry,
    poses: Array,
    is_placed: Array,
    region: Region,
) -> Array:
    """bool: every relation holds of which both objects are placed, but for "on".

    Args:
      objects: i32[Q], of each role; poses: f32[K, 7], world; is_placed: bool[K].
    """
    subject, reference, is_table = related.ends(objects)
    is_there = is_placed[subject] & (is_placed[reference] | is_table)
    boxes = Boxes.of(geometry.half_extents, poses)
    opening = openings_of(geometry, poses).take(reference)
    holds = hold(related, boxes.take(subject), boxes.take(reference), opening, region)
    return jnp.all(holds | ~is_there)


def allowed_at(
    related: RelatedObjects, episode: Episode, focus: Array, proposed: Boxes, geometry: Geometry
) -> Array:
    """bool[N]: at which candidates every relation of the current object with what is placed would hold.

    Of "on" only that the one's middle is over the other.

    Args:
      focus: i32, the current object; proposed: N boxes of it.
    """
    pairs = _PlacedPairs.of(related, episode, focus, geometry)

    def at(box: Boxes) -> Array:
        _, subjects, references = pairs.boxes_at(box)
        is_well = hold(related, subjects, references, pairs.openings, episode.region)
        is_well &= (related.kind != ON) | is_over(subjects.center, references, 1.0)
        return jnp.all(is_well | ~pairs.counts)

    return jax.vmap(at)(proposed)


def leaves_room(
    related: RelatedObjects, episode: Episode, focus: Array, xy: Array, geometry: Geometry
) -> Array:
    """bool[N]: whether the region goes on where things would be that come beside the current object later.

    Args:
      focus: i32, the current object; xy: f32[N, 2], candidates in the region frame.
    """
    assert episode.roles is not None
    subject, reference, is_table = related.ends(episode.roles)
    direction = jnp.array(DIRECTIONS)[related.kind]
    asks = (reference == focus) & ~is_table & jnp.any(direction != 0, axis=1)
    radius = geometry.half_extents[:, :2].mean(1)
    away = radius[focus] + radius[subject] + _ROOM
    there = xy[:, None] + away[:, None] * direction
    is_within = jnp.all(jnp.abs(there) <= episode.region.half_extents, axis=-1)
    return jnp.all(is_within | ~asks, axis=1)


def carriers_of(related: RelatedObjects, episode: Episode, focus: Array) -> Array:
    """bool[K]: the placed objects on which the current object is to lie."""
    assert episode.roles is not None
    is_placed = episode.is_placed
    is_subject, _, other, _ = related.pairs(episode.roles, focus)
    carried = related.kind == ON
    if related.is_arranged:
        carried |= (related.kind == STACK) | (related.kind == NEST)
    wanted = is_subject & carried & is_placed[other]
    return jnp.zeros_like(is_placed).at[other].max(wanted)
