"""What of a piece of furniture collides, with which of its joints it moves, and the air that it leaves.

What is convex by itself is taken as it is, most of what furniture is made of. Of the rest, what has only
faces at right angles is made of boxes, exactly, and CoACD cuts what is left.

Convex parts of a drawer or a compartment with thin walls fill it. What of them is where the mesh has nothing,
in upright boxes over rectangles of the surface, is cut away, which leaves convex parts around each box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np
from manifold3d import Manifold
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import SURFACE_AIR, DecompositionConfig
from cluttergen_jax.assets.decompose import decompose
from cluttergen_jax.assets.mesh import Mesh, clean_mesh, component_labels, join_meshes
from cluttergen_jax.assets.parts import heights_over, hull_of, reduce_vertices, sound_points
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.solid import Solid, Voxels, solid_of
from cluttergen_jax.assets.support import Box, SupportAsset, Surface
from cluttergen_jax.assets.support_map import cells_below, cover, surface_heights
from cluttergen_jax.errors import AssetError
from cluttergen_jax.geometry import box_corners, rotate_in_plane, yaw_matrix
from cluttergen_jax.importing.surfaces import FoundSurface
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
    own = component_labels(edges, len(mesh.vertices))[mesh.faces[:, 0]]
    found = []
    for each in np.unique(own):
        used, faces = np.unique(mesh.faces[own == each], return_inverse=True)
        found.append(Mesh(mesh.vertices[used], faces.reshape(-1, 3)))
    return found


def _hull_if_convex(mesh: Mesh) -> np.ndarray | None:
    """f64[V, 3]: the corners of a surface that is its own convex hull, or a flat sheet that is convex."""
    area = mesh.areas / 2
    points = sound_points(mesh.vertices)
    hull = hull_of(points)
    if hull is None:
        return None
    is_sheet = hull.volume < _SHEET * hull.area / 2
    if hull.area > (2.0 if is_sheet else 1.0) * area.sum() / _FILLS:
        return None
    centers = mesh.corners.mean(1)
    away = -heights_over(centers, hull).max(1)
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
    straight = np.abs(normals).max(1) > 0.9999 * mesh.areas
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
    boxes = []
    for a, b, c, d, e, f in _blocks(is_solid):
        sides = (planes[0][[a, b]], planes[1][[c, d]], planes[2][[e, f]])
        boxes.append(np.array(list(product(*sides))))
    return boxes


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
    local = surface.local(points)
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
    return hull is not None and bool(heights_over(points, hull).max() < _HAIR)


def _without_inner(hulls: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The convex parts that are not inside of another, the largest first."""
    kept: list[np.ndarray] = []
    for points in sorted(hulls, key=lambda each: -float(np.ptp(each, axis=0).prod())):
        if not any(is_inside(points, each) for each in kept):
            kept.append(points)
    return kept


_SAMPLES = 4096
"""Points on all surfaces of a link."""
_NO_LIMIT = 100.0
"""Radians or metres: files state such limits where they mean none."""


def moved_together(joints: Sequence[Joint], meshes: Sequence[Mesh]) -> list[list[Mesh]]:
    """Surfaces in groups: those that stand still first, then those of each joint; no group is empty."""
    moved = [set(joint.pieces) for joint in joints]
    still = set(range(len(meshes))).difference(*moved)
    groups = [[meshes[number] for number in sorted(group)] for group in (still, *moved)]
    return [group for group in groups if group]


def with_joints(support: SupportAsset, joints: Sequence[Joint]) -> SupportAsset:
    """A support with joints, each with what of the collision it moves: what lies nearest to its surfaces.

    Args:
      joints: world frame; they know the surfaces that they move.
    """
    moved = [joint.pieces for joint in joints]
    still = sorted(set(range(len(support.pieces))).difference(*moved))
    trees = []
    for group in (still, *moved):
        mesh = join_meshes([support.pieces[number].mesh for number in group]) if group else None
        trees.append(None if mesh is None else cKDTree(sample_surface(mesh, _SAMPLES, 0)))

    def nearest(points: np.ndarray) -> int:
        """The joint that moves f64[V, 3]; -1 for none."""
        far = [np.inf if tree is None else float(tree.query(points)[0].mean()) for tree in trees]
        return int(np.argmin(far)) - 1

    boxes = [nearest(box.mesh.vertices) for box in support.boxes]
    parts = [nearest(part.vertices) for part in support.parts]
    made = [
        replace(
            joint,
            range=_limits_of(joint),
            boxes=tuple(place for place, by in enumerate(boxes) if by == number),
            parts=tuple(place for place, by in enumerate(parts) if by == number),
        )
        for number, joint in enumerate(joints)
    ]
    return replace(support, joints=tuple(made))


