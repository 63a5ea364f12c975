"""Rows, stacks and nests: which objects can be in one, whether they are, and how many of a scene are."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.facts import ObjectFacts, parse_condition
from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.sense import read_sense
from cluttergen_jax.errors import ConfigError, closest, first_names
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.placement.arrangements import NEST, ROW, STACK, parse_arrangements
from cluttergen_jax.placement.boxes import Boxes, reach_up
from cluttergen_jax.placement.region import Region
from cluttergen_jax.placement.world import columns_of, own_margin_of
from cluttergen_jax.types import Array

MAX_TURN = np.radians(5.0).item()
"""By which sides in a row may differ in direction."""
ROW_GAP = 0.008
"""Metres between one and the next in a row, at most."""
_BACKS = 0.02
"""Metres by which backs may differ."""
CENTRED = 0.25
"""Of half the shorter side: so far from the middle of the one below it the next may be."""
_LEVEL = 0.01
"""Metres by which the bases of what stands in a row, or base and top in a stack, may differ."""
_SUNK = 0.005
"""Metres by which what is nested is below the rim."""

# Of what stands in a row: its hull over its box, and its base over the box's, at least.
_BOX_LIKE = 0.85
_NARROW = 0.8
"""Thickness over depth and over height, at most."""

# Of what stands on its like: metres by which columns that touch may differ, and the share of its own margin.
_TOUCHES = 0.002
_OWN_SHARE = 0.5


def row_quaternions(asset: ObjectAsset, free: float = np.inf) -> list[np.ndarray]:
    """How an object may stand in a row, wxyz, the best first; none if it is no box or has no thin side.

    Its thin side is level, and the longest upright if it is below `free`, metres.
    """
    from scipy.spatial import ConvexHull

    sides = 2 * np.asarray(asset.half_extents)
    hull = ConvexHull(asset.vertices).volume / sides.prod()
    thin = int(np.argmin(sides))
    others = [axis for axis in range(3) if axis != thin]
    if hull < _BOX_LIKE or sides[thin] > _NARROW * sides[others].min():
        return []
    found = []
    # As it stands by itself first, then its longest side upright.
    ways = sorted(others, key=lambda axis: (axis != 2, -sides[axis]))
    for axis in ways:
        if sides[axis] >= free:
            continue
        up = np.eye(3)[axis]
        # Its front stays at the front where it can.
        level = np.eye(3)[thin]
        matrix = np.stack([level, np.cross(up, level), up])
        if axis == 2:
            matrix = np.eye(3)
        found.append(_quaternion_of(matrix))
    return found


def lift_of(asset: ObjectAsset) -> float:
    """Metres from an object's origin to that of another like it that is lowered onto it, turned as it is."""
    columns = columns_of(asset)
    return float((columns.top - columns.bottom).max())


def stands_on_itself(asset: ObjectAsset) -> tuple[bool, bool]:
    """Whether an object stands on another like it, and whether it is inside of that then, below its rim.

    Lowered onto it as it is turned, it touches it in columns, within which its centre of mass is by half of
    what it is on a flat table at least.
    """
    columns = columns_of(asset)
    thick = columns.top - columns.bottom
    rest = float(thick.max())
    touching = columns.xy[thick > rest - _TOUCHES] - asset.center_of_mass[:2]
    own = max(own_margin_of(asset), 1e-4)
    is_stacked = len(touching) > 2 and support_margin(touching) >= _OWN_SHARE * own
    sunk = 2 * float(asset.half_extents[2]) - rest
    return is_stacked, is_stacked and sunk > _SUNK


def able_objects(
    objects: Sequence[ObjectAsset],
    facts: Sequence[ObjectFacts],
    arrangements: Sequence[str],
    sense: str = "",
) -> dict[str, np.ndarray]:
    """bool[K] of each role of arrangements: the objects that can do what is asked of them.

    Args:
      sense: the file of the table of sense, by which some things carry nothing; the package's if empty.

    Raises:
      ConfigError: no object is meant, or none of those that are can; it names some that can.
    """
    able: dict[str, np.ndarray] = {}
    for place, each in enumerate(parse_arrangements(arrangements), 1):
        test = parse_condition(each.condition)
        is_meant = np.array([test(fact) for fact in facts])
        if not is_meant.any():
            names = [fact.name for fact in facts]
            raise ConfigError(
                f"arrangement {str(each)!r}: {each.condition!r}, which no object is",
                first_names(list(dict.fromkeys(names)), _MOST_NAMED),
                meant=closest(each.condition.strip("*?"), names),
            )
        can = np.array([_can(each.kind, asset) for asset in objects])
        reason = _CANNOT[each.kind]
        if each.kind == "stack":
            is_stacked = np.array([_people_stack(asset, sense) for asset in objects])
            if (can & is_meant).any():
                reason = "which carry nothing by the table of sense (`sense`)"
            can &= is_stacked
        if not (can & is_meant).any():
            meant, others = (
                [fact.name for fact, chosen in zip(facts, which, strict=True) if chosen]
                for which in (is_meant, can)
            )
            raise ConfigError(
                f"arrangement {str(each)!r} of {first_names(meant, _MOST_NAMED)}, {reason}",
                f"such as {first_names(others, _MOST_NAMED)}"
                if others
                else "none of these objects",
                f"arrangements={(f'{each.kind} {others[0]}:{each.number}',)!r}"
                if others
                else "other objects",
            )
        names = [f"{each.kind}-{place}-{number}" for number in range(1, each.number + 1)]
        able |= dict.fromkeys(names, can)
    return able


