"""What of a piece of furniture collides: its boards and legs as boxes and convex parts.

What is convex by itself is taken as it is, most of what furniture is made of. Of the rest, what has only
faces at right angles is made of boxes, exactly, and CoACD cuts what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from manifold3d import Manifold
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.decompose import decompose
from cluttergen_jax.assets.mesh import Mesh, clean_mesh, join_meshes
from cluttergen_jax.assets.parts import hull_of, reduce_vertices, sound_points
from cluttergen_jax.assets.solid import Solid, solid_of
from cluttergen_jax.assets.support import Box, Surface
from cluttergen_jax.assets.support_map import cells_below
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.progress import Progress

_SMALL = 0.03
_MINOR = 0.25
_MOST_VERTICES = 64
_MOST_PLANES = 48
_FILLS = 0.97
_SHEET = 0.001
_SPACE = 0.5
_HAIR = 0.002
_BOX = 0.985
"""The share of its box that a board with broken edges fills at least."""


def collision_of(
    meshes: Sequence[Mesh], yaw: float, surfaces: Sequence[Surface]
) -> tuple[list[Box], list[np.ndarray], list[str]]:
    """Boxes and convex parts, f64[V, 3] each, in place of surfaces; what is below 3 cm is left out.

    Args:
      meshes: world frame, metres.
      yaw: radians, the direction of the furniture's sides.
      surfaces: what is small and not within 50 cm above one of them, such as a caster, becomes its hull.

    Returns:
      Boxes, parts, and in words what could not be made to collide.
    """
    hulls: list[np.ndarray] = []
    rest: list[Mesh] = []
    notes: list[str] = []
    for mesh in chain.from_iterable(_components(clean_mesh(each)) for each in meshes):
        hull = _hull_if_convex(mesh)
        if hull is None:
            rest.append(mesh)
        else:
            hulls.append(hull)
    pieces = _components(clean_mesh(join_meshes(rest))) if rest else []
    pieces = [mesh for mesh in pieces if _size(mesh.vertices) >= _SMALL]
    with Progress("cutting into convex parts", len(pieces), "piece") as progress:
        for mesh in pieces:
            hull = _hull_if_convex(mesh)
            if hull is not None:
                hulls.append(hull)
            elif _size(mesh.vertices) < _MINOR and not any(
                _is_above(mesh.vertices, s) for s in surfaces
            ):
                hulls.append(sound_points(mesh.vertices))
            elif not any(is_inside(mesh.vertices, each) for each in hulls):
                try:
                    hulls += _cut(solid_of([mesh]), yaw)
                except AssetError as error:
                    notes.append(
                        f"a piece at {mesh.bounds.mean(0).round(2)} does not collide: {error.given}"
                    )
            progress.update()
    boxes = []
    parts = []
    for points in _without_inner([each for each in hulls if _size(each) >= _SMALL]):
        box = as_box(points, yaw)
        if box is None:
            parts.append(reduce_vertices(points, count=_MOST_VERTICES))
        else:
            boxes.append(box)
    return boxes, parts, notes


def cut_off(points: np.ndarray, T_world_surface: np.ndarray, height: float) -> np.ndarray | None:
    """What of a convex part, f64[V, 3], is below a height in a surface's frame; None if nothing is."""
    normal = T_world_surface[:3, 2]
    below = Manifold.hull_points(points).trim_by_plane(
        -normal, -(normal @ T_world_surface[:3, 3] + height)
    )
    vertices = np.array(below.to_mesh64().vert_properties)[:, :3]
    hull = hull_of(vertices) if len(vertices) > 3 else None
    return None if hull is None else vertices[hull.vertices]


def _components(mesh: Mesh) -> list[Mesh]:
    """Its pieces that share no vertex."""
    if not len(mesh.faces):
        return []
    edges = np.concatenate([mesh.faces[:, :2], mesh.faces[:, 1:]])
    shape = (len(mesh.vertices),) * 2
    _, label = connected_components(
        coo_array((np.ones(len(edges)), edges.T), shape=shape), directed=False
    )
    own = label[mesh.faces[:, 0]]
    found = []
    for each in np.unique(own):
        used, faces = np.unique(mesh.faces[own == each], return_inverse=True)
        found.append(Mesh(mesh.vertices[used], faces.reshape(-1, 3)))
    return found


def _hull_if_convex(mesh: Mesh) -> np.ndarray | None:
    """f64[V, 3]: the corners of a surface that is its own convex hull, or a flat sheet that is convex."""
    area = np.linalg.norm(mesh.normals, axis=1) / 2
    points = sound_points(mesh.vertices)
    hull = hull_of(points)
    if hull is None:
        return None
    is_sheet = hull.volume < _SHEET * hull.area / 2
    if hull.area > (2.0 if is_sheet else 1.0) * area.sum() / _FILLS:
        return None
    centers = mesh.corners.mean(1)
    away = -(centers @ hull.equations[:, :3].T + hull.equations[:, 3]).max(1)
    return points if (area * (away < _HAIR)).sum() > _FILLS * area.sum() else None


