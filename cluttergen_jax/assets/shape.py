"""What a reader or the modeller hands to the importer: an object before it is a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cluttergen_jax.assets.mesh import Mesh

if TYPE_CHECKING:
    # Of use to importers alone, and slow to load.
    from cluttergen_jax.assets.stated_mass import StatedMass


@dataclass(frozen=True)
class Piece:
    """One coloured surface of an object.

    Attributes:
      mesh: in the shape's authored frame, z up, metres.
      rgba: each in [0, 1], sRGB as shown.
    """

    mesh: Mesh
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True)
class Cavity:
    """The hollow of a cup, a bowl, a pot or a holder.

    Attributes:
      solid: a closed mesh of the space inside, in the authored frame, up to the rim's plane.
      mouth: the point in the opening's plane, over the middle of the cavity, where a ball can be dropped in.
    """

    solid: Mesh
    mouth: tuple[float, float, float]


@dataclass(frozen=True)
class Provenance:
    """Where a shape comes from and on which terms it may be passed on."""

    source: str
    licence: str
    attribution: str = ""


@dataclass(frozen=True)
class Shape:
    """An object as authored: surfaces, and whatever its author knows about its body.

    Attributes:
      name: a short identifier, `[a-z0-9_-]+`.
      label: what people call it, e.g. "coffee mug".
      pieces: the coloured surfaces. Watertight where the author can promise it.
      parts: the author's own convex parts, at most 32 vertices each; None means they have to be found.
      cavity: given where the object is hollow and known to be.
      mass: kilograms, or None to take it from `stated` or `density`.
      density: kg/m^3 of the solid material, used if the mass is not known otherwise.
      stated: mass and inertia as the object's own file has them, not yet believed.
      friction: sliding coefficient wherever the object touches something; None for the contact's.
      notes: what its reader decided on the user's behalf, in words.
    """

    name: str
    label: str
    pieces: tuple[Piece, ...]
    provenance: Provenance
    parts: tuple[Mesh, ...] | None = None
    cavity: Cavity | None = None
    mass: float | None = None
    density: float = 500.0
    stated: StatedMass | None = None
    friction: float | None = None
    notes: tuple[str, ...] = ()