_MOST_NAMED = 8
_CANNOT = {
    "row": "which are no boxes with a thin side, that stand upright side by side",
    "stack": "which do not stand on one another",
    "nest": "which are not hollow, or not inside of one another when stacked",
}


def _can(kind: str, asset: ObjectAsset) -> bool:
    if kind == "row":
        return bool(row_quaternions(asset))
    is_stacked, is_sunk = stands_on_itself(asset)
    return is_stacked if kind == "stack" else is_sunk and hollow_of(asset) is not None


def _people_stack(asset: ObjectAsset, sense: str) -> bool:
    """Whether people put an object on its like: what carries nothing else may still sink into it."""
    table = read_sense(sense)
    return table.carries_its_like(table.kind_of(asset)) or _can("nest", asset)


def _quaternion_of(matrix: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_quat(scalar_first=True))


def is_arranged(kind: Array) -> Array:
    """bool[...]: whether a relation is one of an arrangement."""
    return kind >= min(ROW, STACK, NEST)


def hold_arranged(
    kind: Array, subjects: Boxes, references: Boxes, region: Region, is_table: Array
) -> Array:
    """bool[R]: whether what arrangements ask of R pairs of boxes holds; of those of other kinds anything.

    Args:
      kind: i32[R]; is_table: bool[R], the first of a row, which has no other.
    """
    T_region_world = region.T_world_region.inverse()
    turn = T_region_world.rotation().as_matrix()
    offset = (subjects.center - references.center) @ turn.T
    ours = jnp.abs(subjects.sides @ turn.T)
    theirs = jnp.abs(references.sides @ turn.T)
    own = ours.sum(1)
    other = theirs.sum(1)
    # What is turned a little along the region reaches hardly farther than its largest share along it.
    is_square = jnp.all(
        own[:, :2] <= ours.max(1)[:, :2] + jnp.sin(MAX_TURN) * own.max(1)[:, None], axis=1
    )
    is_thin = own[:, 0] <= own[:, 1]
    gap = jnp.abs(offset[:, 0]) - own[:, 0] - other[:, 0]
    backs = jnp.abs(jnp.abs(offset[:, 1]) - jnp.abs(own[:, 1] - other[:, 1]))
    in_row = (
        is_square & is_thin & (is_table | ((gap <= ROW_GAP) & (gap > -ROW_GAP) & (backs <= _BACKS)))
    )
    away = jnp.linalg.norm(offset[:, :2], axis=1)
    is_centred = away <= CENTRED * jnp.min(other[:, :2], axis=1)
    low = subjects.center[:, 2] - reach_up(subjects)
    top = references.center[:, 2] + reach_up(references)
    on_top = is_centred & (subjects.center[:, 2] > references.center[:, 2])
    nested = on_top & (low < top - _SUNK)
    return jnp.where(kind == ROW, in_row, jnp.where(kind == STACK, on_top, nested))


def count_arranged(
    names: Sequence[str], half_extents: np.ndarray, is_hollow: np.ndarray, poses: np.ndarray
) -> tuple[int, int, int]:
    """How many of N objects stand in a row with another, and are stacked on or nested in one of their name.

    In a row: upright side by side, at most 8 mm apart, parallel within 5 degrees, with a thin side each.
    Stacked: upright, centred upon the other and not far above its top. Nested: hollow, and below its rim.

    Args:
      is_hollow: bool[N].
      half_extents: f[N, 3], metres; poses: f[N, 7], world, metres, wxyz.
    """
    poses = np.asarray(poses, float).reshape(-1, 7)
    number = len(poses)
    if not number:
        return 0, 0, 0
    index = np.arange(number)
    matrix = np.array([rotation_matrix(pose[3:]) for pose in poses])
    up = np.argmax(np.abs(matrix[:, 2]), axis=1)
    is_upright = np.abs(matrix[index, 2, up]) > np.cos(MAX_TURN)
    half = np.asarray(half_extents, float)
    # Of the two level sides the thin one, and its direction.
    sides = np.where(np.arange(3) == up[:, None], np.inf, half)
    thin_axis = np.argmin(sides, axis=1)
    thin = half[index, thin_axis]
    high = half[index, up]
    deep = half.sum(1) - thin - high
    way = matrix[index, :2, thin_axis]
    offset = poses[None, :, :3] - poses[:, None, :3]
    along = np.abs(np.einsum("ijx,ix->ij", offset[..., :2], way))
    across = np.abs(offset[..., 0] * -way[:, None, 1] + offset[..., 1] * way[:, None, 0])
    is_pair = is_upright[:, None] & is_upright & ~np.eye(number, dtype=bool)
    is_level = np.abs(offset[..., 2] - high + high[:, None]) < _LEVEL
    is_parallel = np.abs(way @ way.T) > np.cos(MAX_TURN)
    is_thin = thin <= _NARROW * np.minimum(deep, high)
    is_beside = np.abs(along - thin[:, None] - thin) <= ROW_GAP
    is_beside &= across <= np.maximum(deep[:, None], deep)
    in_row = is_pair & is_level & is_parallel & is_thin & is_thin[:, None] & is_beside
    alike = np.array(names)[:, None] == np.array(names)
    away = np.linalg.norm(offset[..., :2], axis=-1)
    low = offset[..., 2] - high
    is_upon = is_pair & alike & (away <= CENTRED * thin[:, None]) & (offset[..., 2] > 0)
    is_upon &= low < high[:, None] + _LEVEL
    is_nested = is_upon & is_hollow & (low < high[:, None] - _SUNK)
    return int(in_row.any(1).sum()), int(is_upon.any(0).sum()), int(is_nested.any(0).sum())