def estimates_of(joints: Sequence[Joint]) -> list[str]:
    """What files do not state of joints that move in exports, in words."""
    missing: dict[tuple[str, ...], list[str]] = {}
    for what in ("mass", "damping", "friction", "armature"):
        names = tuple(joint.name for joint in joints if getattr(joint, what) is None)
        missing.setdefault(names, []).append(what)
    said = []
    for names, unstated in missing.items():
        if names:
            said.append(f"{', '.join(unstated)} of {', '.join(map(repr, names))}")
    if not said:
        return []
    return [f"its file states none, so exports as mjcf-joints estimate: {'; '.join(said)}"]


def _limits_of(joint: Joint) -> tuple[float, float] | None:
    """Its limits with where it stands, which files may put beyond them; None where they limit nothing."""
    if joint.range is None or max(map(abs, joint.range)) > _NO_LIMIT:
        return None
    return min(joint.range[0], joint.value), max(joint.range[1], joint.value)


_START = 0.005
"""Metres over a surface from which on something hangs over it."""
# Of a region: metres from its edges, and the share of it, that do not count.
_INSET = 0.01
_SHARE = 0.02

# Metres, and the share of what is seen, by which parts may leave less.
_LESS = 0.02
_LESS_SHARE = 0.1

_CELL = 0.005
_VOXELS = 140
_INSETS = (0.0, 0.005, 0.01, 0.02)
"""Metres."""
_MOST_COLUMNS = 8
_MISSING = 0.05
_MOST_PARTS = 400
# Metres and cubic metres: thinner and smaller pieces of a part are dropped.
_THIN = 0.001
_GRAIN = 1e-7


@dataclass(frozen=True)
class Air:
    """Metres of free air over a surface: as seen, and as the collision leaves it; inf under the open sky."""

    seen: float
    collided: float

    @property
    def is_short(self) -> bool:
        """Whether the collision fills what is seen free."""
        return self.collided < self.seen - max(_LESS, _LESS_SHARE * min(self.seen, 1.0))


def air_over(mesh: Mesh, support: SupportAsset, surface: Surface) -> Air:
    """The air over the region of a surface, its edges aside; of the lowest places 2 % do not count.

    Args:
      mesh: what is seen of the furniture, world frame; support: with its collision.
    """
    half = np.maximum(np.array(surface.region.half_extents) - _INSET, 1e-3)
    inverse = np.linalg.inv(surface.T_world_surface)
    local = mesh.transform(inverse[:3, :3], inverse[:3, 3])
    turn = np.eye(4)
    turn[:2, :2] = rotate_in_plane(np.eye(2), -surface.region.yaw).T
    aligned = Mesh(local.vertices @ turn[:3, :3].T, local.faces)
    center = rotate_in_plane(np.array(surface.region.center), -surface.region.yaw)
    shape = np.maximum(np.ceil(2 * half / _CELL), 1).astype(int)
    over = np.full(shape, np.inf)
    for _, window, height, is_hit in cells_below(aligned, center - half, center + half, shape):
        hangs = is_hit & (height > _START)
        over[window] = np.where(hangs, np.minimum(over[window], height), over[window])
    heights = surface_heights(support, surface, _CELL)
    xy = rotate_in_plane(heights.centers - surface.region.center, -surface.region.yaw)
    is_in = (np.abs(xy) <= half).all(-1)
    left = np.where(heights.ground > _START, 0.0, heights.ceiling)[is_in]
    return Air(_low(over.ravel()), _low(left))


def _low(heights: np.ndarray) -> float:
    return float(np.sort(heights)[int(_SHARE * len(heights))]) if len(heights) else math.inf


def note_of_air(surface: Surface, before: Air, after: Air) -> str:
    """What is to be said of a surface over which the collision fills, or filled, what is seen free."""
    where = f"the surface at {surface.position[2]:.2f} m"
    if after.collided < SURFACE_AIR:
        return (
            f"no surface at {surface.position[2]:.2f} m: {_metres(after.seen)} of air are seen over it, "
            + (f"and its parts leave {_metres(after.collided)}")
        )
    if after.is_short:
        return f"{where}: {_metres(after.seen)} of air are seen over it, and its parts leave " + (
            _metres(after.collided)
        )
    if before.is_short:
        return (
            f"{where}: {_metres(before.seen)} of air are seen over it, and convex parts left "
            f"{_metres(before.collided)}: they were cut, and leave {_metres(after.collided)}"
        )
    return ""


