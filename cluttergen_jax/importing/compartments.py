"""Compartments behind doors and in drawers: furniture is opened where that shows more surfaces.

Hinges are opened by up to 100 degrees and slides to their limits, away from where their file has them, which
is where they are closed. One that shows no surface stays closed, and so does what hits the furniture itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import SURFACE_AIR
from cluttergen_jax.assets.door_sweep import check_empty
from cluttergen_jax.assets.doors import (
    Doors,
    is_endless,
    moves_of,
    opened_value,
    with_joints_at,
)
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.assets.support import SupportAsset, Surface
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.importing.furniture import find_surfaces

_MOST_JOINTS = 12
"""Of furniture with more, all that open are opened, without a look at each."""
_SAMPLES = 2048
_SAME_HEIGHT = 0.01
_UPRIGHT = math.cos(math.radians(1))


def with_joints_moved(shape: Shape, values: Mapping[int, float]) -> Shape:
    """A shape with some joints elsewhere, each of which is closed where it was.

    Args:
      values: radians or metres, by the joint's number.
    """
    travel = np.zeros(len(shape.joints))
    for number, value in values.items():
        travel[number] = value - shape.joints[number].value
    moves = moves_of(shape.joints, travel)
    pieces = list(shape.pieces)
    joints = []
    for number, joint in enumerate(shape.joints):
        T = moves[number]
        for index in joint.pieces:
            pieces[index] = pieces[index].transform(T[:3, :3], T[:3, 3])
        moved = replace(
            joint.transform(T[:3, :3], 1.0, T[:3, 3]), value=joint.value + float(travel[number])
        )
        joints.append(replace(moved, closed=joint.value) if number in values else moved)
    return replace(shape, pieces=tuple(pieces), joints=tuple(joints))


def _surfaces_by_mover(shape: Shape, closed: Shape) -> list[tuple[int, Surface, np.ndarray]]:
    """Of each surface the joint that carries it, -1 for none, and its middle where everything is closed.

    What a door tips as it closes is left out.
    """
    mesh = join_meshes([piece.mesh for piece in shape.pieces])
    found, _ = find_surfaces(mesh, 0.0)
    moved = [joint.pieces for joint in shape.joints]
    still = sorted(set(range(len(shape.pieces))).difference(*moved))
    trees = []
    for group in (still, *moved):
        own = join_meshes([shape.pieces[number].mesh for number in group]) if group else None
        trees.append(None if own is None else cKDTree(sample_surface(own, _SAMPLES, 0)))
    travel = np.array(
        [last.value - first.value for first, last in zip(shape.joints, closed.joints, strict=True)]
    )
    back = moves_of(shape.joints, travel)
    kept = []
    for each in found:
        surface = each.surface
        flat = surface.region.spread(np.array([(0, 0), (-0.7, -0.7), (0.7, 0.7), (-0.7, 0.7)]))
        points = np.column_stack([flat, np.zeros(len(flat))])
        points = points @ surface.T_world_surface[:3, :3].T + surface.position
        far = [np.inf if tree is None else float(tree.query(points)[0].mean()) for tree in trees]
        mover = int(np.argmin(far)) - 1
        T = np.eye(4) if mover < 0 else back[mover]
        if T[2, 2] > _UPRIGHT:
            kept.append((mover, surface, T[:3, :3] @ points[0] + T[:3, 3]))
    return kept


def open_compartments(shape: Shape) -> tuple[Shape, list[str]]:
    """Furniture with those doors and drawers open that hide surfaces, and in words which.

    Args:
      shape: as its file has it, in metres, z up.
    """
    values = {
        number: value
        for number, joint in enumerate(shape.joints)
        if (value := opened_value(joint)) is not None
    }
    endless = [repr(joint.name) for joint in shape.joints if is_endless(joint)]
    notes = []
    if endless:
        notes = [f"not opened, as its file states no limits: {', '.join(endless)}"]
    if not values:
        return shape, notes
    before = [center for _, _, center in _surfaces_by_mover(shape, shape)]

    def hidden(opened: Mapping[int, float]) -> int:
        """How many surfaces are only there where these joints are open."""
        number = 0
        for _, surface, center in _surfaces_by_mover(with_joints_moved(shape, opened), shape):
            half = max(surface.region.half_extents)
            away = [np.abs(center - each) for each in before]
            number += not any(
                each[2] < _SAME_HEIGHT and np.hypot(each[0], each[1]) < half for each in away
            )
        return number

    most = hidden(values)
    if not most:
        return shape, notes
    if 1 < len(values) <= _MOST_JOINTS:
        for number in list(values):
            fewer = {each: value for each, value in values.items() if each != number}
            if fewer and hidden(fewer) >= most:
                values = fewer
    names = [repr(shape.joints[number].name) for number in values]
    return with_joints_moved(shape, values), [
        *notes,
        f"opened to look behind them: {', '.join(names)}; scenes close them when all objects are placed "
        "(--doors open leaves them open, --joint NAME=VALUE puts one elsewhere)",
    ]


def with_room_when_closed(support: SupportAsset) -> tuple[SupportAsset, list[str]]:
    """A support without the surfaces that doors tip as they close, or over which they leave no air.

    Such are the inside of an oven's door, and the board on which a drawer runs.

    Returns:
      It, and in words what is left out.
    """
    values = {
        number: joint.closed
        for number, joint in enumerate(support.joints)
        if joint.closed is not None
    }
    free = {each.name: each.free_height for each in with_joints_at(support, values).surfaces}
    kept = [each for each in support.named if free.get(each.name, 0.0) >= SURFACE_AIR]
    notes = [
        f"no surface at {each.position[2]:.2f} m: once doors and drawers are closed, "
        + (f"{free[each.name]:.2f} m of air are left" if each.name in free else "it is tipped")
        for each in support.named
        if each not in kept
    ]
    if not kept or not notes:
        return support, []
    names = ["top", *(f"shelf_{number}" for number in range(1, len(kept)))]
    named = tuple(replace(each, name=name) for each, name in zip(kept, names, strict=True))
    first = named[0]
    return replace(support, named=named, top=first.position[2], region=first.region), notes


def why_not_closed(support: SupportAsset) -> str:
    """Why the doors of a support cannot be closed, in words; "" where they can."""
    try:
        doors = Doors.of(support)
        if doors is not None:
            check_empty(doors)
    except ConfigError as error:
        return str(error.given)
    return ""
