"""Visual surfaces: one piece per colour, few triangles."""

from __future__ import annotations

from collections.abc import Sequence

import fast_simplification
import numpy as np

from cluttergen_jax.assets.mesh import Mesh, joined
from cluttergen_jax.assets.readers.mesh_file import cleaned
from cluttergen_jax.assets.shape import Piece

MAX_TRIANGLES = 6000
_COLOUR_STEPS = 32


def drawn(pieces: Sequence[Piece], max_triangles: int = MAX_TRIANGLES) -> tuple[Piece, ...]:
    """Pieces of like colour joined and welded, simplified to about `max_triangles` in all.

    Sheets are given their second side later, which can double their number.
    """
    groups: dict[tuple[int, ...], list[Piece]] = {}
    for piece in pieces:
        groups.setdefault(tuple(round(c * _COLOUR_STEPS) for c in piece.rgba), []).append(piece)
    merged = [
        Piece(cleaned(joined([each.mesh for each in group])), group[0].rgba) for group in groups.values()
    ]
    merged = [piece for piece in merged if len(piece.mesh.faces)]
    total = sum(len(piece.mesh.faces) for piece in merged)
    share = min(1.0, max_triangles / total)
    return tuple(Piece(_simplified(piece.mesh, share), piece.rgba) for piece in merged)


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
