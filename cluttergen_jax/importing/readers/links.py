"""The links of a model, as URDF and SDF have them, taken together as one rigid thing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.inertia import MassProperties
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.stated_mass import combined
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.model import Model, convex_parts
from cluttergen_jax.importing.readers.numbers import length, number, said
from cluttergen_jax.importing.readers.surfaces import Look, Surfaces
from cluttergen_jax.importing.readers.xml_tree import Element


@dataclass(frozen=True)
class Link:
    """A link of a model.

    Attributes:
      element: its <link>.
      place: of an element within, f64[4, 4] from that to the model.
    """

    element: Element
    place: Callable[[Element], np.ndarray]

    @property
    def name(self) -> str:
        return self.element.get("name", "")


def rigid(
    links: Sequence[Link],
    surfaces: Surfaces,
    look: Callable[[Element], Look],
    notes: Sequence[str] = (),
    scale: float = 1.0,
) -> Model:
    """The links as one rigid thing: what is seen are the visuals, or what collides where there are none.

    Args:
      surfaces: reads their geometry; its notes come behind `notes`.
      look: of a <visual> or a <collision>.
      scale: factor on all lengths, not on masses.

    Raises:
      AssetError: there is no geometry, or something cannot be read; the message names it.
    """
    visuals, collisions = (
        [
            piece
            for link in links
            for element in link.element.findall(tag)
            for piece in surfaces.pieces(element, link.place(element), scale, look(element))
        ]
        for tag in ("visual", "collision")
    )
    if not visuals and not collisions:
        raise AssetError(f"{surfaces.path} has neither visual nor collision geometry")
    masses = {link.name: mass for link in links if (mass := _link_mass(surfaces.path, link)) is not None}
    stated = combined(list(masses.values()))
    told = [*notes, *_weightless(links, masses)]
    return Model(
        pieces=_seen(visuals, surfaces.notes) or collisions,
        parts=convex_parts([piece.mesh for piece in collisions]),
        stated=None if stated is None else stated.scaled(np.eye(3), scale),
        notes=tuple(dict.fromkeys([*told, *surfaces.notes])),
        density=_density(surfaces.path, links),
        colliding=tuple(piece.mesh for piece in collisions),
    )


def _seen(visuals: list[Piece], notes: list[str]) -> list[Piece]:
    """The visuals that can be seen; all of them, opaque, where none can."""
    seen = [piece for piece in visuals if piece.rgba[3] > 0]
    if len(seen) == len(visuals):
        return visuals
    if seen:
        notes.append(f"left out, as their alpha is 0: {len(visuals) - len(seen)} of {len(visuals)} surfaces")
        return seen
    notes.append("drawn opaque although its alpha is 0, as nothing else is there to be seen")
    return [replace(piece, rgba=(*piece.rgba[:3], 1.0)) for piece in visuals]


def _weightless(links: Sequence[Link], masses: dict[str, MassProperties]) -> Iterator[str]:
    solid = [link.name for link in links if link.element.find("visual") is not None]
    without = [name for name in solid if name not in masses]
    if masses and without:
        yield f"its file states no mass for {', '.join(map(repr, without))}"


def _link_mass(path: Path, link: Link) -> MassProperties | None:
    """A link's mass and inertia in the model's frame; what cannot be read is NaN, to be refused later."""
    inertial = link.element.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return None
    given = inertial.find("inertia")
    inertia = np.zeros((3, 3))
    if given is not None:
        for row, column in zip(*np.triu_indices(3), strict=True):
            # In SDF, which writes moments as elements, products of inertia are 0 where they are missing.
            absent = "0" if len(given) and row != column else "nan"
            moment = _weight(path, given, f"i{'xyz'[row]}{'xyz'[column]}", absent)
            inertia[row, column] = inertia[column, row] = moment
    pose = link.place(inertial)
    body = MassProperties(_weight(path, *_holder(inertial, mass)), np.zeros(3), inertia)
    return body.moved(pose[:3, :3], pose[:3, 3])


def _weight(path: Path, element: Element, name: str, absent: str = "nan") -> float:
    """A mass or a moment: `absent` where it is missing, NaN where it is one word that is no number."""
    text = said(element, name)
    words = [absent] if text is None else text.split()
    if len(words) == 1 and not _is_number(words[0]):
        return math.nan
    return number(path, element, name, absent, is_finite=False)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _holder(parent: Element, child: Element) -> tuple[Element, str]:
    """Where a number stands, and how it is called there: <mass value="1"/> in URDF, <mass>1</mass> in SDF."""
    return (parent, str(child.tag)) if (child.text or "").strip() else (child, "value")


def _density(path: Path, links: Sequence[Link]) -> float | None:
    """kg/m^3: what SDF's, or in URDF Isaac Gym's, <density> says of the links; None if they say nothing.

    Raises:
      AssetError: they say different things.
    """
    parents = [
        each for link in links for tag in ("inertial", "collision") for each in link.element.findall(tag)
    ]
    said_of = {length(path, *_holder(each, child)) for each in parents for child in each.findall("density")}
    if len(said_of) > 1:
        raise AssetError(
            f"{path}: links of the densities {sorted(said_of)}", "one <density>, or a <mass> for each"
        )
    return next(iter(said_of), None)
