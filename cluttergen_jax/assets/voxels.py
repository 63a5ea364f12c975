"""A surface on a grid: which cells it passes through, which are outside, and which would hold water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
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
      samples: f64[N, 3], points of the surface, nowhere farther than a third of a cell from the next one.
    """

    origin: np.ndarray
    pitch: float
    surface: np.ndarray
    outside: np.ndarray
    samples: np.ndarray

    @staticmethod
    def of(mesh: Mesh, cells: int = 72) -> Voxels:
        """The grid of a mesh, `cells` along its longest side.

        Edges are halved until they are no longer than half a cell. Then a path from cell to neighbouring
        cell cannot slip through a closed surface, so a flood from outside fills exactly what is outside.
        """
        lower, upper = mesh.bounds
        pitch = float((upper - lower).max()) / cells
        samples, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, pitch / 2, max_iter=20)
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
        near = ndimage.binary_dilation(self.outside, np.ones((3, 3, 3), bool))
        return near[self.index(points)]

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
