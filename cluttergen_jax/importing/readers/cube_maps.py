"""A cube map laid around a surface, which is cut where the sides of the map meet, as uv of one image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cluttergen_jax.assets.mesh import Mesh

_CLOSE = 1e-6
"""Share of an edge that is not cut off at its end."""
_ERROR = 0.02
"""Of the image's side: what a place in the middle of an edge may be away from where it belongs."""
_PASSES = 5
_MOST = 20_000
"""Triangles of which none is made finer."""
# OpenGL's rule: the sides +x, -x, +y, -y, +z, -z, and for each, which coordinates run to the right in its
# image and down, and their signs.
_ACROSS = np.array([2, 2, 0, 0, 0, 0]), np.array([-1, 1, 1, 1, 1, -1])
_DOWN = np.array([1, 1, 2, 2, 1, 1]), np.array([-1, -1, 1, -1, -1, -1])


def one_image(sides: np.ndarray) -> np.ndarray:
    """u8[H, W, 3]: the only picture of u8[6, w, w, 3] if all are equal, else all six in two rows."""
    if (sides == sides[0]).all():
        return sides[0]
    width = sides.shape[1]
    rows = sides.reshape(2, 3, width, width, 3).transpose(0, 2, 1, 3, 4)
    return rows.reshape(2 * width, 3 * width, 3)


def laid_around(mesh: Mesh, directions: np.ndarray, is_one: bool, width: int) -> tuple[Mesh, np.ndarray]:
    """The mesh, each triangle with vertices of its own and on one side of the cube, and their uv.

    Neighbours are cut at the same places, so that what was closed stays closed.

    Args:
      directions: f64[V, 3], where from the middle of the cube each vertex is seen; linear on every triangle.
      is_one: whether `one_image` has one picture for all sides.
      width: pixels of one side; half a pixel at its rim is left out, so that no colour comes from beyond it.

    Returns:
      The mesh, and f64[3 F, 2].
    """
    points, faces = np.hstack([mesh.vertices, directions]), mesh.faces.astype(np.int64)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        for sign in (-1, 1):
            points, faces = _cut(points, faces, _at_plane(a, b, sign))
    for _ in range(_PASSES):
        before = len(faces)
        points, faces = _cut(points, faces, _where_bent) if before < _MOST else (points, faces)
        if len(faces) == before:
            break
    corners = points[faces]
    side = np.repeat(_side(corners[..., 3:].mean(1)), 3)
    places = 0.5 / width + (1 - 1 / width) * _places(corners[..., 3:].reshape(-1, 3), side).clip(0, 1)
    if not is_one:
        places = (places + np.column_stack([side % 3, side // 3])) / [3, 2]
    return Mesh(corners[..., :3].reshape(-1, 3), np.arange(len(side))), places * [1, -1] + [0, 1]


def _side(directions: np.ndarray) -> np.ndarray:
    """i64[N]: on which of the six sides f64[N, 3] are seen."""
    axis = np.abs(directions).argmax(1)
    return 2 * axis + (np.take_along_axis(directions, axis[:, None], 1)[:, 0] < 0)


def _places(directions: np.ndarray, side: np.ndarray) -> np.ndarray:
    """f64[N, 2]: to the right and down in the pictures of the sides i64[N], each from 0 to 1."""
    row = np.arange(len(side))
    away = np.maximum(np.abs(directions[row, side // 2]), 1e-12)
    across, down = (sign[side] * directions[row, axis[side]] / away for axis, sign in (_ACROSS, _DOWN))
    return (np.column_stack([across, down]) + 1) / 2


def _at_plane(a: int, b: int, sign: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Where edges cross the plane on which the directions' coordinates a and b are equal, or opposite."""

    def share(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        first, last = (ends[:, 3 + a] + sign * ends[:, 3 + b] for ends in (start, end))
        crosses = first * last < 0
        at = np.divide(first, first - last, out=np.zeros(len(first)), where=crosses)
        return np.where((at > _CLOSE) & (at < 1 - _CLOSE), at, np.nan)

    return share


def _where_bent(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The middle of edges along which the image does not run evenly."""
    middle = (start[:, 3:] + end[:, 3:]) / 2
    side = _side(middle)
    first, between, last = (_places(each, side) for each in (start[:, 3:], middle, end[:, 3:]))
    is_bent = np.abs(between - (first + last) / 2).max(1) > _ERROR
    return np.where(is_bent, 0.5, np.nan)


def _cut(
    points: np.ndarray, faces: np.ndarray, share: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles cut at their edges.

    Args:
      points: f64[V, D].
      faces: i64[F, 3].
      share: of the points at both ends of edges, f64[E, D] each: where between them they are cut, NaN where
        not.
    """
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    edges, which = np.unique(ends @ [len(points), 1], return_inverse=True)
    start, end = points[edges // len(points)], points[edges % len(points)]
    at = share(start, end)[:, None]
    is_cut = np.isfinite(at[:, 0])
    made = np.where(is_cut, len(points) + np.cumsum(is_cut) - 1, -1)
    added = (start + at * (end - start))[is_cut]
    return np.concatenate([points, added]), _pieces(faces, made[which.reshape(-1, 3)])


def _pieces(faces: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Triangles i64[F, 3] cut at points i64[F, 3] on the edges behind each corner, -1 where there is none."""
    is_cut = middles >= 0
    count = is_cut.sum(1)
    # Turned so that of one cut edge it is the first, and of two they are the first two.
    first = np.where(count == 2, is_cut.argmin(1) + 1, is_cut.argmax(1))
    turn = (first[:, None] + np.arange(3)) % 3
    corners = np.hstack([np.take_along_axis(each, turn, 1) for each in (faces, middles)])
    # Names of corners: 0, 1, 2, and 3, 4, 5 the points on the edges behind them.
    patterns = [
        [(0, 1, 2)],
        [(0, 3, 2), (3, 1, 2)],
        [(3, 1, 4), (0, 3, 4), (0, 4, 2)],
        [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    ]
    return np.concatenate(
        [corners[count == n][:, np.array(pattern)].reshape(-1, 3) for n, pattern in enumerate(patterns)]
    )
