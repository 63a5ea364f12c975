"""Doors and drawers of a support: where it and what it carries are when they stand elsewhere.

Joints move by the product of exponentials, with the support as it stands as the reference configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import as_meshes, hull_of
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.support import (
    Box,
    Rectangle,
    Ring,
    SupportAsset,
    Surface,
    parse_surfaces,
)
from cluttergen_jax.assets.support_map import free_height, surface_heights
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane

_HAIR = 1e-6
"""Radians and metres: doors that are nearer to closed are closed."""
WIDEST = math.radians(100)
"""Radians by which a hinge is opened at most."""
_LEAST = (math.radians(20), 0.05)
"""Radians and metres: what moves less is no door and no drawer."""
_ENDLESS = 100.0
"""Radians or metres: files state such limits where they mean none."""
_UPRIGHT = 1 - 1e-9
# Of a region: shares of its half extents at which it is looked what is below, and how deep, metres.
_SHARES = np.stack(np.meshgrid(*[np.linspace(-0.8, 0.8, 5)] * 2), -1).reshape(-1, 2)
_BELOW = 0.001
_CELL = 0.005
"""Metres: of the grid by which it is measured how high it is free over a surface that moved."""


def moves_of(joints: Sequence[Joint], travel: np.ndarray) -> np.ndarray:
    """f64[..., J, 4, 4]: from where each joint's link stands to where it is once joints have moved.

    Args:
      travel: f64[..., J], by which each joint has moved, radians or metres.
    """
    moves = np.zeros((*travel.shape, 4, 4))
    done: set[int] = set()

    def move(number: int) -> None:
        if number in done:
            return
        joint = joints[number]
        own = _own_move(joint, travel[..., number])
        if joint.parent >= 0:
            move(joint.parent)
            own = moves[..., joint.parent, :, :] @ own
        moves[..., number, :, :] = own
        done.add(number)

    for number in range(len(joints)):
        move(number)
    return moves


def _own_move(joint: Joint, travel: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4]: the move of one joint alone by f64[...]."""
    T = np.broadcast_to(np.eye(4), (*travel.shape, 4, 4)).copy()
    axis = np.array(joint.axis)
    if joint.kind == "slide":
        T[..., :3, 3] = travel[..., None] * axis
        return T
    x, y, z = axis.tolist()
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sin = np.sin(travel)[..., None, None]
    cos = np.cos(travel)[..., None, None]
    T[..., :3, :3] = np.eye(3) + sin * skew + (1 - cos) * skew @ skew
    anchor = np.array(joint.anchor)
    T[..., :3, 3] = anchor - T[..., :3, :3] @ anchor
    return T


def with_joints_at(support: SupportAsset, values: Mapping[int, float]) -> SupportAsset:
    """The support with some joints elsewhere, and all that they move; surfaces that are tipped are lost.

    Args:
      values: radians or metres, as `Joint.value`, by the joint's number.
    """
    travel = np.zeros(len(support.joints))
    for number, value in values.items():
        travel[number] = value - support.joints[number].value
    if not travel.any():
        return support
    moves = moves_of(support.joints, travel)
    by_box = _movers(support, "boxes")
    boxes: list[Box] = []
    new_parts: list[Mesh] = []
    place_of_box: dict[int, int] = {}
    for index, box in enumerate(support.boxes):
        moved = _moved_box(box, moves, by_box.get(index))
        if moved is None:
            points = _points(box.mesh.vertices, moves[by_box[index]])
            new_parts.append(as_meshes([points])[0])
            place_of_box[index] = -len(new_parts)
        else:
            place_of_box[index] = len(boxes)
            boxes.append(moved)
    by_part = _movers(support, "parts")
    parts = [
        part
        if index not in by_part
        else as_meshes([_points(part.vertices, moves[by_part[index]])])[0]
        for index, part in enumerate(support.parts)
    ]
    by_piece = _movers(support, "pieces")
    pieces = [
        piece
        if index not in by_piece
        else piece.transform(moves[by_piece[index]][:3, :3], moves[by_piece[index]][:3, 3])
        for index, piece in enumerate(support.pieces)
    ]
    joints = []
    for number, joint in enumerate(support.joints):
        T = moves[number]
        places = [place_of_box[index] for index in joint.boxes]
        joints.append(
            replace(
                joint.transform(T[:3, :3], 1.0, T[:3, 3]),
                value=values.get(number, joint.value),
                range=joint.range,
                closed=joint.closed,
                boxes=tuple(place for place in places if place >= 0),
                parts=(*joint.parts, *(len(parts) - place - 1 for place in places if place < 0)),
            )
        )
    found = replace(
        support,
        boxes=tuple(boxes),
        parts=(*parts, *new_parts),
        pieces=tuple(pieces),
        joints=tuple(joints),
    )
    if not support.named:
        return found
    surfaces = []
    for surface, by in zip(support.named, carriers_of(support), strict=True):
        moved_surface = surface if by < 0 else _moved_surface(surface, moves[by])
        if moved_surface is not None:
            surfaces.append(moved_surface)
    named = tuple(_with_free_height(found, surface) for surface in surfaces)
    if len(named) < len(support.named):
        return replace(found, named=named, surface="")
    first = parse_surfaces(support.surface, named)[0][0]
    return replace(found, named=named, top=first.position[2], region=first.region)


