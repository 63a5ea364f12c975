"""Surfaces and collision parts of an asset as files."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.part_files import hull_of, obj_text, write_parts
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import SupportAsset


def object_folder(name: str) -> str:
    """Where an asset's files lie, relative to the export's folder."""
    return f"assets/objects/{name}"


SUPPORT_FOLDER = "assets/support"


def visual_name(index: int) -> str:
    """The file name of surface number `index`."""
    return f"visual-{index}.obj"


def drawn_pieces(asset: ObjectAsset) -> tuple[Piece, ...]:
    """The asset's coloured surfaces; its collision parts where it has none."""
    return asset.pieces or tuple(Piece(hull_of(part)) for part in asset.parts)


def write_object_meshes(folder: Path, asset: ObjectAsset) -> None:
    """Writes every part and every surface of an asset as OBJ."""
    write_parts(folder, asset)
    _write_pieces(folder, drawn_pieces(asset))


def write_support_meshes(folder: Path, support: SupportAsset) -> None:
    """Writes the support's surfaces, if it has any, as OBJ."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_pieces(folder, support.pieces)


def _write_pieces(folder: Path, pieces: tuple[Piece, ...]) -> None:
    for index, piece in enumerate(pieces):
        (folder / visual_name(index)).write_text(obj_text(piece.mesh), encoding="ascii")
