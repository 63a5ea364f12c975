"""Mass, centre of mass and inertia: of a solid, as a file states them, and which of the two to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.assets.mesh import ORIGIN, Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.errors import AssetError


@dataclass(frozen=True, eq=False)
class MassProperties:
    """A rigid body's mass in the frame of the mesh that it was taken from."""

    mass: float  # Kilograms.
    center: np.ndarray  # f64[3], metres.
    inertia: np.ndarray  # f64[3, 3], kg m^2, about the centre, along the mesh's axes.

    def transform(self, rotation: np.ndarray, translation: np.ndarray = ORIGIN) -> MassProperties:
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
            f"a volume of {volume:.3g} m^3 and a mass of {weight:.3g} kg",
            "both above zero",
            "`mass`",
        )
    tri.density = weight / volume
    inertia = np.asarray(tri.moment_inertia, np.float64)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0 or moments[2] > 1.0001 * (moments[0] + moments[1]):
        raise AssetError(
            f"moments of inertia {moments}, which no body has", "a closed mesh, facing outwards"
        )
    return MassProperties(
        weight, np.asarray(tri.center_mass, np.float64), (inertia + inertia.T) / 2
    )


MIN_DENSITY = 20.0
MAX_DENSITY = 20_000.0
# What things can weigh over their convex hulls, kg/m^3: from an empty pitcher to a block of steel.
_LIKELY_DENSITY = (50.0, 8000.0)
# How far the principal moments may be from those of the same mass spread evenly.
_MAX_RATIO = 4.0
# A body whose moments differ by less than this may well have one moment about every axis.
_ROUND = 1.25
_CLOSE = 0.05
_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class StatedMass:
    """What a URDF, SDF or MJCF file says of one rigid body, all its links taken together.

    Attributes:
      body: in the shape's authored frame.
      is_even: whether every link has the same moment about every axis, as exporters write that do not know.
      is_round: whether every link's mass is a power of ten.
    """

    body: MassProperties
    is_even: bool
    is_round: bool

    def convert(self, turn: np.ndarray, lengths: float, mass: float = 1.0) -> StatedMass:
        """The same in another frame and unit: turned, with lengths and the mass times a factor each."""
        body = MassProperties(
            self.body.mass * mass,
            self.body.center * lengths,
            self.body.inertia * (mass * lengths**2),
        )
        return replace(self, body=body.transform(turn))


