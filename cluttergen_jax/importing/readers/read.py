"""One door for all formats: from a `ObjectFile` to a checked `Shape`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from cluttergen_jax.assets.folds import without_folds
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.shape import Piece, Provenance, Shape, rotate_meshes
from cluttergen_jax.assets.visuals import bake_colours
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.mjcf import read_mjcf
from cluttergen_jax.importing.readers.model import MAX_PARTS, Model, convex_parts
from cluttergen_jax.importing.readers.sdf import read_sdf
from cluttergen_jax.importing.readers.source import (
    AUTO,
    AXES,
    ObjectFile,
    ReadOptions,
    own_up,
    turn_of,
)
from cluttergen_jax.importing.readers.things import read_thing
from cluttergen_jax.importing.readers.tree import find_sources, ycb_provenance
from cluttergen_jax.importing.readers.urdf import read_urdf

MIN_SIZE = 0.005
MAX_SIZE = 2.0
# Metres across that furniture may measure: at least, at most where its file's unit is known, and at most of
# others.
MIN_FURNITURE = 0.1
MAX_FURNITURE = 10.0
MAX_UNSTATED = 4.0

NOT_STATED = "not stated"
"""The licence of files that have none."""
_UNITS = {
    "millimetres": 0.001,
    "centimetres": 0.01,
    "inches": 0.0254,
    "tenths of a millimetre": 0.0001,
}


def read_shape(
    source: ObjectFile,
    options: ReadOptions | None = None,
    joints: Mapping[str, float] | None = None,
    largest: float = MAX_SIZE,
    smallest: float = MIN_SIZE,
    is_whole: bool = True,
) -> Shape:
    """Reads one object, scaled to metres, z up, its pieces not yet welded.

    Args:
      joints: where joints of a URDF or MJCF file are to be, metres or degrees; given for furniture
        (`read_mjcf`).
      largest, smallest: metres across that it may measure, at most and at least.
      is_whole: whether a mesh file is taken whole, whatever it holds (`read_thing`).

    Raises:
      AssetError: a file is missing or unreadable (the message names it), or the size is impossible.
      ConfigError: there is no such joint, or it does not go so far.
    """
    options = options or ReadOptions()
    model = _model(source, options, joints, is_whole)
    # In URDF and SDF a mass is written as it is; most of MJCF's are a density times a volume, which it keeps.
    mass_scale = options.scale**3 if source.kind == "mjcf" else 1.0
    own = own_up(source.path, source.kind)
    rotation = turn_of(options.up if options.up in AXES else own.axis, options.front)
    turn = rotation * options.scale * np.array(source.stretch)
    notes = (*source.decisions, *model.notes)
    density = options.density if model.density is None else model.density
    mass, stated = (None, None) if options.mass == "volume" else (options.mass, model.stated)
    if stated is not model.stated:
        reason = "the mass that its file states is not asked for"
        notes = (*notes, f"{reason}: it is its volume times {density:g} kg/m^3")
    elif source.kind != "mesh" and stated is None and mass is None:
        what = "mass" if model.density is None else "mass but a density"
        notes = (*notes, f"its file states no {what}: it is its volume times {density:g} kg/m^3")
    pieces = tuple(_unfold(piece) for piece in model.pieces)
    if any(piece is not before for piece, before in zip(pieces, model.pieces, strict=True)):
        notes = (*notes, "its surface lay flat over itself in places: they are cut anew")
    pieces = bake_colours(pieces, options.max_texture)
    kept = () if joints is None else model.joints
    moved = (each.transform(rotation, options.scale, np.zeros(3), mass_scale) for each in kept)
    shape = Shape(
        name=source.name,
        label=source.label,
        pieces=tuple(piece.transform(turn, np.zeros(3)) for piece in pieces),
        provenance=_provenance(source, options),
        synset=source.synset,
        parts=None if model.parts is None else rotate_meshes(model.parts, turn),
        mass=mass,
        density=density,
        stated=None if stated is None else stated.convert(rotation, options.scale, mass_scale),
        friction=options.friction,
        scale=options.scale,
        notes=notes,
        colliding=rotate_meshes(model.colliding, turn),
        is_pose_free=options.up == options.front == AUTO,
        stated_up=f"{own.axis} up, {own.reason}" if own.is_stated else "",
        is_from_file=True,
        keeps_parts=bool(source.parts),
        joints=tuple(moved),
    )
    _check_size(shape, source.path, smallest, largest)
    return shape


def _model(
    source: ObjectFile, options: ReadOptions, joints: Mapping[str, float] | None, is_whole: bool
) -> Model:
    side = options.max_texture
    if source.kind == "mjcf":
        return read_mjcf(source, side, joints)
    if source.kind == "urdf":
        return read_urdf(source, side, joints)
    if joints:
        raise ConfigError(
            f"joints of {source.path.name} ({source.kind})",
            "those of a URDF or MJCF file",
            "no `joint`",
        )
    if source.kind == "sdf":
        return read_sdf(source, side)
    file = read_thing(source.path, side, source.body, is_whole)
    model = Model(file.pieces, None, None, file.notes)
    return with_kept_parts(model, source.parts) if source.parts else model


def read_source(path: str | Path, options: ReadOptions | None = None) -> list[Shape]:
    """Reads every object that `path` holds; the first that cannot be read raises AssetError."""
    return [read_shape(source, options) for source in find_sources(path)]


def _unfold(piece: Piece) -> Piece:
    mesh = piece.mesh
    # `_check_size` reports vertices that are not finite.
    mended = without_folds(mesh, piece.uv) if np.isfinite(mesh.vertices).all() else mesh
    return piece if mended is mesh else replace(piece, mesh=mended)


def _provenance(source: ObjectFile, options: ReadOptions) -> Provenance:
    """The source's own terms, but for those that the user states."""
    known = source.provenance or ycb_provenance(source.path)
    own = known or Provenance(public_path(source.path), NOT_STATED)
    return replace(
        own,
        licence=options.licence or own.licence,
        attribution=options.attribution or own.attribution,
        outside=source.outside,
    )


