"""Collision shapes of files beside a mesh, as convex parts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh, joined
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.model import MAX_PARTS, Model, convex_parts


def with_kept_parts(model: Model, files: Sequence[Path]) -> Model:
    """A mesh file's model with the shapes of collision files as its parts, each connected piece a part.

    Args:
      files: in the frame of the mesh file.

    Raises:
      AssetError: a file cannot be read.
    """
    told = files[0].name if len(files) == 1 else f"{len(files)} files like {files[0].name}"
    shapes = [
        shape for file in files for shape in _connected([piece.mesh for piece in read_mesh_file(file).pieces])
    ]
    parts = convex_parts(shapes)
    if parts is None:
        why = "they are not convex" if len(shapes) <= MAX_PARTS else f"they are more than {MAX_PARTS}"
        note = f"the collision shapes of {told} were not kept: {why}"
    else:
        note = f"its collision parts are those of {told}"
    return Model(model.pieces, parts, model.stated, (*model.notes, note), model.density, tuple(shapes))


def _connected(meshes: list[Mesh]) -> list[Mesh]:
    """The connected pieces of a file's surfaces, corners at the same place being one."""
    whole = joined(meshes)
    welded = trimesh.Trimesh(whole.vertices, whole.faces, process=True)
    return [
        Mesh(np.asarray(each.vertices), np.asarray(each.faces))
        for each in welded.split(only_watertight=False)
    ]