def _movers(support: SupportAsset, kind: Literal["boxes", "parts", "pieces"]) -> dict[int, int]:
    """The joint that moves each box, part or piece, by number; what stands still is not there."""
    return {
        index: number
        for number, joint in enumerate(support.joints)
        for index in getattr(joint, kind)
    }


def _points(points: np.ndarray, T: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def _moved_box(box: Box, moves: np.ndarray, by: int | None) -> Box | None:
    """A box after the move of a joint; None where its sides are not upright any more."""
    if by is None:
        return box
    T = moves[by]
    if T[2, 2] < _UPRIGHT:
        return None
    x, y, z = _points(np.array(box.center), T).tolist()
    return replace(box, center=(x, y, z), yaw=box.yaw + float(np.arctan2(T[1, 0], T[0, 0])))


def _moved_surface(surface: Surface, T: np.ndarray) -> Surface | None:
    """A surface after a move about the vertical; None after any other."""
    if T[2, 2] < _UPRIGHT:
        return None
    if not surface.is_level:
        x, y, z = _points(np.array(surface.position), T).tolist()
        # Turning what slopes would turn its frame.
        return replace(surface, position=(x, y, z)) if abs(T[0, 0]) > _UPRIGHT else None
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))

    def move_ring(ring: Sequence[Sequence[float]]) -> Ring:
        flat = rotate_in_plane(np.array(ring), yaw) + T[:2, 3]
        return tuple((float(x), float(y)) for x, y in flat)

    ((x, y),) = move_ring([surface.region.center])
    region = Rectangle((x, y), surface.region.half_extents, surface.region.yaw + yaw)
    return replace(
        surface,
        position=(0.0, 0.0, surface.position[2] + float(T[2, 3])),
        region=region,
        outline=move_ring(surface.outline),
        holes=tuple(move_ring(hole) for hole in surface.holes),
    )


def _with_free_height(support: SupportAsset, surface: Surface) -> Surface:
    heights = surface_heights(support, surface, _CELL)
    return replace(surface, free_height=free_height(heights, surface.region))


