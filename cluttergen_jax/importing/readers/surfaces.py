"""The surfaces of a model's links, as URDF and SDF describe them: forms, meshes, colours, images."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.texture import Texture
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.materials import GREY, Rgba
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.numbers import all_numbers, length, numbers, said, wrong_attribute
from cluttergen_jax.importing.readers.places import is_found_elsewhere, mesh_place
from cluttergen_jax.importing.readers.xml_tree import Element

_ENDLESS = ("plane", "empty")
"""Forms that enclose nothing."""


@dataclass(frozen=True)
class Look:
    """What a file says of a surface's looks.

    Attributes:
      colour: for what has none of its own; grey where the file says nothing.
      texture: for meshes that have texture coordinates and no image of their own.
    """

    colour: Rgba = GREY
    texture: Texture | None = None


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

    def pieces(self, element: Element, pose: np.ndarray, scale: float, look: Look) -> list[Piece]:
        """The pieces of a <visual> or <collision>, in the model's frame.

        Args:
          pose: f64[4, 4] from the element's frame to the model's.
          scale: factor on all lengths.

        Raises:
          AssetError: its geometry is none, or a file that it names is missing or cannot be read.
        """
        pieces = self._geometry(element, look.texture)
        if look.texture is not None and pieces and all(piece.texture is None for piece in pieces):
            self.notes.append(f"an image on a <{element.tag}> without texture coordinates is left out")
        rotation, translation = pose[:3, :3] * scale, pose[:3, 3] * scale
        return [
            replace(
                piece.transformed(rotation, translation),
                rgba=look.colour if piece.rgba == GREY else piece.rgba,
            )
            for piece in pieces
        ]

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
            self.notes.append(f"the colour {said(element, name)!r} is clipped to 0 to 1")
        return (r, g, b, a)

    def _geometry(self, element: Element, texture: Texture | None) -> list[Piece]:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            raise AssetError(f"{self.path}: a <{element.tag}> without geometry")
        form = geometry[0]
        if len(geometry) > 1:
            self.notes.append(f"of {len(geometry)} shapes in one <geometry> the first is taken, <{form.tag}>")
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
        name = (said(form, self.named_by) or "").strip()
        if not name:
            raise AssetError(
                f"{self.path}: a <mesh> that names no file", f"one that is named by {self.named_by!r}"
            )
        if (part := form.find("submesh")) is not None:
            told = part.findtext("name", "").strip()
            raise AssetError(f"{self.path}: <submesh> {told!r} of {name!r}", "a mesh file as a whole")
        if (file := mesh_place(self.path, name)) is None:
            raise AssetError(
                f"{self.path} names mesh file {name!r}, which is not there", hint="restoring the file"
            )
        if is_found_elsewhere(name, file):
            self.notes.append(
                f"for {name!r}, which is not there, {file.name} is taken from {file.parent.name}/"
            )
        if (file, texture) not in self._files:
            self._files[file, texture], notes = read_mesh_file(file, self.max_side, texture)
            self.notes.extend(notes)
        factors = np.diag(self._scale(form))
        is_mirrored = np.linalg.det(factors) < 0
        out = []
        for piece in self._files[file, texture]:
            mesh = piece.mesh.transformed(factors, np.zeros(3))
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