def _cut(solid: Solid, yaw: float) -> list[np.ndarray]:
    aligned = solid.mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    boxes = _rectangular(aligned) if solid.is_exact else None
    if boxes is not None:
        return [points @ yaw_matrix(-yaw) for points in boxes]
    return decompose(solid, DecompositionConfig())


def _rectangular(mesh: Mesh) -> list[np.ndarray] | None:
    """A closed mesh whose faces are all at right angles as boxes, f64[8, 3] each; None if it is none such."""
    normals = mesh.normals
    straight = np.abs(normals).max(1) > 0.9999 * np.linalg.norm(normals, axis=1)
    planes = [np.unique(np.round(mesh.vertices[:, axis], 4)) for axis in range(3)]
    if not straight.all() or max(map(len, planes)) > _MOST_PLANES:
        return None
    # Planes are a cell apart: lines through the cells' middles meet no edge.
    index = np.stack(
        [np.abs(mesh.vertices[:, k, None] - planes[k]).argmin(1) for k in range(3)], axis=1
    )
    shape = np.array([len(each) - 1 for each in planes])
    if shape.min() < 1:
        return None
    grid = Mesh(index.astype(np.float64), mesh.faces)
    turn = np.zeros((*shape[:2], shape[2] + 1), int)
    up = np.sign(grid.normals[:, 2]).astype(int)
    # Beside the cells' middles, so that no line meets the diagonal of a face.
    lower = np.array([-0.1283, -0.2917])
    for face, window, over, is_hit in cells_below(grid, lower, lower + shape[:2], shape[:2]):
        x, y = np.nonzero(is_hit)
        place = x + window[0].start, y + window[1].start, np.round(over[x, y]).astype(int)
        np.add.at(turn, place, up[face])
    is_solid = np.cumsum(turn, axis=2)[:, :, :-1] < 0
    return [
        np.array(
            [
                (x, y, z)
                for x in planes[0][[a, b]]
                for y in planes[1][[c, d]]
                for z in planes[2][[e, f]]
            ]
        )
        for a, b, c, d, e, f in _blocks(is_solid)
    ]


def _blocks(solid: np.ndarray) -> list[tuple[int, int, int, int, int, int]]:
    """Disjoint blocks of cells that fill the True cells of a bool[X, Y, Z], each grown along z, x, then y."""
    rest = solid.copy()
    found = []
    while rest.any():
        x, y, z = np.argwhere(rest)[0]
        ends = [x + 1, y + 1, z + 1]
        for axis in (2, 0, 1):
            while ends[axis] < rest.shape[axis]:
                more = [slice(x, ends[0]), slice(y, ends[1]), slice(z, ends[2])]
                more[axis] = slice(ends[axis], ends[axis] + 1)
                if not rest[tuple(more)].all():
                    break
                ends[axis] += 1
        rest[x : ends[0], y : ends[1], z : ends[2]] = False
        found.append((int(x), ends[0], int(y), ends[1], int(z), ends[2]))
    return found


def as_box(points: np.ndarray, yaw: float) -> Box | None:
    """The box that the hull of points is, its sides along the furniture's; None if it is none."""
    local = points @ yaw_matrix(yaw)
    low = local.min(0)
    high = local.max(0)
    hull = hull_of(points)
    if hull is None or hull.volume < _BOX * (high - low).prod():
        return None
    center = (yaw_matrix(yaw) @ ((low + high) / 2)).tolist()
    half = ((high - low) / 2).tolist()
    return Box((center[0], center[1], center[2]), (half[0], half[1], half[2]), yaw)


def _is_above(points: np.ndarray, surface: Surface) -> bool:
    """Whether the box around points reaches into the space above a surface."""
    local = (points - surface.position) @ surface.T_world_surface[:3, :3]
    low = np.append(surface.polygon.min(0), _HAIR)
    high = np.append(surface.polygon.max(0), _SPACE)
    return bool((local.max(0) > low).all() and (local.min(0) < high).all())


def _size(points: np.ndarray) -> float:
    """Metres across the box around points."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def is_inside(points: np.ndarray, other: np.ndarray) -> bool:
    """Whether all points are inside the hull of others, to 2 mm."""
    if (points.min(0) < other.min(0) - _HAIR).any() or (points.max(0) > other.max(0) + _HAIR).any():
        return False
    hull = hull_of(other)
    return hull is not None and bool(
        (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max() < _HAIR
    )


def _without_inner(hulls: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The convex parts that are not inside of another, the largest first."""
    kept: list[np.ndarray] = []
    for points in sorted(hulls, key=lambda each: -float(np.ptp(each, axis=0).prod())):
        if not any(is_inside(points, each) for each in kept):
            kept.append(points)
    return kept
