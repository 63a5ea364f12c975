"""Surfaces and collision parts of an asset as files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from cluttergen_jax.assets.obj import mesh_text, part_name, shaded_text, write_parts
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import SHARED_IMAGES, write_images
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset


def object_folder(name: str) -> str:
    """Where an asset's files lie, relative to the export's folder."""
    return f"assets/objects/{name}"


def category(asset: ObjectAsset) -> str:
    """What kind of thing an asset is, in one word of a-z, 0-9 and _: that of its synset, or its own name."""
    return _NO_WORD.sub("_", (asset.synset.partition(".")[0] or asset.name).lower())


def registry_folder(asset: ObjectAsset) -> str:
    """Where RoboCasa looks for an asset: objects/REGISTRY/CATEGORY/OBJECT."""
    return f"objects/cluttergen/{category(asset)}/{asset.name}"


def usd_folder(asset: ObjectAsset) -> str:
    """Where an object's USD lies: SimReady asks for a folder between it and the one called as the object."""
    return f"{object_folder(asset.name)}/usd"


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


_NO_WORD = re.compile("[^a-z0-9]+")


SUPPORT_FOLDER = "assets/support"


def visual_name(index: int) -> str:
    """The file name of surface number `index`."""
    return f"visual-{index}.obj"


def drawn_pieces(asset: ObjectAsset) -> tuple[Piece, ...]:
    """The asset's coloured surfaces; its collision parts where it has none."""
    return asset.pieces or tuple(Piece(part.hull()) for part in asset.parts)


def object_image(piece: Piece) -> str | None:
    """Where the image of an object's surface lies, relative to the object's folder; None if it has none."""
    return None if piece.texture is None else SHARED_IMAGES + piece.texture.file_name


def own_image(piece: Piece) -> str | None:
    """The same where images lie in an own folder: of supports, and of objects in USD."""
    return None if piece.texture is None else piece.texture.file_name


def write_object_images(folder: Path, asset: ObjectAsset) -> None:
    """Writes the images of an asset whose folder is `folder` to where all objects keep theirs, each once."""
    write_images(folder.parent.parent / "textures", asset.textures)


def write_support_images(folder: Path, support: SupportAsset) -> None:
    """Writes the images of the support whose folder is `folder`."""
    write_images(folder, (piece.texture for piece in support.pieces if piece.texture is not None))


def write_object_meshes(folder: Path, asset: ObjectAsset) -> None:
    """Writes every part of an asset as OBJ, and every surface, with its material and image if it has one."""
    write_parts(folder, asset)
    for index, piece in enumerate(drawn_pieces(asset)):
        _write_piece(folder, index, piece, object_image(piece))
    write_object_images(folder, asset)


def write_support_meshes(folder: Path, support: SupportAsset) -> None:
    """Writes the support's parts and surfaces as OBJ, with materials and images as those of objects."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, part in enumerate(support.parts):
        (folder / part_name(index)).write_text(mesh_text(part.hull()), encoding="ascii")
    for index, piece in enumerate(support.pieces):
        _write_piece(folder, index, piece, own_image(piece))
    write_support_images(folder, support)


def _write_piece(folder: Path, index: int, piece: Piece, image: str | None) -> None:
    # Normals because Drake draws no OBJ without them.
    path = folder / visual_name(index)
    if image is None:
        path.write_text(shaded_text(piece), encoding="ascii")
        return
    library = path.with_suffix(".mtl")
    name = f"image-{index}"
    path.write_text(shaded_text(piece, (library.name, name)), encoding="ascii")
    colour = " ".join(f"{value:.6g}" for value in piece.rgba[:3])
    library.write_text(
        f"newmtl {name}\nKa {colour}\nKd {colour}\nKs 0 0 0\nd {piece.rgba[3]:.6g}\nmap_Kd {image}\n",
        encoding="ascii",
    )