def carriers_of(support: SupportAsset) -> tuple[int, ...]:
    """The joint that moves what is below each of the support's surfaces; -1 for what stands still."""
    if not support.joints:
        return (-1,) * len(support.surfaces)
    by_box = _movers(support, "boxes")
    by_part = _movers(support, "parts")
    solids = [
        *((box.mesh.vertices, by_box.get(k, -1)) for k, box in enumerate(support.boxes)),
        *((part.vertices, by_part.get(k, -1)) for k, part in enumerate(support.parts)),
    ]
    found = []
    for surface in support.surfaces:
        flat = surface.region.spread(_SHARES)
        local = np.column_stack([flat, np.full(len(flat), -_BELOW)])
        points = local @ surface.T_world_surface[:3, :3].T + surface.position
        counts: dict[int, int] = {-1: 0}
        for vertices, by in solids:
            low = vertices.min(0)
            high = vertices.max(0)
            near = points[((points >= low) & (points <= high)).all(1)]
            hull = hull_of(vertices) if len(near) else None
            if hull is not None:
                planes = hull.equations
                is_in = (near @ planes[:, :3].T + planes[:, 3] <= _HAIR).all(1)
                counts[by] = counts.get(by, 0) + int(is_in.sum())
        found.append(max(counts, key=lambda by: counts[by]))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Doors:
    """A support whose doors and drawers are open while objects are placed, and are closed then.

    Attributes:
      open: as objects are placed on it; nothing may be taller than what fits once it is closed.
      closed: as finished scenes have it, the same surfaces in the same order.
      numbers: of the joints that close, drawers first.
    """

    open: SupportAsset
    closed: SupportAsset
    numbers: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints that close."""
        return tuple(self.open.joints[number].name for number in self.numbers)

    @property
    def travel(self) -> np.ndarray:
        """f64[D]: from open to closed, radians or metres."""
        pairs = [(self.open.joints[each], self.closed.joints[each]) for each in self.numbers]
        return np.array([last.value - first.value for first, last in pairs])

    def at(self, travel: np.ndarray) -> SupportAsset:
        """The support with its doors on their way.

        Args:
          travel: f[D], from where they stand open, radians or metres.
        """
        pairs = zip(self.numbers, travel.tolist(), strict=True)
        return with_joints_at(
            self.open, {each: self.open.joints[each].value + by for each, by in pairs}
        )

    @property
    def with_obstacles(self) -> SupportAsset:
        """The open support, and what turns where it is once it is closed: methods keep clear of both."""
        turning = [each for each in self.numbers if self.open.joints[each].kind == "hinge"]
        boxes = [self.closed.boxes[k] for j in turning for k in self.closed.joints[j].boxes]
        parts = [self.closed.parts[k] for j in turning for k in self.closed.joints[j].parts]
        return replace(
            self.open, boxes=(*self.open.boxes, *boxes), parts=(*self.open.parts, *parts)
        )

    @classmethod
    def of(cls, support: SupportAsset) -> Doors | None:
        """What stands open of a support and is to be closed; None where nothing is.

        That is what was opened when it was imported, or else all that has limits.

        Raises:
          ConfigError: it has no joints, it is not known where one is closed, or it tips a surface.
        """
        if not support.joints:
            raise ConfigError(
                f"doors = 'closed' on support {support.name!r}, which has no joints",
                "a support whose file has hinges or slides",
                "leaving doors out",
            )
        known = {k: j.closed for k, j in enumerate(support.joints) if j.closed is not None}
        places = known or {
            number: closed_value(joint, support.name) for number, joint in enumerate(support.joints)
        }
        values = {
            number: place
            for number, place in places.items()
            if abs(place - support.joints[number].value) > _HAIR
        }
        if not values:
            return None
        closed_support = with_joints_at(support, values)
        if len(closed_support.surfaces) < len(support.surfaces):
            kept = {surface.name for surface in closed_support.surfaces}
            lost = [each.name for each in support.surfaces if each.name not in kept]
            raise ConfigError(
                f"surfaces {', '.join(lost)} of support {support.name!r}, which a door tips as it closes",
                f"surfaces that stay level, {', '.join(sorted(kept)) or 'of which there are none'}",
                "doors='open'",
            )
        opened = support
        if support.named:
            pairs = zip(support.named, closed_support.named, strict=True)
            opened = replace(
                support,
                named=tuple(
                    replace(one, free_height=min(one.free_height, other.free_height))
                    for one, other in pairs
                ),
            )
        numbers = sorted(values, key=lambda each: (support.joints[each].kind != "slide", each))
        return cls(opened, closed_support, tuple(numbers))


def are_to_be_closed(support: SupportAsset) -> bool:
    """Whether doors of a support stand open that are closed when objects are placed behind them."""
    return any(
        joint.closed is not None and abs(joint.closed - joint.value) > _HAIR
        for joint in support.joints
    )


def are_closed(support: SupportAsset) -> bool:
    """Whether doors of a support were opened to place objects behind them, and are closed now."""
    known = [joint for joint in support.joints if joint.closed is not None]
    return bool(known) and not are_to_be_closed(support)


def with_doors_open(support: SupportAsset) -> SupportAsset:
    """A support with all doors open that scenes close.

    Raises:
      ConfigError: it has none.
    """
    values = {}
    for number, joint in enumerate(support.joints):
        if joint.closed is not None and (value := opened_value(joint)) is not None:
            values[number] = value
    if not values:
        raise ConfigError(
            f"doors = 'open' of support {support.name!r}, which has none that scenes close",
            "scenes that were made with doors closed",
            "leaving doors out",
        )
    return with_joints_at(support, values)


def closed_value(joint: Joint, name: str = "") -> float:
    """Where a joint is closed: at the zero of its file, or at the limit nearest to it.

    Args:
      name: of its support, for errors.

    Raises:
      ConfigError: its file states no limits, so that nothing says where it is closed.
    """
    if joint.range is None:
        raise ConfigError(
            f"door {joint.name!r} of support {name!r}, whose file states no limits, so that it is not "
            "known where it is closed",
            "doors and drawers with limits",
            "doors='open', or limits in its file",
        )
    return min(max(0.0, joint.range[0]), joint.range[1])


def is_endless(joint: Joint) -> bool:
    """Whether nothing limits a joint."""
    return joint.range is None or max(map(abs, joint.range)) > _ENDLESS


def opened_value(joint: Joint) -> float | None:
    """Where a joint is open: as far as it goes from where it is closed, a hinge by `WIDEST` at most.

    None where its file states no limits, or it hardly moves.
    """
    if is_endless(joint) or joint.range is None:
        return None
    low, high = joint.range
    start = joint.value if joint.closed is None else joint.closed
    end = high if high - start >= start - low else low
    travel = end - start
    if joint.kind == "hinge":
        travel = math.copysign(min(abs(travel), WIDEST), travel)
    least = _LEAST[joint.kind == "slide"]
    return start + travel if abs(travel) >= least else None
