"""One door for all formats: from a `Source` to a checked `Shape`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluttergen_jax.assets.readers.check import check_shape
from cluttergen_jax.assets.readers.mesh_file import read_mesh_file
from cluttergen_jax.assets.readers.mjcf import read_mjcf
from cluttergen_jax.assets.readers.model import Model
from cluttergen_jax.assets.readers.source import ReadOptions, Source, find_sources
from cluttergen_jax.assets.readers.urdf import read_urdf
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.errors import AssetError

_Y_TO_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_shape(source: Source, options: ReadOptions | None = None) -> Shape:
    """Reads one object, scaled to metres, z up, its pieces not yet welded.

    Raises:
      AssetError: a file is missing or unreadable (the message names it), or the size is impossible.
    """
    options = options or ReadOptions()
    if options.up not in ("auto", "y", "z"):
        raise AssetError(f"up = {options.up!r}", "auto, y or z")
    model, up, mass_scale = _model(source, options)
    rotation = _Y_TO_Z if (up if options.up == "auto" else options.up) == "y" else np.eye(3)
    turn = rotation * options.scale
    notes = model.notes
    if source.kind != "mesh" and model.stated is None and options.mass is None:
        notes = (*notes, f"its file states no mass: it is its volume times {options.density:g} kg/m^3")
    shape = Shape(
        name=source.name,
        label=source.label,
        pieces=tuple(Piece(piece.mesh.transformed(turn, np.zeros(3)), piece.rgba) for piece in model.pieces),
        provenance=source.provenance or Provenance(_public_name(source.path), "not stated"),
        parts=None
        if model.parts is None
        else tuple(part.transformed(turn, np.zeros(3)) for part in model.parts),
        mass=options.mass,
        density=options.density,
        stated=None if model.stated is None else model.stated.scaled(rotation, options.scale, mass_scale),
        notes=notes,
    )
    check_shape(shape, source.path)
    return shape


def _model(source: Source, options: ReadOptions) -> tuple[Model, str, float]:
    """What the file holds, which of its axes is up, and the factor on its masses.

    In URDF a mass is written as it is; most of MJCF's are a density times a volume, which keeps its density.
    """
    if source.kind == "urdf":
        return read_urdf(source.path), "z", 1.0
    if source.kind == "mjcf":
        return read_mjcf(source.path, source.body), "z", options.scale**3
    pieces, up = read_mesh_file(source.path)
    return Model(pieces, None, None), up, 1.0


def read_source(path: str | Path, options: ReadOptions | None = None) -> list[Shape]:
    """Reads every object that `path` holds; the first that cannot be read raises AssetError."""
    return [read_shape(source, options) for source in find_sources(path)]


def _public_name(path: Path) -> str:
    """The last three steps of a path: enough to recognise a file, without telling where a user keeps it."""
    return "/".join(path.resolve().parts[-3:])
