"""Relations in compiled code: who takes which role, which relations hold, and where they would."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.boxes import Boxes, gaps, is_over
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.containers import is_in
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.relations import (
    KINDS,
    TABLE,
    Relation,
    can_be_filled,
    candidates_of,
    conditions_of,
    order_of,
    parse_relations,
)
from cluttergen_jax.placement.world import MAX_OBJECTS
from cluttergen_jax.types import Array

MAX_ANGLE = np.radians(10.0).item()
"""By which what is aligned may differ."""
CONE = np.radians(45.0).item()
"""To either side of the direction in which a thing to the left, right, front or back of another is."""
ON, IN, ALIGNED = (KINDS.index(kind) for kind in ("on", "in", "aligned"))


class RelatedObjects(struct.PyTreeNode):
    """Relations among K objects by their roles: Q roles, R relations.

    Attributes:
      candidates: bool[Q, K], which object can take which role; in the order in which roles are placed.
      turn: i32[Q], in which order roles are given: those that few objects can take first.
      possible: i32[Q], objects that take all roles together, for draws that end in a dead end.
      subject, reference: i32[R], roles; the reference is Q for the table.
      kind: i32[R], of `relations.KINDS`; gap: f32[R], metres.
    """

    candidates: Array
    turn: Array
    possible: Array
    subject: Array
    reference: Array
    kind: Array
    gap: Array

    @staticmethod
    def of(
        relations: Sequence[Relation],
        roles: Sequence[tuple[str, str]],
        facts: Sequence[ObjectFacts],
    ) -> RelatedObjects:
        """For a world of objects.

        Raises:
          ConfigError: a role fits no object, or there are not enough different objects for all roles.
        """
        from scipy.optimize import linear_sum_assignment

        conditions = conditions_of(roles, relations)
        placed = order_of(relations)
        names = [*placed, *(name for name in conditions if name not in placed)]
        candidates = candidates_of({name: conditions[name] for name in names}, facts)
        if not can_be_filled(candidates):
            raise ConfigError(
                f"{len(names)} roles ({', '.join(names)}), for which the objects do not suffice",
                "a different object for each role",
                "more objects, or repeat=True, where each may come more than once",
            )
        number = {name: place for place, name in enumerate(names)} | {TABLE: len(names)}
        return RelatedObjects(
            candidates=jnp.asarray(candidates),
            turn=jnp.asarray(np.argsort(candidates.sum(1), kind="stable"), jnp.int32),
            possible=jnp.asarray(linear_sum_assignment(~candidates)[1], jnp.int32),
            subject=jnp.array([number[each.subject] for each in relations], jnp.int32),
            reference=jnp.array([number[each.reference] for each in relations], jnp.int32),
            kind=jnp.array([KINDS.index(each.kind) for each in relations], jnp.int32),
            gap=jnp.array([each.gap for each in relations], jnp.float32),
        )

    @property
    def num_roles(self) -> int:
        """Q."""
        return self.candidates.shape[0]

    def draw(self, key: Array) -> Array:
        """i32[Q]: an object for each role, drawn one after another among those that are left."""
        noise = jax.random.gumbel(key, self.candidates.shape)

        def give(
            state: tuple[Array, Array, Array], role: Array
        ) -> tuple[tuple[Array, Array, Array], None]:
            objects, is_taken, is_stuck = state
            rank = jnp.where(self.candidates[role] & ~is_taken, noise[role], -jnp.inf)
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
        number = self.candidates.shape[1]
        return (
            jnp.full(number, self.num_roles, jnp.int32).at[objects].set(jnp.arange(self.num_roles))
        )

    def pairs(self, objects: Array, focus: Array) -> tuple[Array, Array, Array, Array]:
        """What the relations say of one object.

        Returns:
          bool[R], it is the subject; bool[R], it is the reference; i32[R], the other object (any for the
          table); bool[R], the other is the table.
        """
        full = jnp.append(objects, 0)
        subject = full[self.subject]
        reference = full[self.reference]
        is_table = self.reference == self.num_roles
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
    relations = parse_relations(config.relations)
    roles = config.roles
    if not relations and not roles:
        return objects, None
    conditions = conditions_of(roles, relations)
    facts = [ObjectFacts.of(each) for each in objects]
    copies = 1
    while may_repeat and (copies + 1) * len(objects) <= MAX_OBJECTS:
        if can_be_filled(candidates_of(conditions, facts * copies)):
            break
        copies += 1
    return (*objects,) * copies, RelatedObjects.of(relations, roles, facts * copies)


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
    gap = jax.vmap(lambda one, two: gaps(_alone(one), _alone(two))[0, 0])(subjects, references)
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
    return table[related.kind, jnp.arange(len(related.kind))]


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


def _is_aligned(related: RelatedObjects, subjects: Boxes, references: Boxes, turn: Array) -> Array:
    angle = heading_of(subjects, turn)
    is_table = related.reference == related.num_roles
    angle -= jnp.where(is_table, 0.0, heading_of(references, turn))
    # To the table any side will do, to an object the longer one.
    period = jnp.where(is_table, jnp.pi / 2, jnp.pi)
    away = jnp.mod(angle + period / 2, period) - period / 2
    return jnp.abs(away) <= MAX_ANGLE


def holds_among(
    related: RelatedObjects,
    objects: Array,
    boxes: Boxes,
    openings: Boxes,
    is_placed: Array,
    region: Region,
) -> Array:
    """bool: every relation holds of which both objects are placed, but for "on".

    Args:
      objects: i32[Q], of each role; boxes, openings: K; is_placed: bool[K].
    """
    full = jnp.append(objects, 0)
    subject = full[related.subject]
    reference = full[related.reference]
    is_there = is_placed[subject] & (
        is_placed[reference] | (related.reference == related.num_roles)
    )
    take = _taker(boxes)
    opening = _taker(openings)(reference)
    return jnp.all(hold(related, take(subject), take(reference), opening, region) | ~is_there)


def _taker(boxes: Boxes) -> Callable[[Array], Boxes]:
    return lambda index: Boxes(boxes.center[index], boxes.sides[index])


def allowed_at(
    related: RelatedObjects,
    objects: Array,
    focus: Array,
    proposed: Boxes,
    placed: Boxes,
    openings: Boxes,
    is_placed: Array,
    region: Region,
) -> Array:
    """bool[N]: at which candidates every relation of the current object with what is placed would hold.

    Of "on" only that the one's middle is over the other.

    Args:
      objects: i32[Q]; focus: i32; proposed: N boxes of the current object; placed, openings:
        K; is_placed: bool[K].
    """
    is_subject, is_reference, other, is_table = related.pairs(objects, focus)
    counts = (is_subject | is_reference) & (is_placed[other] | is_table)
    # What is in a thing comes after it.
    others = _taker(placed)(other)
    opening = _taker(openings)(other)

    def at(center: Array, sides: Array) -> Array:
        own = Boxes(
            jnp.broadcast_to(center, others.center.shape),
            jnp.broadcast_to(sides, others.sides.shape),
        )

        def pick(one: Boxes, two: Boxes) -> Boxes:
            return Boxes(
                jnp.where(is_subject[:, None], one.center, two.center),
                jnp.where(is_subject[:, None, None], one.sides, two.sides),
            )

        subjects = pick(own, others)
        references = pick(others, own)
        is_well = hold(related, subjects, references, opening, region)
        is_well &= (related.kind != ON) | is_over(subjects.center, references, 1.0)
        return jnp.all(is_well | ~counts)

    return jax.vmap(at)(proposed.center, proposed.sides)


def leaves_room(
    related: RelatedObjects,
    objects: Array,
    focus: Array,
    xy: Array,
    half_extents: Array,
    region: Region,
) -> Array:
    """bool[N]: whether the region goes on where things would be that come beside the current object later.

    Args:
      objects: i32[Q]; focus: i32; xy: f32[N, 2], candidates in the region frame; half_extents: f32[K, 3].
    """
    full = jnp.append(objects, 0)
    subject = full[related.subject]
    reference = full[related.reference]
    direction = jnp.array(_DIRECTIONS)[related.kind]
    asks = (
        (reference == focus)
        & (related.reference < related.num_roles)
        & jnp.any(direction != 0, axis=1)
    )
    radius = half_extents[:, :2].mean(1)
    away = radius[focus] + radius[subject] + _ROOM
    there = xy[:, None] + away[:, None] * direction
    return jnp.all(jnp.all(jnp.abs(there) <= region.half_extents, axis=-1) | ~asks, axis=1)


_ROOM = 0.01
_SIDES = {
    "left_of": (-1.0, 0.0),
    "right_of": (1.0, 0.0),
    "in_front_of": (0.0, -1.0),
    "behind": (0.0, 1.0),
}
_DIRECTIONS = [_SIDES.get(kind, (0.0, 0.0)) for kind in KINDS]


def carriers_of(related: RelatedObjects, objects: Array, focus: Array, is_placed: Array) -> Array:
    """bool[K]: the placed objects on which the current object is to lie."""
    is_subject, _, other, _ = related.pairs(objects, focus)
    wanted = is_subject & (related.kind == ON) & is_placed[other]
    return jnp.zeros_like(is_placed).at[other].max(wanted)
