"""Hollow bodies: of revolution (cups, bowls, pots, jars), and open boxes (holders, trays, baskets)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts as part
from cluttergen_jax.assets.modeller import solids as cad
from cluttergen_jax.assets.shape import Cavity

Profile = Sequence[tuple[float, float]]

_SWELL = 1.02
"""How much wider walls are: a polygon in a circle takes room from the cavity, one halfway outside less."""


@dataclass(frozen=True)
class Vessel:
    """A wall of revolution around an open hollow.

    Attributes:
      outer: (radius, z) from the foot (z = 0) to the rim, z never falling.
      inner: (radius, z) from the floor to the rim, z never falling, ending at the outer rim's height.
    """

    outer: Profile
    inner: Profile

    @property
    def floor(self) -> float:
        """The height of the inner floor."""
        return float(self.inner[0][1])

    @property
    def rim(self) -> float:
        """The height of the rim's plane."""
        return float(self.outer[-1][1])

    def solid(self) -> Manifold:
        """The wall and the floor."""
        return cad.lathe([*self.outer, *reversed(self.inner)])

    def layers(self, thickness: float) -> tuple[Manifold, Manifold]:
        """The solid in two closed shells, outside and lining, for two colours."""
        grown = [(r + thickness, z - thickness) for r, z in self.inner]
        tool = cad.lathe([*grown, (grown[-1][0], self.rim + 1.0)])
        whole = self.solid()
        return whole - tool, whole ^ tool

    def inside(self) -> Manifold:
        """The space inside, open upwards: what has to be cut from handles that reach through the wall."""
        return cad.lathe([*self.inner, (self.inner[-1][0], self.rim + 1.0)])

    def cavity(self) -> Cavity:
        """The space inside, up to the rim's plane."""
        return Cavity(cad.to_mesh(cad.lathe(self.inner)), (0.0, 0.0, self.rim))

    def outer_radius(self, z: float) -> float:
        """The radius of the outside at height z."""
        return float(np.interp(z, [p[1] for p in self.outer], [p[0] for p in self.outer]))

    def inner_radius(self, z: float) -> float:
        """The radius of the inside at height z, at or above the floor."""
        return float(np.interp(z, [p[1] for p in self.inner], [p[0] for p in self.inner]))

    def parts(self, num: int, cuts: Sequence[float] = ()) -> tuple[Mesh, ...]:
        """One floor disc and rows of `num` wall wedges, rows parted at the heights `cuts`.

        Only the disc reaches the table, so that a body has one flat face to stand on.
        """
        base = [(self.outer_radius(z), z) for z in (self.outer[0][1], self.floor)]
        found = [part.disc(base, num if num >= 10 else 12, is_standing=True)]
        for low, high in itertools.pairwise([self.floor, *cuts, self.rim]):
            found += part.ring_sectors(self._row(low, high), num)
        return tuple(found)

    def _row(self, low: float, high: float) -> list[tuple[float, float]]:
        """The section of the wall between two heights; its foot is sunk a little into what lies below."""
        sunk = low - min(0.5 * (self.floor - self.outer[0][1]), 0.002)
        heights = np.linspace(low, high, 4)
        outside = [(self.outer_radius(z), float(z)) for z in (sunk, *heights)]
        inside = [(self.inner_radius(z), float(z)) for z in (low, high)]
        return [(_SWELL * radius, z) for radius, z in (*outside, *inside)]


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

    def _inside(self, high: float) -> Manifold:
        """The space between the walls from the floor up to a height."""
        return cad.hull(self.outline(self.floor, self.wall), self.outline(high, self.wall))

    def solid(self) -> Manifold:
        """Floor and walls."""
        block = cad.hull(self.outline(0.0), self.outline(self.height))
        return block - self._inside(self.height * 1.2)

    def cavity(self) -> Cavity:
        """The space inside, up to the rim's plane."""
        inside = self._inside(self.height)
        return Cavity(cad.to_mesh(inside), (0.0, 0.0, self.height))

    def parts(self) -> tuple[Mesh, ...]:
        """A floor and four walls; only the floor reaches the table."""
        floor = part.box((self.width, self.depth, self.floor))
        low = self.floor / 2
        rings = [self.outline(z, inset) for inset in (0.0, self.wall) for z in (low, self.height)]
        walls = [part.hull(*[ring[[k, (k + 1) % 4]] for ring in rings]) for k in range(4)]
        return (floor, *walls)
