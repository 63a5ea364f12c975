"""What every format writes of a body: surfaces and solids, their files, inertia, friction, names, numbers.

MuJoCo takes the friction of the object that has one of its own (`assets.mjcf.own_contact`). `factor_of`,
`mean_of` and `harmonic_of` make another simulator's combination of such an object with the support, or with
an object of the default friction, come out the same. Two objects with their own are combined by its rule.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from cluttergen_jax.assets.mjcf import own_contact
from cluttergen_jax.assets.obj import mesh_text, part_name, shaded_text
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import SHARED_IMAGES, write_images
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.assets.support import PART_RGBA, Box, SupportAsset
from cluttergen_jax.config import ContactConfig

SUPPORT_FOLDER = "assets/support"
_NO_WORD = re.compile("[^a-z0-9]+")
_LARGEST = 100.0
"""Stands for a coefficient that a simulator's rule cannot reach."""


def object_folder(asset: ObjectAsset) -> str:
    """Where an asset's files lie, relative to the export's folder."""
    return f"assets/objects/{asset.name}"


def category(asset: ObjectAsset) -> str:
    """What kind of thing an asset is, in one word of a-z, 0-9 and _: that of its synset, or its own name."""
    return _NO_WORD.sub("_", (asset.synset.partition(".")[0] or asset.name).lower())


def registry_folder(asset: ObjectAsset) -> str:
    """Where RoboCasa looks for an asset: objects/REGISTRY/CATEGORY/OBJECT."""
    return f"objects/cluttergen/{category(asset)}/{asset.name}"


def usd_folder(asset: ObjectAsset) -> str:
    """Where an object's USD lies: SimReady asks for a folder between it and the one called as the object."""
    return f"{object_folder(asset)}/usd"


def identifier(name: str) -> str:
    """A name as USD and Python allow it."""
    own = re.sub("[^A-Za-z0-9_]", "_", name)
    return f"_{own}" if own[:1].isdigit() else own


def identifiers(names: Sequence[str]) -> list[str]:
    """Names as `identifier` makes them, still unique."""
    result: list[str] = []
    for name in names:
        own = identifier(name)
        while own in result:
            own += "_"
        result.append(own)
    return result


class VisualShape(NamedTuple):
    """What is seen of a body: a piece, an OBJ file of its folder.

    Attributes:
      name: in formats; its file is called so too.
      image: where its image lies, relative to the folder; None if it has none.
      normal: likewise its map of normals.
    """

    name: str
    piece: Piece
    image: str | None
    normal: str | None = None

    @property
    def file(self) -> str:
        """Its OBJ file."""
        return f"{self.name}.obj"


class CollisionShape(NamedTuple):
    """What a body collides with: a box, or a convex part, an OBJ file of its folder.

    Attributes:
      name: in formats.
      rgba: where it is drawn.
      file: of a part, "" of a box; box: likewise, None of a part.
    """

    name: str
    rgba: tuple[float, float, float, float]
    file: str = ""
    box: Box | None = None


def surfaces_of(body: ObjectAsset | SupportAsset) -> list[VisualShape]:
    """The coloured surfaces; of an object without any its collision parts.

    Images of objects lie in a folder that all share, those of the support in its own.
    """
    pieces = body.pieces
    folder = ""
    if isinstance(body, ObjectAsset):
        pieces = body.drawn_pieces
        folder = SHARED_IMAGES
    return [
        VisualShape(
            f"visual-{index}",
            piece,
            _image_file(folder, piece.texture),
            _image_file(folder, piece.finish.normal if piece.finish else None),
        )
        for index, piece in enumerate(pieces)
    ]


def _image_file(folder: str, image: Texture | None) -> str | None:
    return None if image is None else folder + image.file_name


def solids_of(body: ObjectAsset | SupportAsset) -> list[CollisionShape]:
    """The boxes and the parts."""
    boxes = body.boxes if isinstance(body, SupportAsset) else ()
    solids = [CollisionShape(f"box-{index}", box.rgba, box=box) for index, box in enumerate(boxes)]
    return solids + [
        CollisionShape(f"part-{index}", PART_RGBA, part_name(index))
        for index in range(len(body.parts))
    ]


def shows_solids(body: ObjectAsset | SupportAsset) -> bool:
    """Whether solids are drawn, too: those of a support without surfaces."""
    return isinstance(body, SupportAsset) and not body.pieces