def _metres(height: float) -> str:
    return "all" if math.isinf(height) else f"{height:.2f} m"


@dataclass(frozen=True, eq=False)
class AirBox:
    """A box of air over a surface.

    Attributes:
      T_world_surface: f64[4, 4]; corners: f64[4, 2], in the surface's frame, counter-clockwise, metres.
      height: metres.
    """

    T_world_surface: np.ndarray
    corners: np.ndarray
    height: float

    @property
    def planes(self) -> list[tuple[np.ndarray, float]]:
        """Normals f64[3] that point out of the box, world frame, and offsets: the board below first."""
        following = np.roll(self.corners, -1, axis=0)
        sides = []
        for (x0, y0), (x1, y1) in zip(self.corners, following, strict=True):
            normal = np.array([y1 - y0, x0 - x1, 0.0]) / math.hypot(x1 - x0, y1 - y0)
            sides.append((normal, np.array([x0, y0, 0.0])))
        up = np.array([0.0, 0.0, 1.0])
        local = [(-up, np.zeros(3)), *sides, (up, self.height * up)]
        R = self.T_world_surface[:3, :3]
        shift = self.T_world_surface[:3, 3]
        return [(R @ normal, float(R @ normal @ (R @ point + shift))) for normal, point in local]


def columns_over(samples: np.ndarray, found: FoundSurface, surface: Surface) -> list[AirBox]:
    """Boxes of air in which nothing of a mesh is, over the largest rectangles of a surface.

    Over what leans over an edge, boxes farther inside are higher.

    Args:
      samples: f64[N, 3], points of the mesh, at most half a centimetre or so apart (`surface_samples`).
    """
    local = surface.local(samples)
    local = local[local[:, 2] > 2 * _START]
    top = float(local[:, 2].max(initial=0.0)) + 2 * _START
    low = surface.polygon.min(0)
    high = surface.polygon.max(0)
    local = local[((local[:, :2] > low) & (local[:, :2] < high)).all(1)]
    yaw = surface.region.yaw
    flat = rotate_in_plane(local[:, :2], -yaw)
    columns = []
    for span in cover(found.mask, _MISSING, _MOST_COLUMNS):
        ends = rotate_in_plane(found.corners(span), -yaw)
        highest = _LESS
        for inset in _INSETS:
            low = ends.min(0) + inset
            high = ends.max(0) - inset
            if (high - low).min() < _LESS:
                break
            is_over = ((flat > low + _START / 2) & (flat < high - _START / 2)).all(1)
            height = float(local[is_over, 2].min(initial=top)) - _START
            if height > highest:
                corners = box_corners(low, high)
                columns.append(
                    AirBox(surface.T_world_surface, rotate_in_plane(corners, yaw), height)
                )
                highest = height + _START
    return columns


def surface_samples(mesh: Mesh) -> np.ndarray:
    """f64[N, 3]: points of a surface, every point of it near one."""
    return Voxels.of(mesh, _VOXELS).samples


def without_air(parts: list[np.ndarray], columns: list[AirBox]) -> list[np.ndarray]:
    """Convex parts, f64[V, 3] each, with what is inside of the columns cut away."""
    for column in columns:
        cut = [piece for points in parts for piece in _around(points, column)]
        if len(cut) > _MOST_PARTS:
            break
        parts = cut
    return parts


def _around(points: np.ndarray, column: AirBox) -> list[np.ndarray]:
    """A part itself if it is not in the box, or the convex pieces of it that are around it."""
    local = (points - column.T_world_surface[:3, 3]) @ column.T_world_surface[:3, :3]
    low = column.corners.min(0)
    high = column.corners.max(0)
    is_beside = (local[:, :2].max(0) <= low).any() or (local[:, :2].min(0) >= high).any()
    if is_beside or local[:, 2].max() <= _THIN or local[:, 2].min() >= column.height:
        return [points]
    rest = Manifold.hull_points(points)
    around = []
    for normal, offset in column.planes:
        outside, rest = rest.split_by_plane(normal, offset)
        around.append(outside)
    if rest.is_empty() or not _is_thick(_corners(rest)):
        return [points]
    corners = [_corners(each) for each in around if not each.is_empty()]
    return [each for each in corners if _is_thick(each)]


def _corners(solid: Manifold) -> np.ndarray:
    return np.array(solid.to_mesh64().vert_properties)[:, :3]


def _is_thick(points: np.ndarray) -> bool:
    hull = hull_of(points) if len(points) > 3 else None
    return hull is not None and hull.volume > max(_GRAIN, _THIN * hull.area / 2)
