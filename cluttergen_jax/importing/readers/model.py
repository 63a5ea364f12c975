"""What a URDF, SDF or MJCF file says of an object: more than its surfaces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.mass import StatedMass
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.shape import Piece

MAX_PARTS = 32


@dataclass(frozen=True, eq=False)
class Model:
    """A model of several links or bodies as one rigid thing, all its joints frozen."""

    pieces: list[Piece]  # The surfaces that are shown.
    parts: tuple[Mesh, ...] | None  # Convex collision parts; None if the file has none that can be used.
    stated: StatedMass | None  # Mass and inertia; None if the file has none.
    notes: tuple[str, ...] = ()  # What was decided about the model, in words.
    density: float | None = None  # kg/m^3 as the file has it, for where it has no mass.
    colliding: tuple[Mesh, ...] = ()  # All that collides as the file has it, convex or not.


def frozen_note(joints: Iterable[tuple[str, str, float, bool]]) -> tuple[str, ...]:
    """One note on all movable joints; none where there is none.

    Args:
      joints: name, kind, value in radians or metres, and whether it turns.
    """
    described = []
    for name, kind, value, is_turn in joints:
        place = f"{np.degrees(value) + 0.0:.3g} degrees" if is_turn else f"{value + 0.0:.3g} m"
        described.append(f"{name!r} ({kind}) at {place}")
    return (f"frozen joints: {', '.join(described)}",) if described else ()


def convex_parts(meshes: list[Mesh], tolerance: float = 0.02) -> tuple[Mesh, ...] | None:
    """The vertices of each mesh as a part, if there are few and each fills its hull; else None.

    A mesh fills its hull if the volume that its triangles enclose is within `tolerance` of the hull's.
    """
    if not 0 < len(meshes) <= MAX_PARTS:
        return None
    for mesh in meshes:
        hull = hull_of(mesh.vertices)
        if hull is None or not abs(mesh.volume) > (1 - tolerance) * hull.volume:
            return None
    return tuple(Mesh.points(mesh.vertices) for mesh in meshes)