def write_meshes(folder: Path, body: ObjectAsset | SupportAsset) -> None:
    """Writes every part as OBJ, and every surface, with its material and image if it has one."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, part in enumerate(body.parts):
        (folder / part_name(index)).write_text(mesh_text(part.hull()), encoding="ascii")
    for surface in surfaces_of(body):
        _write_surface(folder, surface)
    images = folder.parents[1] / "textures" if isinstance(body, ObjectAsset) else folder
    write_images(images, [image for each in body.pieces for image in each.images])


def _write_surface(folder: Path, surface: VisualShape) -> None:
    # Normals because Drake draws no OBJ without them.
    path = folder / surface.file
    piece = surface.piece
    if surface.image is None and piece.finish is None:
        path.write_text(shaded_text(piece), encoding="ascii")
        return
    library = path.with_suffix(".mtl")
    name = surface.name.replace("visual", "image")
    path.write_text(shaded_text(piece, (library.name, name)), encoding="ascii")
    colour = " ".join(f"{value:.6g}" for value in piece.rgba[:3])
    lines = [
        f"newmtl {name}",
        f"Ka {colour}",
        f"Kd {colour}",
        *_finish_lines(surface),
        f"d {piece.rgba[3]:.6g}",
        *([] if surface.image is None else [f"map_Kd {surface.image}"]),
    ]
    library.write_text("\n".join(lines) + "\n", encoding="ascii")


def _finish_lines(surface: VisualShape) -> list[str]:
    """What MTL says of gloss: for every reader in `Ks` and `Ns`, for newer ones in `Pr`, `Pm` and `norm`.

    It has no map of roughness and metalness in one: their means are written.
    """
    finish = surface.piece.finish
    if finish is None:
        return ["Ks 0 0 0"]
    mean = finish.without_maps
    return [
        f"Ks {' '.join(3 * [f'{finish.specular:.6g}'])}",
        f"Ns {finish.exponent:.6g}",
        f"Pr {mean.roughness:.6g}",
        f"Pm {mean.metallic:.6g}",
        *([] if surface.normal is None else [f"norm {surface.normal}"]),
    ]


@dataclass(frozen=True, eq=False)
class Principal:
    """A body's inertia along its principal axes.

    Attributes:
      center: f64[3], the centre of mass in the object frame, metres.
      turn: f64[4], the principal frame in the object frame, wxyz.
      moments: f64[3], kg m^2.
    """

    center: np.ndarray
    turn: np.ndarray
    moments: np.ndarray


def principal_of(asset: ObjectAsset) -> Principal:
    """The principal frame of an asset: of the 24 the one that is turned least from the object frame."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.transform import Rotation

    moments, axes = np.linalg.eigh(np.asarray(asset.inertia, np.float64))
    _, order = linear_sum_assignment(-np.abs(axes))
    moments = moments[order]
    axes = axes[:, order]
    axes *= np.where(np.diag(axes) < 0, -1.0, 1.0)
    axes[:, np.argmin(np.diag(axes))] *= np.sign(np.linalg.det(axes))
    turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return Principal(np.asarray(asset.center_of_mass, np.float64), turn, moments)


def text(values: Sequence[float] | np.ndarray) -> str:
    """Numbers with the nine digits that a float32 needs, parted by blanks."""
    return " ".join(f"{value:.9g}" for value in np.asarray(values, np.float64).ravel() + 0.0)


def xml_bytes(root: ET.Element) -> bytes:
    """An XML file, indented, behind a declaration."""
    ET.indent(root)
    return b'<?xml version="1.0"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def friction_of(asset: ObjectAsset, contact: ContactConfig) -> tuple[float, float, float]:
    """Sliding, torsional and rolling coefficients of the object: its own, or the contact's."""
    if asset.friction is None:
        return contact.friction
    return own_contact(asset.friction, contact.friction)[0]


def factor_of(wanted: float, default: float) -> float:
    """For simulators that multiply two coefficients (Bullet): all others have the default's square root."""
    return wanted / math.sqrt(default)


def mean_of(wanted: float, default: float) -> float:
    """For simulators that take the mean of two coefficients (PhysX by default); at least 0."""
    return max(2 * wanted - default, 0.0)


def harmonic_of(wanted: float, default: float) -> float:
    """For simulators that take 2 a b / (a + b) of two coefficients a, b (Drake)."""
    rest = 2 * default - wanted
    return min(wanted * default / rest, _LARGEST) if rest > 0 else _LARGEST
