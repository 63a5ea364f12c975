"""Collision parts as OBJ files, for the MJCF of whole scenes and for other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset


def part_name(index: int) -> str:
    """The file name of part number `index`."""
    return f"part-{index:02d}.obj"


def hull_of(part: Mesh) -> Mesh:
    """A convex part with its faces, counter-clockwise seen from outside."""
    hull = ConvexHull(part.vertices)
    corners = part.vertices[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(1) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh(part.vertices, faces)


def write_parts(folder: Path, asset: ObjectAsset) -> None:
    """Writes every part of an asset into `folder`, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, part in enumerate(asset.parts):
        (folder / part_name(index)).write_text(obj_text(hull_of(part)), encoding="ascii")


def obj_text(mesh: Mesh) -> str:
    """A mesh as OBJ, vertices to eight digits."""
    lines = [f"v {x:.8g} {y:.8g} {z:.8g}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return "\n".join(lines) + "\n"
