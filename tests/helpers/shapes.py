"""Small shapes for the tests of bodies and imports."""

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Cavity, Piece, Provenance, Shape
from cluttergen_jax.importing.readers.primitives import box

SOURCE = Provenance("a test", "CC0")


def slab(half, center=(0.0, 0.0, 0.0)):
    """A box as a mesh."""
    mesh = box(np.array(half, float))
    return Mesh(mesh.vertices + np.array(center), mesh.faces)


def shape_of(*meshes, name="thing", **kwargs):
    """A shape whose pieces are meshes."""
    return Shape(name, name, tuple(Piece(mesh) for mesh in meshes), SOURCE, **kwargs)


def open_box_slabs(half=(0.05, 0.04, 0.03), wall=0.003):
    """A box without a lid as five overlapping slabs; `wall` is half a wall's thickness."""
    x, y, z = half
    slabs = [slab((x, y, wall), (0, 0, wall))]
    slabs += [slab((wall, y, z), (side * (x - wall), 0, z)) for side in (-1, 1)]
    return slabs + [slab((x, wall, z), (0, side * (y - wall), z)) for side in (-1, 1)]


def open_box(own_parts=True, **kwargs):
    """A box without a lid, with its cavity and, if asked for, its own parts."""
    slabs = open_box_slabs()
    cavity = Cavity(slab((0.044, 0.034, 0.027), (0, 0, 0.033)), (0.0, 0.0, 0.06))
    parts = tuple(Mesh.points(each.vertices) for each in slabs) if own_parts else None
    return shape_of(*slabs, name="tray", parts=parts, cavity=cavity, **kwargs)
