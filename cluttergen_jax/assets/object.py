"""An object asset: a rigid body that is ready to be placed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Provenance, Texture

CLOUD_SIZE = 1024


@dataclass(frozen=True)
class RestingPose:
    """One way in which the object comes to rest by itself.

    Attributes:
      quaternion: wxyz, turns the object frame into this pose (the first one is the identity).
      height: metres from the support's top to the origin.
      likelihood: share of random releases that end in this pose.
    """

    quaternion: tuple[float, float, float, float]
    height: float
    likelihood: float


@dataclass(frozen=True)
class Quality:
    """What was measured about a body; None where the measure does not apply or was not run.

    Attributes:
      deviation: symmetric Hausdorff distance between parts and mesh (10,000 samples each way), over the
        bounding box's diagonal.
      cavity_fill: share of the cavity that the parts cover.
      holds_ball: whether a 10 mm ball dropped at the mouth comes to rest inside.
      solo_rate: share of `solo_trials` placements alone on the table that were stable.
      solo_steps: mean number of steps of the stable ones.
    """

    deviation: float | None = None
    cavity_fill: float | None = None
    holds_ball: bool | None = None
    solo_rate: float | None = None
    solo_trials: int = 0
    solo_steps: float | None = None


@dataclass(frozen=True, eq=False)
class ObjectAsset:
    """A rigid body in its object frame: resting orientation, origin at the centre of the parts' bounding box.

    Attributes:
      name: unique in its pool, `[a-z0-9_-]+`.
      label: what people call it.
      pieces: visual surfaces, coloured or textured, object frame, metres.
      parts: convex collision parts, object frame, metres, at most 32 vertices each.
      mass: kilograms.
      center_of_mass: f64[3], object frame.
      inertia: f64[3, 3], kg m^2, about the centre of mass, object axes.
      cloud: f32[1024, 3], surface points, area-uniform, farthest-point ordered: any prefix is a good sample.
      resting: at least one; the first is the object frame itself.
      tier: "standard" or "light".
      quality: what was measured.
      flags: why a user should think twice, in words; empty for a sound body.
      notes: what was decided on the user's behalf, in words: no fault, but worth knowing.
      friction: sliding coefficient of its own (`mjcf.own_contact`); None for the contact's.
      scale: the factor by which the lengths of its file were multiplied on request.
      synset: what kind of thing it is (`Shape.synset`); empty if unknown.
    """

    name: str
    label: str
    pieces: tuple[Piece, ...]
    parts: tuple[Mesh, ...]
    mass: float
    center_of_mass: np.ndarray
    inertia: np.ndarray
    cloud: np.ndarray
    resting: tuple[RestingPose, ...]
    provenance: Provenance
    tier: str = "standard"
    quality: Quality = field(default_factory=Quality)
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    friction: float | None = None
    scale: float = 1.0
    synset: str = ""

    @property
    def textures(self) -> tuple[Texture, ...]:
        """The images of its surfaces, each once."""
        return tuple(dict.fromkeys(image for piece in self.pieces for image in piece.images))

    @property
    def drawn_pieces(self) -> tuple[Piece, ...]:
        """Its surfaces; its collision parts where it has none."""
        return self.pieces or tuple(Piece(part.hull()) for part in self.parts)

    @property
    def vertices(self) -> np.ndarray:
        """f64[V, 3]: those of all parts, metres."""
        return np.concatenate([part.vertices for part in self.parts])

    @property
    def half_extents(self) -> np.ndarray:
        """f64[3]: half the size of the parts' bounding box, which is centred on the origin."""
        vertices = self.vertices
        return (vertices.max(0) - vertices.min(0)) / 2

    @property
    def radius(self) -> float:
        """Metres from the origin to the farthest collision vertex."""
        return float(max(np.linalg.norm(part.vertices, axis=1).max() for part in self.parts))
