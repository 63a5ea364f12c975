"""Mass, centre of mass and inertia from the solid, never from the collision parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.errors import AssetError


@dataclass(frozen=True, eq=False)
class MassProperties:
    """A rigid body's mass in the frame of the mesh that it was taken from.

    Attributes:
      mass: kilograms.
      center: f64[3], metres.
      inertia: f64[3, 3], kg m^2, about the centre, along the mesh's axes.
    """

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    def moved(self, rotation: np.ndarray, translation: np.ndarray) -> MassProperties:
        """The same body with every point p moved to rotation @ p + translation."""
        return MassProperties(
            self.mass, rotation @ self.center + translation, rotation @ self.inertia @ rotation.T
        )


def mass_properties(mesh: Mesh, density: float, mass: float | None = None) -> MassProperties:
    """Of a closed mesh filled evenly.

    Args:
      mesh: closed, oriented outwards.
      density: kg/m^3, used if `mass` is None.
      mass: kilograms.

    Raises:
      AssetError: the volume or the mass is not above zero.
    """
    # Loaded when an object is imported: it takes as long as JAX, and placing objects needs none of it.
    import trimesh

    tri = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    volume = float(tri.volume)
    weight = density * volume if mass is None else mass
    if not (np.isfinite(weight) and weight > 0 and volume > 0):
        raise AssetError(
            f"a volume of {volume:.3g} m^3 and a mass of {weight:.3g} kg", "both above zero", "`mass`"
        )
    tri.density = weight / volume
    inertia = np.asarray(tri.moment_inertia, np.float64)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0 or moments[2] > 1.0001 * (moments[0] + moments[1]):
        raise AssetError(f"moments of inertia {moments}, which no body has", "a closed mesh, facing outwards")
    return MassProperties(weight, np.asarray(tri.center_mass, np.float64), (inertia + inertia.T) / 2)
