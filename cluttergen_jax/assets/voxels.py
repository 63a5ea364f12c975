"""A surface on a grid: which cells it passes through, which are outside, and which would hold water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cluttergen_jax.assets.mesh import Mesh

_MARGIN = 2


@dataclass(frozen=True, eq=False)
class Voxels:
    """A grid of cubic cells around a surface, with a margin of empty cells.

    Attributes:
      origin: f64[3], centre of cell (0, 0, 0), metres.
      pitch: side of a cell, metres.
      surface: bool[X, Y, Z], cells that the surface passes through.
      outside: bool[X, Y, Z], cells that can be reached from outside without crossing the surface.
      samples: f64[N, 3], points of the surface; every point of it is within 0.47 cells of one.
    """

    origin: np.ndarray
    pitch: float
    surface: np.ndarray
    outside: np.ndarray
    samples: np.ndarray

    @staticmethod
    def of(mesh: Mesh, cells: int = 72) -> Voxels:
        """The grid of a mesh, `cells` along its longest side.

        Where a path from a cell to its neighbour crosses the surface, a sample is within half a cell, so one
        of the two cells is marked: a flood from outside cannot slip through a closed surface.
        """
        lower, upper = mesh.bounds
        pitch = float((upper - lower).max()) / cells
        samples = scan_lines(mesh, 0.35 * pitch, 0.6 * pitch)
        origin = lower - _MARGIN * pitch
        shape = np.ceil((upper - origin) / pitch).astype(int) + 1 + _MARGIN
        surface = np.zeros(shape, bool)
        surface[tuple(np.round((samples - origin) / pitch).astype(int).T)] = True
        regions, _ = ndimage.label(~surface)
        return Voxels(origin, pitch, surface, regions == regions[0, 0, 0], samples)

    @property
    def solid(self) -> np.ndarray:
        """bool[X, Y, Z]: the surface's cells and all that they enclose."""
        return ~self.outside

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """f64[N, 3]: centres of the True cells of a bool[X, Y, Z]."""
        return self.origin + np.argwhere(cells) * self.pitch

    def index(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """The cells in which `points` lie, as an index; points beyond the grid get its outermost cells."""
        cells = np.round((points - self.origin) / self.pitch).astype(int)
        return tuple(np.clip(cells, 0, np.array(self.surface.shape) - 1).T)

    def is_exposed(self, points: np.ndarray) -> np.ndarray:
        """bool[N]: whether surface points can be seen from outside, to within a cell."""
        return dilate(self.outside)[self.index(points)]

    def water(self) -> np.ndarray:
        """bool[X, Y, Z]: cells outside that would stay full if the object were filled with water.

        Level by level from below: water leaves a cell if it can leave the cell beneath, or flow sideways
        to a cell that it leaves.
        """
        is_dry = np.zeros_like(self.outside)
        below = np.ones(self.outside.shape[:2], bool)
        for level in range(self.outside.shape[2]):
            regions, _ = ndimage.label(self.outside[:, :, level])
            drain = below.copy()
            drain[[0, -1], :] = drain[:, [0, -1]] = True
            drained = np.unique(regions[drain])
            below = np.isin(regions, drained[drained > 0])
            is_dry[:, :, level] = below
        return self.outside & ~is_dry


def dilate(cells: np.ndarray) -> np.ndarray:
    """bool[X, Y, Z]: the True cells with all around them, corners included."""
    return np.asarray(ndimage.binary_dilation(cells, np.ones((3, 3, 3), bool)))


def scan_lines(mesh: Mesh, line_spacing: float, spacing: float) -> np.ndarray:
    """f64[N, 3]: points on lines along each triangle's longest edge, so slivers cost no more than their area.

    Lines are at most `line_spacing` apart and points on a line at most `spacing`. A point of the triangle is
    at most `line_spacing` from the longer of the two lines beside it, and so within
    sqrt(line_spacing^2 + spacing^2 / 4) of a sample.
    """
    corners = mesh.corners
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(edges, axis=2).argmax(1)
    rows = np.arange(len(corners))
    start = corners[rows, longest]
    along = edges[rows, longest]
    apex = corners[rows, (longest + 2) % 3] - start
    length = np.linalg.norm(along, axis=1)
    height = np.linalg.norm(np.cross(along, apex), axis=1) / np.maximum(length, 1e-12)
    which, share = _steps(height, line_spacing)
    start = start[which] + apex[which] * share[:, None]
    along = along[which] * (1 - share)[:, None]
    which, share = _steps(length[which] * (1 - share), spacing)
    return start[which] + along[which] * share[:, None]


def _steps(lengths: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """For each length, steps from 0 to 1 that are at most `spacing` long: whose they are, and where."""
    counts = np.ceil(lengths / spacing).astype(np.int64) + 1
    which = np.repeat(np.arange(len(lengths)), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    share = (np.arange(len(which)) - first) / np.maximum(counts[which] - 1, 1)
    return which, share
