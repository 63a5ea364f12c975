"""Surfaces that lie flat over themselves: found, and where the flat place has one outline cut anew.

A polygon of concave outline that was cut into a fan arrives so: closed, with the right volume and area by
sign, and yet with triangles that lie over each other. CoACD crashes over it, or never ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import manifold3d
import numpy as np

from cluttergen_jax.assets.mesh import UV_DIGITS, Mesh, component_labels, shared_edges, unique_rows
from cluttergen_jax.geometry import plane_axes, triangle_areas, unit

_FLAT = 1e-4
_FLAP = 1e-3
_STRAIGHT = 5e-6
"""Shares of the diagonal: so far from the plane of its neighbour is a triangle that lies in it, and so wide
is one that counts; and 1 - |cosine| between such neighbours."""
_PASSES = 4
_RINGS = 8


@dataclass(frozen=True, eq=False)
class _Neighbours:
    """Pairs of triangles that share an edge and lie in one plane."""

    pairs: np.ndarray  # i64[N, 2], triangles.
    is_fold: np.ndarray  # bool[N], where one lies over the other; else beside it.


def without_folds(mesh: Mesh, uv: np.ndarray | None = None) -> Mesh:
    """The mesh without such folds, where they can be cut anew, each within the outline around it.

    The vertices stay, and with them what belongs to each. What cannot be cut without losing a vertex or
    laying triangles over each other stays as it is, such as what has no area.

    Args:
      mesh: vertices need not be welded.
      uv: f64[V, 2], texture coordinates; nothing is cut across a seam in them.
    """
    for _ in range(_PASSES):
        mended = _without_folds_once(mesh, uv)
        if mended is mesh:
            break
        mesh = mended
    return mesh


def _without_folds_once(mesh: Mesh, uv: np.ndarray | None) -> Mesh:
    if not len(mesh.faces):
        return mesh
    welded, label = _weld(mesh, uv)
    kept = np.flatnonzero((welded.faces != np.roll(welded.faces, 1, axis=1)).all(1))
    welded = Mesh(welded.vertices, welded.faces[kept])
    near = _neighbours(welded)
    stays = np.ones(len(mesh.faces), bool)
    faces = []
    for place in _places(near, len(kept)):
        cut = _cut_anew(welded, place) if stays[kept[place]].all() else None
        if cut is not None:
            faces.append(_original_vertices(cut, label, mesh.faces[kept[place]]))
            stays[kept[place]] = False
    return Mesh(mesh.vertices, np.concatenate([mesh.faces[stays], *faces])) if faces else mesh


def _places(near: _Neighbours, number: int) -> Iterator[np.ndarray]:
    """Sets of triangles to be cut together: flat places with a fold, then each fold and ever more around it.

    Args:
      number: of triangles.
    """
    if not near.is_fold.any():
        return
    whole = component_labels(near.pairs, number)
    folded = component_labels(near.pairs[near.is_fold], number)
    for each in np.unique(whole[near.pairs[near.is_fold, 0]]):
        yield np.flatnonzero(whole == each)
    for each in np.unique(folded[near.pairs[near.is_fold, 0]]):
        is_inside = folded == each
        for _ in range(_RINGS):
            yield np.flatnonzero(is_inside)
            is_met = is_inside[near.pairs].any(1)
            around = near.pairs[is_met].reshape(-1)
            if is_inside[around].all():
                break
            is_inside[around] = True


def _weld(mesh: Mesh, uv: np.ndarray | None) -> tuple[Mesh, np.ndarray]:
    """The mesh with vertices of equal place and texture coordinates as one, and i64[V], which one."""
    places = np.round(mesh.vertices, mesh.decimals)
    first, label = unique_rows(places, *([] if uv is None else [np.round(uv, UV_DIGITS)]))
    return Mesh(mesh.vertices[first], label[mesh.faces]), label


def _neighbours(mesh: Mesh) -> _Neighbours:
    """Of each edge that two triangles share; triangles without area have no neighbours."""
    faces = mesh.faces.astype(np.int64)
    start, end, tip = (np.roll(faces, -turn, axis=1).reshape(-1) for turn in range(3))
    one, two = shared_edges(faces)[0].T
    # A sheet drawn from both sides is a triangle and its reverse, and no fold; nor are two that turn unlike.
    is_pair = (start[one] == end[two]) & (tip[one] != tip[two])
    one = one[is_pair]
    two = two[is_pair]
    diagonal = mesh.diagonal
    normals = mesh.directions
    base = mesh.vertices[start[one]]
    along = unit(mesh.vertices[end[one]] - base)
    arms = [mesh.vertices[tip[side]] - base for side in (one, two)]
    arms = [arm - (arm * along).sum(1, keepdims=True) * along for arm in arms]
    a = normals[one // 3]
    b = normals[two // 3]
    off = np.maximum(np.abs((arms[1] * a).sum(1)), np.abs((arms[0] * b).sum(1)))
    is_flat = (off < _FLAT * diagonal) & (np.abs((a * b).sum(1)) > 1 - _STRAIGHT)
    width = np.minimum(*(np.linalg.norm(arm, axis=1) for arm in arms))
    is_fold = is_flat & ((arms[0] * arms[1]).sum(1) > 0) & (width > _FLAP * diagonal)
    return _Neighbours(np.stack([one, two], 1)[is_flat] // 3, is_fold[is_flat])


def _cut_anew(mesh: Mesh, place: np.ndarray) -> np.ndarray | None:
    """i64[F, 3]: the triangles within the outline of a flat place; None if they would overlap."""
    faces = mesh.faces[place].astype(np.int64)
    normal = mesh.normals[place].sum(0)
    area = float(np.linalg.norm(normal))
    whole = float(mesh.areas[place].sum())
    loops = _loops(faces)
    if area < 1e-6 * whole or not loops or len(np.setdiff1d(faces, np.concatenate(loops))):
        return None
    corners = np.concatenate(loops)
    flat = (mesh.vertices[corners] - mesh.vertices[corners[0]]) @ plane_axes(normal)
    ends = np.cumsum([len(loop) for loop in loops])[:-1]
    try:
        cut = np.asarray(manifold3d.triangulate(np.split(flat, ends)), np.int64).reshape(-1, 3)
    except (RuntimeError, ValueError):
        return None
    areas = triangle_areas(flat[cut])
    is_sound = bool((areas > -1e-9 * area).all()) and np.isclose(areas.sum(), area, rtol=1e-4)
    return corners[cut] if is_sound else None


def _loops(faces: np.ndarray) -> list[np.ndarray]:
    """The outlines of some triangles: vertices in the triangles' own order."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    size = int(faces.max()) + 1
    there = edges[:, 0] * size + edges[:, 1]
    back = edges[:, 1] * size + edges[:, 0]
    onward: dict[int, list[int]] = {}
    for start, end in edges[~np.isin(there, back)].tolist():
        onward.setdefault(start, []).append(end)
    loops = []
    while onward:
        first = vertex = next(iter(onward))
        loop = []
        while True:
            loop.append(vertex)
            ends = onward.get(vertex)
            if not ends:
                return []
            following = ends.pop()
            if not ends:
                del onward[vertex]
            vertex = following
            if vertex == first:
                break
        loops.append(np.array(loop))
    return loops


def _original_vertices(cut: np.ndarray, label: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Triangles of welded vertices as triangles of those that the place had before."""
    used = before.reshape(-1)
    names, first = np.unique(label[used], return_index=True)
    return used[first][np.searchsorted(names, cut)]
