"""What is no object for a table: larger or heavier than the limits, or no object of its file (`scenery`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.body import with_mass
from cluttergen_jax.assets.config import MAX_MASS, MAX_SIZE
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.config import check_positive

_HAIR = 1e-4
_FURNITURE = 2.0
"""Metres."""


SEVERAL = (
    "several things that do not touch, in one file: import one by its name behind '#', or say so in "
    "objects.toml, ['FILE#NAME'] take = true"
)
"""Why a file of several things is left out."""


@dataclass(frozen=True)
class LeftOut:
    """A body that could be read and is no object for a table."""

    name: str  # Its file, from the folder on that was searched, and "#" with the body where it holds several.
    reason: str  # Why it was left out, in words; the same for all of a kind.
    detail: str = ""  # What is to be said of this one; may be empty.


@dataclass(frozen=True)
class Limits:
    """What an object on a table may be.

    The largest side of its box is what counts, whichever way it points: an object is turned, and laid on any
    of its sides, and what is as long as the table is wide cannot lie across it.

    Attributes:
      size: metres that its largest side stays below.
      mass: kilograms, at most.
    """

    size: float = MAX_SIZE
    mass: float = MAX_MASS

    def __post_init__(self) -> None:
        check_positive(self, "size", "mass")

    def why_left_out(self, name: str, sides: np.ndarray, mass: float = 0.0) -> LeftOut | None:
        """What is said of an object that is too large or too heavy; None if it is neither.

        Args:
          name: see `LeftOut`.
          sides: f64[3], of its box, metres.
          mass: kilograms; 0 if not known.
        """
        detail = " x ".join(f"{side:.2f}" for side in sides) + " m"
        detail += f", {mass:,.4g} kg" if mass > 0 else ""
        if sides.max() > max(self.size, _FURNITURE) - _HAIR:
            reason = "furniture by its size, 2 m or more (`cluttergen import --support` takes it)"
            return LeftOut(name, reason, detail)
        if sides.max() > self.size - _HAIR:
            reason = (
                f"too large for the usual table: a side of {self.size:g} m or more (`max_size`)"
            )
            return LeftOut(name, reason, detail)
        if mass > self.mass:
            return LeftOut(
                name, f"too heavy for a table: more than {self.mass:g} kg (`max_mass`)", detail
            )
        return None

    def why_shape_left_out(self, name: str, shape: Shape) -> LeftOut | None:
        """The same of a shape before a body is made of it; it is weighed only where it may be too heavy."""
        whole = join_meshes([piece.mesh for piece in shape.pieces])
        sides = np.ptp(whole.vertices[np.unique(whole.faces)], axis=0)
        stated = 0.0 if shape.stated is None else shape.stated.body.mass
        mass = stated if shape.mass is None else shape.mass
        is_light = max(mass, sides.prod() * shape.density) <= self.mass
        if sides.max() <= self.size - _HAIR and not is_light:
            mass = with_mass(shape)[2].mass
        return self.why_left_out(name, sides, mass)

    def why_body_left_out(self, name: str, asset: ObjectAsset) -> LeftOut | None:
        """The same of a body."""
        return self.why_left_out(name, 2 * np.asarray(asset.half_extents), asset.mass)
