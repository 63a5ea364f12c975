"""A surface seen from straight above: height and level in each cell of a grid, and rectangles of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.mesh import Mesh

# The steepest slope that still counts as level: 2 degrees.
_LEVEL = np.cos(np.radians(2.0)).item()

Span = tuple[int, int, int, int]
"""A rectangle of cells: x from, x to, y from, y to; ends are exclusive."""


@dataclass(frozen=True, eq=False)
class Overhead:
    """The highest surface over the centre of each cell.

    Attributes:
      origin: f64[2], the grid's lower corner, metres.
      cell: f64[2], a cell's sides, metres.
      height: f64[X, Y], metres; -inf where nothing is.
      is_level: bool[X, Y], whether the highest surface there is horizontal.
    """

    origin: np.ndarray
    cell: np.ndarray
    height: np.ndarray
    is_level: np.ndarray


def level_faces(mesh: Mesh) -> np.ndarray:
    """bool[F]: horizontal triangles, whichever side they were drawn from."""
    normal = mesh.normals
    return np.abs(normal[:, 2]) > _LEVEL * np.maximum(np.linalg.norm(normal, axis=1), 1e-15)


def look_down(mesh: Mesh, lower: np.ndarray, upper: np.ndarray, shape: np.ndarray) -> Overhead:
    """Looks at a mesh from above.

    Args:
      mesh: its triangles may overlap and need not close.
      lower, upper: f64[2], corners of the rectangle to look at; the grid fills it exactly.
      shape: i[2], cells along x and y, at least one each.
    """
    cell = (upper - lower) / shape
    height, is_level = np.full(shape, -np.inf), np.zeros(shape, bool)
    level = level_faces(mesh)
    triangles = mesh.corners
    spots = (triangles[:, :, :2] - lower) / cell - 0.5
    first = np.maximum(np.ceil(spots.min(1) - 1e-6), 0).astype(int)
    last = np.minimum(np.floor(spots.max(1) + 1e-6), shape - 1).astype(int)
    upright = np.abs(mesh.normals[:, 2]) < 1e-14
    for face in np.flatnonzero((first <= last).all(1) & ~upright):
        _draw(
            spots[face], triangles[face, :, 2], first[face], last[face], bool(level[face]), height, is_level
        )
    return Overhead(np.asarray(lower, np.float64), cell, height, is_level)


def _draw(
    corners: np.ndarray,
    z: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    level: bool,
    height: np.ndarray,
    is_level: np.ndarray,
) -> None:
    """Writes one triangle, its corners in cells, into the cells whose centres it covers."""
    x, y = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1), indexing="ij")
    (bx, by), (cx, cy) = corners[1] - corners[0], corners[2] - corners[0]
    px, py = x - corners[0, 0], y - corners[0, 1]
    area = bx * cy - by * cx
    u, v = (px * cy - py * cx) / area, (bx * py - by * px) / area
    over = z[0] + u * (z[1] - z[0]) + v * (z[2] - z[0])
    window = np.s_[first[0] : last[0] + 1, first[1] : last[1] + 1]
    # Of two surfaces at the same height the level one counts: an edge must not hide a top.
    above = (over > height[window] + 1e-6) | ((over > height[window] - 1e-6) & level)
    is_hit = (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6) & above
    height[window] = np.where(is_hit, np.maximum(over, height[window]), height[window])
    is_level[window] = np.where(is_hit, level, is_level[window])


def largest_rectangle(mask: np.ndarray) -> Span:
    """The largest all-True rectangle of a bool[X, Y].

    Row by row, the lengths of the True runs that end there form a histogram whose largest rectangle a stack
    finds in one pass. (0, 0, 0, 0) if nothing is True.
    """
    best, best_area = (0, 0, 0, 0), 0
    run = np.zeros(mask.shape[1] + 1, int)
    for x, row in enumerate(mask):
        run[:-1] = np.where(row, run[:-1] + 1, 0)
        stack: list[tuple[int, int]] = []
        for y, length in enumerate(run.tolist()):
            start = y
            while stack and stack[-1][1] >= length:
                start, tall = stack.pop()
                if tall * (y - start) > best_area:
                    best_area = tall * (y - start)
                    best = (x + 1 - tall, x + 1, start, y)
            stack.append((start, length))
    return best


def cover(mask: np.ndarray, missing: float = 0.005, limit: int = 40) -> list[Span]:
    """Disjoint rectangles inside a bool[X, Y], largest first.

    Args:
      missing: share of the True cells that may stay uncovered.
      limit: rectangles at most.
    """
    rest = mask.copy()
    spans: list[Span] = []
    allowed = missing * mask.sum()
    while rest.sum() > allowed and len(spans) < limit:
        span = largest_rectangle(rest)
        spans.append(span)
        rest[span[0] : span[1], span[2] : span[3]] = False
    return spans
