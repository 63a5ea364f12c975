"""One door for all formats: from a `Source` to a checked `Shape`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.readers.check import check_shape
from cluttergen_jax.assets.readers.mesh_file import read_mesh_file
from cluttergen_jax.assets.readers.mjcf import read_mjcf
from cluttergen_jax.assets.readers.source import ReadOptions, Source, find_sources
from cluttergen_jax.assets.readers.urdf import read_urdf
from cluttergen_jax.assets.readers.ycb import ycb_provenance
from cluttergen_jax.assets.shape import Provenance, Shape
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
    parts: tuple[Mesh, ...] | None = None
    notes: tuple[str, ...] = ()
    mass = options.mass
    if source.kind == "urdf":
        pieces, parts, notes = read_urdf(source.path, options.max_texture)
        up = "z"
    elif source.kind == "mjcf":
        pieces, parts, own_mass = read_mjcf(source.path, source.body, options.max_texture)
        mass, up = mass or own_mass * options.scale**3, "z"
    else:
        pieces, up, notes = read_mesh_file(source.path, options.max_texture)
    turn = _Y_TO_Z if (up if options.up == "auto" else options.up) == "y" else np.eye(3)
    turn = turn * options.scale
    shape = Shape(
        name=source.name,
        label=source.label,
        pieces=tuple(piece.transformed(turn, np.zeros(3)) for piece in pieces),
        provenance=source.provenance
        or ycb_provenance(source.path)
        or Provenance(_public_name(source.path), "not stated"),
        parts=None if parts is None else tuple(part.transformed(turn, np.zeros(3)) for part in parts),
        mass=mass,
        density=options.density,
        notes=notes,
    )
    check_shape(shape, source.path)
    return shape


def read_source(path: str | Path, options: ReadOptions | None = None) -> list[Shape]:
    """Reads every object that `path` holds; the first that cannot be read raises AssetError."""
    return [read_shape(source, options) for source in find_sources(path)]


def _public_name(path: Path) -> str:
    """The last three steps of a path: enough to recognise a file, without telling where a user keeps it."""
    return "/".join(path.resolve().parts[-3:])
