"""Visual surfaces: one piece per colour or image, few triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import fast_simplification
import numpy as np

from cluttergen_jax.assets.mesh import Mesh, cleaned, joined
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.unwrapped import UV_DIGITS, transferred

MAX_TRIANGLES = 6000
MAX_TEXTURED = 20000
"""Triangles with images: they cost more to simplify, and what is seen is the image."""
_COLOUR_STEPS = 32


def drawn(
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
    merged = [_merged(group) for group in groups.values()]
    merged = [piece for piece in merged if len(piece.mesh.faces)]
    plain = sum(len(piece.mesh.faces) for piece in merged if piece.texture is None)
    textured = sum(len(piece.mesh.faces) for piece in merged if piece.texture is not None)
    return tuple(
        replace(piece, mesh=_simplified(piece.mesh, min(1.0, max_triangles / plain)))
        if piece.texture is None
        else _simplified_textured(piece, min(1.0, max_textured / textured))
        for piece in merged
    )


def _merged(group: Sequence[Piece]) -> Piece:
    mesh = joined([each.mesh for each in group])
    uvs = [each.uv for each in group if each.uv is not None]
    if not uvs:
        return Piece(cleaned(mesh), group[0].rgba)
    return _welded(Piece(mesh, group[0].rgba, np.concatenate(uvs), group[0].texture))


def _welded(piece: Piece) -> Piece:
    """Vertices of equal place and equal uv become one; collapsed and doubled triangles are dropped."""
    assert piece.uv is not None
    mesh = piece.mesh
    digits = 6 - int(np.floor(np.log10(max(float(np.ptp(mesh.vertices)), 1e-9))))
    _, place = np.unique(np.round(mesh.vertices, digits), axis=0, return_inverse=True)
    keys = np.column_stack([place.reshape(-1), np.round(piece.uv, UV_DIGITS)])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces, corners = inverse.reshape(-1)[mesh.faces], place.reshape(-1)[mesh.faces]
    is_sound = (corners != np.roll(corners, 1, axis=1)).all(1)
    faces, corners = faces[is_sound], np.sort(corners[is_sound], axis=1)
    faces = faces[np.sort(np.unique(corners, axis=0, return_index=True)[1])] if len(faces) else faces
    used, faces = np.unique(faces, return_inverse=True)
    kept = first[used]
    return replace(piece, mesh=Mesh(mesh.vertices[kept], faces.reshape(-1, 3)), uv=piece.uv[kept])


def _simplified(mesh: Mesh, share: float) -> Mesh:
    target = int(share * len(mesh.faces))
    if share >= 1 or target < 12:
        return mesh
    points, faces = fast_simplification.simplify(
        np.ascontiguousarray(mesh.vertices, np.float32),
        np.ascontiguousarray(mesh.faces, np.int32),
        target_count=target,
    )
    small = cleaned(Mesh(points, faces))
    return small if len(small.faces) else mesh


def _simplified_textured(piece: Piece, share: float) -> Piece:
    """Simplified without regard to the image, which is then laid over the new triangles again."""
    if share >= 1:
        return piece
    whole = cleaned(piece.mesh)
    small = _simplified(whole, share * len(piece.mesh.faces) / len(whole.faces))
    return piece if small is whole else transferred(piece, small)