def combine_masses(bodies: Sequence[MassProperties]) -> StatedMass | None:
    """Rigidly joined bodies as one, all in one frame; None where they weigh nothing."""
    bodies = [body for body in bodies if body.mass != 0]
    mass = sum(body.mass for body in bodies)
    if not mass:
        return None
    center = sum((body.mass * body.center for body in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        offset = body.center - center
        inertia += body.inertia + body.mass * (
            offset @ offset * np.eye(3) - np.outer(offset, offset)
        )
    return StatedMass(
        MassProperties(mass, center, inertia),
        is_even=all(_is_even(body.inertia) for body in bodies),
        is_round=all(_is_power_of_ten(body.mass) for body in bodies),
    )


def choose_mass(
    stated: StatedMass, solid: Mesh, uniform: MassProperties, density: float
) -> tuple[MassProperties, str]:
    """What to take for an object: as stated where that is plausible, else spread evenly over its volume.

    Args:
      stated: in the solid's frame.
      solid: closed, oriented outwards.
      uniform: the solid filled with `density`, kg/m^3.

    Returns:
      The mass properties, and in words what was not taken and why; empty if nothing was refused.
    """
    mass = stated.body.mass
    share = mass / uniform.mass
    even = MassProperties(mass, uniform.center, uniform.inertia * share)
    if reason := _why_no_mass(stated, density * share, even):
        text = f" of {_kilograms(mass)}" if np.isfinite(mass) else ""
        return uniform, (
            f"its stated mass{text} is not taken: {reason}; "
            f"{uniform.mass:.3g} kg by volume and density instead"
        )
    if reason := _why_no_inertia(stated, solid, even):
        return even, (
            f"its stated mass of {_kilograms(mass)} is taken, but not its inertia: {reason}; "
            "the mass is spread evenly over its volume instead"
        )
    return stated.body, ""


def mass_alarm(stated: StatedMass, solid: Mesh) -> str:
    """Why a stated mass and the object's size contradict each other, taken or not; empty if they do not.

    Over the convex hull, so that hollow things and thin shells are as heavy as they look; over the volume of
    the mesh as well where no material weighs so much.

    Args:
      stated: in the solid's frame.
      solid: closed, oriented outwards.
    """
    mass = stated.body.mass
    hull = hull_of(solid.vertices)
    if hull is None or not (np.isfinite(mass) and mass > 0):
        return ""
    low, high = _LIKELY_DENSITY
    over_hull = mass / hull.volume
    over_mesh = mass / solid.volume
    if not low <= over_hull <= high:
        text = (
            f"{_density(over_hull)} over its convex hull, where {low:g} to {high:,.0f} are likely"
        )
    elif not MIN_DENSITY <= over_mesh <= MAX_DENSITY:
        text = f"{_density(over_mesh)} over the volume of its mesh"
    else:
        return ""
    instead = 'mass="volume" takes its volume times density'
    return f"its stated mass of {_kilograms(mass)} does not fit its size: {text} ({instead})"


def _kilograms(mass: float) -> str:
    return f"{mass:,.0f} kg" if mass >= 100 else f"{mass:.3g} kg"


def _density(value: float) -> str:
    return f"{value:,.0f} kg/m^3" if value >= 100 else f"{value:.3g} kg/m^3"


def _why_no_mass(stated: StatedMass, density: float, even: MassProperties) -> str:
    if not (np.isfinite(density) and density > 0):
        return "it is not a positive number"
    if not MIN_DENSITY <= density <= MAX_DENSITY:
        return f"over its volume that is {density:,.0f} kg/m^3, not {MIN_DENSITY:g} to {MAX_DENSITY:,.0f}"
    if stated.is_round and stated.is_even and not _is_close(stated, even):
        return "a round number, with the same moment of inertia about every axis, is a placeholder"
    return ""


def _why_no_inertia(stated: StatedMass, solid: Mesh, even: MassProperties) -> str:
    if not (np.isfinite(stated.body.inertia).all() and np.isfinite(stated.body.center).all()):
        return "it is not made of finite numbers"
    if not stated.body.inertia.any():
        return "none is given"
    moments, expected = (np.linalg.eigvalsh(each.inertia) for each in (stated.body, even))
    if moments[0] <= 0 or moments[2] > (1 + 1e-4) * (moments[0] + moments[1]):
        return "no body has such moments"
    ratio = moments / expected
    if ratio.max() > _MAX_RATIO or ratio.min() < 1 / _MAX_RATIO:
        worst = float(ratio[np.abs(np.log(ratio)).argmax()])
        return f"a moment is {worst:.3g} times that of a body of this size"
    if stated.is_even and expected[2] > _ROUND * expected[0]:
        return "it is the same about every axis, though the object is not round"
    hull = hull_of(solid.vertices)
    reach = 0.01 * solid.diagonal
    if hull is not None and (hull.equations @ np.append(stated.body.center, 1.0)).max() > reach:
        return "its centre of mass lies outside the object"
    return ""


def _is_close(stated: StatedMass, even: MassProperties) -> bool:
    """Whether the stated inertia has plainly been computed: that of a ball or a cube is even, too."""
    size = float(np.abs(even.inertia).max())
    return bool(np.abs(stated.body.inertia - even.inertia).max() < _CLOSE * size)


def _is_even(inertia: np.ndarray) -> bool:
    size = float(np.abs(inertia).max())
    return size > 0 and bool(np.abs(inertia - inertia[0, 0] * np.eye(3)).max() <= _TOLERANCE * size)


def _is_power_of_ten(mass: float) -> bool:
    digits = np.log10(mass) if mass > 0 else 0.5
    return bool(abs(digits - np.round(digits)) < _TOLERANCE)