def public_path(path: Path) -> str:
    """The last three steps of a path: enough to recognise a file, without telling where a user keeps it."""
    return "/".join(path.resolve().parts[-3:])


def _check_size(shape: Shape, path: Path, smallest: float, largest: float) -> None:
    """Raises AssetError if the shape is empty, not finite, or its largest side is not that of an object."""
    meshes = [piece.mesh for piece in shape.pieces]
    if not any(len(mesh.faces) for mesh in meshes):
        raise AssetError(f"{path} holds no triangles", "a surface mesh, not points or curves")
    whole = join_meshes(meshes)
    if not np.isfinite(whole.vertices).all():
        raise AssetError(f"{path} has vertices that are not finite numbers")
    used = whole.vertices[np.unique(whole.faces)]
    size = float(np.ptp(used, axis=0).max())
    if not smallest <= size <= largest:
        raise AssetError(
            f"{path}: {shape.label!r} is {size:.3g} m across",
            f"a largest side between {smallest * 1000:g} mm and {largest:g} m",
            _likely_cause(size, smallest, path),
        )


def _likely_cause(size: float, smallest: float, path: Path) -> str:
    """Which unit would make this an object of 2 cm to 60 cm, or furniture; how to say so of all or of one."""
    is_furniture = smallest >= MIN_FURNITURE
    usual = (0.15, MAX_UNSTATED) if is_furniture else (0.02, 0.6)
    if size < smallest:
        return "`scale` with the factor to metres; a scale may have been applied twice"
    whose = "the file is" if is_furniture else "all files are"
    fitting = [
        (factor, f"scale={factor:g} if {whose} in {unit} ({size * factor:.2g} m across)")
        for unit, factor in _UNITS.items()
        if usual[0] <= size * factor <= usual[1]
    ]
    if not fitting:
        return "`scale` with the factor from the file's unit to metres"
    every = " or ".join(text for _, text in fitting)
    if is_furniture:
        return every
    # A dotted key of TOML: one line, which comes before any table.
    alone = f'"{path.name}".scale = {fitting[0][0]:g}'
    return f"{every}; for this file alone, the line {alone} at the top of objects.toml in the imported folder"


def with_kept_parts(model: Model, files: Sequence[Path]) -> Model:
    """A mesh file's model with the shapes of collision files as its parts, each connected piece a part.

    Args:
      files: in the frame of the mesh file.

    Raises:
      AssetError: a file cannot be read.
    """
    named = files[0].name if len(files) == 1 else f"{len(files)} files like {files[0].name}"
    shapes = [
        shape
        for file in files
        for shape in _connected_pieces([piece.mesh for piece in read_mesh_file(file).pieces])
    ]
    parts = convex_parts(shapes)
    if parts is None:
        why = (
            "they are not convex" if len(shapes) <= MAX_PARTS else f"they are more than {MAX_PARTS}"
        )
        note = f"the collision shapes of {named} were not kept: {why}"
    else:
        note = f"its collision parts are those of {named}"
    return replace(model, parts=parts, notes=(*model.notes, note), colliding=tuple(shapes))


def _connected_pieces(meshes: list[Mesh]) -> list[Mesh]:
    """The connected pieces of a file's surfaces, corners at the same place being one."""
    whole = join_meshes(meshes)
    welded = trimesh.Trimesh(whole.vertices, whole.faces, process=True)
    return [
        Mesh(np.asarray(each.vertices), np.asarray(each.faces))
        for each in welded.split(only_watertight=False)
    ]
