"""Open boxes with four flat walls: holders, trays, baskets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.shape import Cavity


@dataclass(frozen=True)
class Crate:
    """A box without a lid, centred on the z axis, standing on z = 0. Metres.

    Attributes:
      width, depth: of the foot, along x and y.
      height: of the rim.
      wall, floor: thicknesses.
      flare: how far each wall leans out from foot to rim.
    """

    width: float
    depth: float
    height: float
    wall: float = 0.004
    floor: float = 0.004
    flare: float = 0.0

    def outline(self, z: float, inset: float = 0.0) -> np.ndarray:
        """The four corners at height z, moved in by `inset`: f64[4, 3], from (-x, -y) on anticlockwise."""
        half_x = self.width / 2 + self.flare * z / self.height - inset
        half_y = self.depth / 2 + self.flare * z / self.height - inset
        return np.array(
            [(-half_x, -half_y, z), (half_x, -half_y, z), (half_x, half_y, z), (-half_x, half_y, z)]
        )

    def _inside(self, low: float, high: float) -> Manifold:
        """The space between the walls from one height to another."""
        return cad.hull(np.concatenate([self.outline(z, self.wall) for z in (low, high)]))

    def solid(self) -> Manifold:
        """Floor and walls."""
        block = cad.hull(np.concatenate([self.outline(0.0), self.outline(self.height)]))
        return block - self._inside(self.floor, self.height * 1.2)

    def cavity(self, low: float | None = None) -> Cavity:
        """The space inside, from the floor (or from `low`) up to the rim's plane."""
        inside = self._inside(self.floor if low is None else low, self.height)
        return Cavity(cad.to_mesh(inside), (0.0, 0.0, self.height))

    def parts(self) -> tuple[Mesh, ...]:
        """A floor and four walls; only the floor reaches the table."""
        floor = part.box((self.width, self.depth, self.floor))
        low = self.floor / 2
        rings = [self.outline(low), self.outline(self.height)]
        rings += [self.outline(low, self.wall), self.outline(self.height, self.wall)]
        walls = [part.hull(np.concatenate([ring[[k, (k + 1) % 4]] for ring in rings])) for k in range(4)]
        return (floor, *walls)
