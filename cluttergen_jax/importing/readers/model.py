"""What a URDF, SDF or MJCF file says of an object: more than its surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.mass import MassProperties, StatedMass, combine_masses
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.shape import Joint, Piece
from cluttergen_jax.errors import ConfigError, closest, first_names

MAX_PARTS = 32
_HAIR = 1e-6
_FILLS = 1 - 0.02
_MOST_NAMES = 20
_HEAVIEST = 1000.0
"""Kilograms of what moves on a joint of furniture."""


@dataclass(frozen=True, eq=False)
class Model:
    """A model of several links or bodies as one rigid thing, all its joints frozen.

    Attributes:
      pieces: the surfaces that are shown.
      parts: convex collision parts; None if the file has none that can be used.
      stated: mass and inertia; None if the file has none.
      notes: what was decided about the model, in words.
      density: kg/m^3 as the file has it, for where it has no mass.
      colliding: all that collides as the file has it, convex or not.
      link_of: for each piece, the number of its link; where links are read.
      joints: hinges and slides, which whoever keeps them need not freeze.
    """

    pieces: list[Piece]
    parts: tuple[Mesh, ...] | None
    stated: StatedMass | None
    notes: tuple[str, ...] = ()
    density: float | None = None
    colliding: tuple[Mesh, ...] = ()
    link_of: tuple[int, ...] = ()
    joints: tuple[Joint, ...] = ()


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


def alone_note(joints: Sequence[str], parent: str) -> tuple[str, ...]:
    """One note on the joints by which a body hangs on another, and which it loses where it is taken alone.

    Args:
      parent: the other one's name; "" for the world, or where it has none.
    """
    if not joints:
        return ()
    names = ", ".join(map(repr, joints))
    if not parent:
        return (f"it keeps no joint {names}, which moves it as a whole",)
    return (
        f"taken without {parent!r}, on which it hangs by {names}: it keeps no such joint, which "
        f"#{parent} behind the file does",
    )


def opened_joint(
    name: str, value: float, lower: float, upper: float, is_turn: bool
) -> tuple[float, tuple[str, ...]]:
    """Where a joint is to be, radians or metres, from degrees or metres.

    A limit is met to within the rounding of its file: 1.57 rad is asked for as 90 degrees. Then the joint is
    put at the limit.

    Args:
      lower, upper: how far it goes, radians or metres; infinite where there is no limit.

    Returns:
      The place, and a note where it is another than asked.

    Raises:
      ConfigError: it does not go so far.
    """
    unit, factor = ("degrees", math.pi / 180) if is_turn else ("m", 1.0)
    asked = value * factor
    if not lower - _rounding(lower, is_turn) <= asked <= upper + _rounding(upper, is_turn):
        raise ConfigError(
            f"joint {name!r} at {value:g} {unit}",
            f"{lower / factor:.4g} to {upper / factor:.4g} {unit}",
            f"{name}={upper / factor:.4g}" if math.isfinite(upper) else "a value within its limits",
        )
    place = min(max(asked, lower), upper)
    if abs(place - asked) <= _HAIR:
        return asked, ()
    return place, (
        f"joint {name!r} is at its limit, {place / factor:.4g} {unit}: {value:g} was asked, and its file "
        "is rounded",
    )


def _rounding(limit: float, is_turn: bool) -> float:
    """Radians or metres: one unit of a limit's last digit, at least 0.1 degree or 0.1 mm, at most ten times
    as much or, of angles, 0.01 rad."""
    least, most = (math.radians(0.1), 0.01) if is_turn else (1e-4, 1e-3)
    _, _, digits = f"{limit:.9f}".rstrip("0").partition(".")
    return min(max(10.0 ** -len(digits), least), most) if digits else least


def check_joints(asked: Iterable[str], movable: Iterable[str], path: Path) -> None:
    """Refuses joints that a file does not have, or that do not move (ConfigError)."""
    names = list(movable)
    for name in asked:
        if name not in names:
            raise ConfigError(
                f"joint {name!r} of {path.name}",
                ", ".join(names) or "no joint moves",
                meant=closest(name, names),
            )


def sound_mass(bodies: Sequence[MassProperties]) -> MassProperties | None:
    """What moves together on a joint as one body; None where files say what no body has."""
    if not all(
        np.isfinite([each.mass, *each.center, *each.inertia.ravel()]).all() for each in bodies
    ):
        return None
    stated = combine_masses(bodies)
    if stated is None or not 0 < stated.body.mass <= _HEAVIEST:
        return None
    moments = np.linalg.eigvalsh(stated.body.inertia)
    return (
        stated.body if moments[0] > 0 and moments[2] <= 1.01 * (moments[0] + moments[1]) else None
    )


def unknown_body(body: str, path: Path, known: Iterable[str], what: str = "body") -> ConfigError:
    """The error that a file has no body, link, model or node of that name."""
    names = [name for name in known if name]
    allowed = first_names(names, _MOST_NAMES, ", ...")
    return ConfigError(
        f"{what} {body!r} of {path.name}",
        allowed or f"nothing in it has a name: {path.name} without '#'",
        f"{path.name}, which takes all of it as one",
        closest(body, names),
    )


def convex_parts(meshes: list[Mesh]) -> tuple[Mesh, ...] | None:
    """The vertices of each mesh as a part, if there are few and each fills its hull; else None.

    A mesh fills its hull if the volume that its triangles enclose is within 2 % of the hull's.
    """
    if not 0 < len(meshes) <= MAX_PARTS:
        return None
    for mesh in meshes:
        hull = hull_of(mesh.vertices)
        if hull is None or not abs(mesh.volume) > _FILLS * hull.volume:
            return None
    return tuple(Mesh.points(mesh.vertices) for mesh in meshes)
