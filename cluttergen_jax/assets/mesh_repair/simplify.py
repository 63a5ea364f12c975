"""Visual surfaces: one piece per colour or image, of few triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets.baking import bake_again
from cluttergen_jax.assets.mesh import Mesh, clean_mesh, join_meshes
from cluttergen_jax.assets.shape import Piece

UV_DIGITS = 6
_NEAR = 16
"""Triangles among which the nearest is looked for."""
_STRETCH = 3.0
"""Times the stretch of the image at a triangle's middle by which it may be stretched up to a corner."""


def transfer_texture(piece: Piece, mesh: Mesh) -> Piece:
    """The textured piece with `mesh` in place of its own, each corner's uv taken from the nearest old place.

    The image is cut along seams, and what lies beyond a seam is elsewhere in the image. So the place of a new
    triangle's middle is found first, and its corners' places are taken only where the image runs on from
    there; elsewhere it is continued as it lies on the old triangle in the middle.
    """
    assert piece.uv is not None
    old = piece.mesh
    uv = piece.uv.astype(np.float64)
    tree = cKDTree(old.vertices[old.faces].mean(1))
    corners = mesh.corners
    middle = corners.mean(1)
    places, away, owner = _candidates(old, uv, tree, middle)
    best = np.argmin(away, axis=1)
    row = np.arange(len(middle))
    start = places[row, best]
    triangle = owner[row, best]
    stretch = _STRETCH * _scale(old, uv)[triangle]
    found = np.empty((len(middle), 3, 2))
    for k in range(3):
        places, away, _ = _candidates(old, uv, tree, corners[:, k])
        step = np.linalg.norm(places - start[:, None], axis=2)
        runs_on = step <= (stretch * np.linalg.norm(corners[:, k] - middle, axis=1))[:, None] + 1e-6
        best = np.argmin(np.where(runs_on, away, np.inf), axis=1)
        continued = _places(old, uv, triangle, corners[:, k])
        found[:, k] = np.where(runs_on.any(1)[:, None], places[row, best], continued)
    keys = np.column_stack([mesh.faces.ravel(), np.round(found.reshape(-1, 2), UV_DIGITS)])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    vertices = mesh.vertices[mesh.faces.ravel()[first]]
    return replace(
        piece,
        mesh=Mesh(vertices, inverse.reshape(-1, 3)),
        uv=found.reshape(-1, 2)[first].astype(np.float32),
    )


def _candidates(
    mesh: Mesh, uv: np.ndarray, tree: cKDTree, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of P points the nearest places on C triangles near it.

    Returns:
      f64[P, C, 2], their uv; f64[P, C], how far they are, metres; i[P, C], the triangles.
    """
    near = tree.query(points, min(_NEAR, len(mesh.faces)))[1].reshape(len(points), -1)
    triangles = mesh.vertices[mesh.faces[near.ravel()]]
    targets = np.repeat(points, near.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(triangles, targets)
    places = _places(mesh, uv, near.ravel(), closest)
    away = np.linalg.norm(closest - targets, axis=1)
    return places.reshape(*near.shape, 2), away.reshape(near.shape), near


def _scale(mesh: Mesh, uv: np.ndarray) -> np.ndarray:
    """f64[F]: the most that the image moves on a triangle, in uv for each metre."""
    corners = mesh.corners
    places = uv[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    steps = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2)
    return (steps / np.maximum(sides, 1e-9)).max(1)


def _places(mesh: Mesh, uv: np.ndarray, triangle: np.ndarray, points: np.ndarray) -> np.ndarray:
    """f64[P, 2]: uv at points in the planes of triangles i[P], beyond their edges as if they went on."""
    faces = mesh.faces[triangle]
    weights = trimesh.triangles.points_to_barycentric(mesh.vertices[faces], points)
    weights = np.where(np.isfinite(weights).all(1)[:, None], weights, 1 / 3)
    return np.asarray((uv[faces] * weights[..., None]).sum(1))


MAX_TRIANGLES = 6000
MAX_TEXTURED = 20000
"""Triangles with images: they cost more to simplify, and what is seen is the image."""
_COLOUR_STEPS = 32


def simplify_pieces(
    pieces: Sequence[Piece], max_triangles: int = MAX_TRIANGLES, max_textured: int = MAX_TEXTURED
) -> tuple[Piece, ...]:
    """Pieces of like colour and image joined, welded and simplified.

    To about `max_triangles` in all without an image, and `max_textured` in all with one. Sheets are given
    their second side later, which can double their number.
    """
    groups: dict[tuple[object, ...], list[Piece]] = {}
    for piece in pieces:
        colour = tuple(round(c * _COLOUR_STEPS) for c in piece.rgba)
        groups.setdefault((piece.texture, *colour), []).append(piece)
    merged = [_merge(group) for group in groups.values()]
    merged = [piece for piece in merged if len(piece.mesh.faces)]
    plain = sum(len(piece.mesh.faces) for piece in merged if piece.texture is None)
    textured = sum(len(piece.mesh.faces) for piece in merged if piece.texture is not None)
    return tuple(
        replace(piece, mesh=_simplify(piece.mesh, min(1.0, max_triangles / plain)))
        if piece.texture is None
        else _simplify_textured(piece, min(1.0, max_textured / textured))
        for piece in merged
    )


def _merge(group: Sequence[Piece]) -> Piece:
    mesh = join_meshes([each.mesh for each in group])
    uvs = [each.uv for each in group if each.uv is not None]
    if not uvs:
        return Piece(clean_mesh(mesh), group[0].rgba)
    return _weld(replace(group[0], mesh=mesh, uv=np.concatenate(uvs)))


def _weld(piece: Piece) -> Piece:
    """Vertices of equal place and equal uv become one; collapsed and doubled triangles are dropped."""
    assert piece.uv is not None
    mesh = piece.mesh
    digits = 6 - int(np.floor(np.log10(max(float(np.ptp(mesh.vertices)), 1e-9))))
    _, place = np.unique(np.round(mesh.vertices, digits), axis=0, return_inverse=True)
    keys = np.column_stack([place.reshape(-1), np.round(piece.uv, UV_DIGITS)])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces]
    corners = place.reshape(-1)[mesh.faces]
    is_sound = (corners != np.roll(corners, 1, axis=1)).all(1)
    faces = faces[is_sound]
    corners = np.sort(corners[is_sound], axis=1)
    faces = (
        faces[np.sort(np.unique(corners, axis=0, return_index=True)[1])] if len(faces) else faces
    )
    used, faces = np.unique(faces, return_inverse=True)
    kept = first[used]
    return replace(piece, mesh=Mesh(mesh.vertices[kept], faces.reshape(-1, 3)), uv=piece.uv[kept])


def _simplify(mesh: Mesh, share: float) -> Mesh:
    target = int(share * len(mesh.faces))
    if share >= 1 or target < 12:
        return mesh
    points, faces = fast_simplification.simplify(
        np.ascontiguousarray(mesh.vertices, np.float32),
        np.ascontiguousarray(mesh.faces, np.int32),
        target_count=target,
    )
    small = clean_mesh(Mesh(points, faces))
    return small if len(small.faces) else mesh


def _simplify_textured(piece: Piece, share: float) -> Piece:
    """Simplified without regard to the image, which is then laid over the new triangles again."""
    if share >= 1:
        return piece
    whole = clean_mesh(piece.mesh)
    small = _simplify(whole, share * len(piece.mesh.faces) / len(whole.faces))
    if small is whole:
        return piece
    return bake_again(piece, small) if piece.baked_side else transfer_texture(piece, small)
