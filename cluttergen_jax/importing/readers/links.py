"""The links of a model, as URDF and SDF describe them: forms, meshes, looks, masses, as one rigid thing."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mass import MassProperties, combine_masses
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.finishes import Finisher
from cluttergen_jax.importing.readers.materials import GREY, Rgba
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.model import Model, convex_parts
from cluttergen_jax.importing.readers.opening import is_found_elsewhere, mesh_place, read_file
from cluttergen_jax.importing.readers.xml_tree import (
    Element,
    all_numbers,
    attribute_text,
    length,
    number,
    numbers,
    parse_numbers,
    wrong_attribute,
)

_ENDLESS = ("plane", "empty")
"""Forms that enclose nothing."""


@dataclass(frozen=True)
class SurfaceLook:
    """What a file says of a surface's looks.

    Attributes:
      colour: for what has none of its own; grey where the file says nothing.
      texture: for meshes that have texture coordinates and no image of their own.
      finish: for what has none of its own.
    """

    colour: Rgba = GREY
    texture: Texture | None = None
    finish: Finish | None = None


@dataclass(frozen=True)
class Surfaces:
    """Turns the geometry of links into pieces; remembers files, which visuals and collisions share.

    Attributes:
      path: the model's file.
      max_side: pixels; larger images are shrunk.
      named_by: what a mesh names its file by.
      forms: the tags that its geometry may have.
      notes: what was decided, in words; what is read adds to it.
    """

    path: Path
    max_side: int
    named_by: str = "filename"
    forms: tuple[str, ...] = ("mesh", "box", "cylinder", "sphere", "capsule")
    notes: list[str] = field(default_factory=list)
    _files: dict[tuple[Path, Texture | None], list[Piece]] = field(default_factory=dict)

    def pieces(
        self, element: Element, pose: np.ndarray, scale: float, look: SurfaceLook
    ) -> list[Piece]:
        """The pieces of a <visual> or <collision>, in the model's frame.

        Args:
          pose: f64[4, 4] from the element's frame to the model's.
          scale: factor on all lengths.

        Raises:
          AssetError: its geometry is none, or a file that it names is missing or cannot be read.
        """
        pieces = self._geometry(element, look.texture)
        if look.texture is not None and pieces and all(piece.texture is None for piece in pieces):
            self.notes.append(
                f"an image on a <{element.tag}> without texture coordinates is left out"
            )
        rotation = pose[:3, :3] * scale
        translation = pose[:3, 3] * scale
        return [
            replace(
                piece.transform(rotation, translation),
                rgba=look.colour if piece.rgba == GREY else piece.rgba,
                finish=piece.finish or self._with_maps_on(look.finish, piece),
            )
            for piece in pieces
        ]

    def _with_maps_on(self, finish: Finish | None, piece: Piece) -> Finish | None:
        """A finish as it can be on a piece: maps need texture coordinates, kept beside an image."""
        if finish is None or not finish.images or piece.uv is not None:
            return finish
        self.notes.append("the maps of a surface without an image on it are left out")
        return finish.without_maps

    @cached_property
    def finisher(self) -> Finisher:
        """Makes finishes; its notes are those of the model."""
        return Finisher(self.max_side, self.notes.append)

    def picture(self, name: str) -> Image.Image | None:
        """The image in a file that the model calls `name`, as it is; None, with a note, if there is none."""
        file = mesh_place(self.path, name)
        if file is None:
            self.notes.append(f"the image {name!r} is left out: it is not there")
            return None
        try:
            return Image.open(io.BytesIO(read_file(file)))
        except (AssetError, OSError, ValueError, Image.DecompressionBombError) as error:
            self.notes.append(f"the image {name!r} is left out: {error}")
            return None

    def image(self, name: str, file: Path | None) -> Texture | None:
        """The image in a file that the model calls `name`; None, with a note, if there is none."""
        if file is None:
            self.notes.append(f"the image {name!r} is left out: it is not there")
            return None
        try:
            with Image.open(file) as image:
                return Texture.of(image, self.max_side)
        except (AssetError, OSError, ValueError, Image.DecompressionBombError) as error:
            reason = error.given if isinstance(error, AssetError) else str(error)
            self.notes.append(f"the image {name!r} is left out: {reason}")
            return None

    def colour(self, element: Element, name: str) -> Rgba:
        """Three or four numbers as a colour; opaque where alpha is missing."""
        values = all_numbers(self.path, element, name)
        if len(values) not in (3, 4) or not np.isfinite(values).all():
            raise wrong_attribute(self.path, element, name, "3 or 4 numbers from 0 to 1")
        r, g, b, a = np.clip([*values, 1.0][:4], 0, 1).tolist()
        if [r, g, b, a] != [*values, 1.0][:4]:
            self.notes.append(f"the colour {attribute_text(element, name)!r} is clipped to 0 to 1")
        return (r, g, b, a)

    def _geometry(self, element: Element, texture: Texture | None) -> list[Piece]:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            raise AssetError(f"{self.path}: a <{element.tag}> without geometry")
        form = geometry[0]
        if len(geometry) > 1:
            self.notes.append(
                f"of {len(geometry)} shapes in one <geometry> the first is taken, <{form.tag}>"
            )
        if form.tag in _ENDLESS:
            self.notes.append(f"left out: <{element.tag}> of geometry <{form.tag}>")
            return []
        if form.tag not in self.forms:
            allowed = f"{', '.join(self.forms[:-1])} or {self.forms[-1]}"
            raise AssetError(f"{self.path}: geometry <{form.tag}>", allowed)
        if form.tag == "mesh":
            return self._mesh(form, texture)
        return [Piece(self._form(form), GREY)]

    def _form(self, form: Element) -> Mesh:
        if form.tag == "box":
            return primitives.box(self._sizes(form, "size") / 2)
        if form.tag == "ellipsoid":
            return primitives.ellipsoid(self._sizes(form, "radii"))
        if form.tag == "sphere":
            return primitives.ellipsoid(np.full(3, length(self.path, form, "radius")))
        radius, height = (length(self.path, form, name) for name in ("radius", "length"))
        make = primitives.cylinder if form.tag == "cylinder" else primitives.capsule
        return make(radius, height / 2)

    def _sizes(self, form: Element, name: str) -> np.ndarray:
        sizes = numbers(self.path, form, name, 3)
        if sizes.min() <= 0:
            raise wrong_attribute(self.path, form, name, "3 numbers above 0")
        return sizes

    def _mesh(self, form: Element, texture: Texture | None) -> list[Piece]:
        name = (attribute_text(form, self.named_by) or "").strip()
        if not name:
            raise AssetError(
                f"{self.path}: a <mesh> that names no file",
                f"one that is named by {self.named_by!r}",
            )
        if (part := form.find("submesh")) is not None:
            submesh = part.findtext("name", "").strip()
            raise AssetError(
                f"{self.path}: <submesh> {submesh!r} of {name!r}", "a mesh file as a whole"
            )
        if (file := mesh_place(self.path, name)) is None:
            raise AssetError(
                f"{self.path} names mesh file {name!r}, which is not there",
                hint="restoring the file",
            )
        if is_found_elsewhere(name, file):
            self.notes.append(
                f"for {name!r}, which is not there, {file.name} is taken from {file.parent.name}/"
            )
        if (file, texture) not in self._files:
            found = read_mesh_file(file, self.max_side, texture)
            self._files[file, texture] = found.pieces
            self.notes.extend(found.notes)
        factors = np.diag(self._scale(form))
        is_mirrored = np.linalg.det(factors) < 0
        out = []
        for piece in self._files[file, texture]:
            mesh = piece.mesh.transform(factors, np.zeros(3))
            mesh = Mesh(mesh.vertices, mesh.faces[:, ::-1]) if is_mirrored else mesh
            out.append(replace(piece, mesh=mesh))
        return out

    def _scale(self, form: Element) -> np.ndarray:
        """f64[3]: one number holds for all three axes, as Drake and PyBullet have it."""
        values = all_numbers(self.path, form, "scale", "1 1 1")
        factors = np.array(values * 3 if len(values) == 1 else values)
        if len(factors) != 3 or not np.isfinite(factors).all() or not factors.all():
            raise wrong_attribute(self.path, form, "scale", "1 or 3 numbers other than 0")
        return factors


def check_unique(path: Path, elements: Sequence[Element]) -> None:
    """Refuses two elements of one name, of which others could mean either (AssetError)."""
    names = [each.get("name", "") for each in elements]
    if twice := next((name for name in names if name and names.count(name) > 1), None):
        tag = elements[names.index(twice)].tag
        raise AssetError(f"{path}: two <{tag}> are called {twice!r}", "a name for each")


@dataclass(frozen=True)
class Link:
    """A link of a model."""

    element: Element  # Its <link>.
    pose: np.ndarray  # f64[4, 4], from the frame of `local` to the model.
    local: Callable[[Element], np.ndarray]  # f64[4, 4] from an element within.

    def place(self, element: Element) -> np.ndarray:
        """f64[4, 4] from an element within to the model."""
        return self.pose @ self.local(element)

    @property
    def name(self) -> str:
        return self.element.get("name", "")


def rigid(
    links: Sequence[Link],
    surfaces: Surfaces,
    look: Callable[[Element], SurfaceLook],
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
    made: dict[str, list[tuple[Piece, int]]] = {"visual": [], "collision": []}
    for tag, found in made.items():
        for place, link in enumerate(links):
            for element in link.element.findall(tag):
                pieces = surfaces.pieces(element, link.place(element), scale, look(element))
                found += [(piece, place) for piece in pieces]
    seen, solid = made.values()
    visuals, collisions = ([piece for piece, _ in each] for each in (seen, solid))
    if not visuals and not collisions:
        raise AssetError(f"{surfaces.path} has neither visual nor collision geometry")
    masses = [link_mass(surfaces.path, link) for link in links]
    stated = combine_masses([mass for mass in masses if mass is not None])
    own_notes = [*notes, *_weightless(links, masses)]
    link_of = [number for piece, number in seen if piece.rgba[3] > 0] or [
        number for _, number in seen or solid
    ]
    return Model(
        pieces=_visible(visuals, surfaces.notes) or collisions,
        link_of=tuple(link_of),
        parts=convex_parts([piece.mesh for piece in collisions]),
        stated=None if stated is None else stated.convert(np.eye(3), scale),
        notes=tuple(dict.fromkeys([*own_notes, *surfaces.notes])),
        density=_density(surfaces.path, links),
        colliding=tuple(piece.mesh for piece in collisions),
    )


def _visible(visuals: list[Piece], notes: list[str]) -> list[Piece]:
    """The visuals that can be seen; all of them, opaque, where none can."""
    seen = [piece for piece in visuals if piece.rgba[3] > 0]
    if len(seen) == len(visuals):
        return visuals
    if seen:
        notes.append(
            f"left out, as their alpha is 0: {len(visuals) - len(seen)} of {len(visuals)} surfaces"
        )
        return seen
    notes.append("drawn opaque although its alpha is 0, as nothing else is there to be seen")
    return [replace(piece, rgba=(*piece.rgba[:3], 1.0)) for piece in visuals]


def _weightless(links: Sequence[Link], masses: Sequence[MassProperties | None]) -> Iterator[str]:
    without = [
        link.name
        for link, mass in zip(links, masses, strict=True)
        if mass is None and link.element.find("visual") is not None
    ]
    if any(mass is not None for mass in masses) and without:
        yield f"its file states no mass for {', '.join(map(repr, without))}"


def link_mass(path: Path, link: Link) -> MassProperties | None:
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
    return body.transform(pose[:3, :3], pose[:3, 3])


def _weight(path: Path, element: Element, name: str, absent: str = "nan") -> float:
    """A mass or a moment: `absent` where it is missing, NaN where it is one word that is no number."""
    text = attribute_text(element, name)
    if text is not None and len(text.split()) == 1 and parse_numbers(text) is None:
        return math.nan
    return number(path, element, name, absent, is_finite=False)


def _holder(parent: Element, child: Element) -> tuple[Element, str]:
    """Where a number stands, and how it is called there: <mass value="1"/> in URDF, <mass>1</mass> in SDF."""
    return (parent, str(child.tag)) if (child.text or "").strip() else (child, "value")


def _density(path: Path, links: Sequence[Link]) -> float | None:
    """kg/m^3: what SDF's, or in URDF Isaac Gym's, <density> says of the links; None if they say nothing.

    Raises:
      AssetError: they say different things.
    """
    said_of = set()
    for link in links:
        for parent in (*link.element.findall("inertial"), *link.element.findall("collision")):
            for child in parent.findall("density"):
                said_of.add(length(path, *_holder(parent, child)))
    if len(said_of) > 1:
        raise AssetError(
            f"{path}: links of the densities {sorted(said_of)}",
            "one <density>, or a <mass> for each",
        )
    return next(iter(said_of), None)
