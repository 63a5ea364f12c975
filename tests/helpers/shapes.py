"""Small shapes for the tests of bodies and imports."""

import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, Quality, RestingPose
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


def save_box(path, side=0.05):
    """A cube's mesh file, with the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((side, side, side)).export(path)


CUBE_FACES = [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5],
              [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip


def make_box(name="box", half=(0.03, 0.02, 0.041234567), seed=0):
    """A box of the given half extents as an asset; its cloud is drawn from the seed."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-1, 1, (CLOUD_SIZE, 3)).astype(np.float32) * np.array(half, np.float32)
    x, y, z = np.square(half)
    return ObjectAsset(
        name=name,
        label="a box",
        pieces=(Piece(Mesh(corners, CUBE_FACES), (0.1, 0.2, 0.3, 1.0)),),
        parts=(Mesh.points(corners),),
        mass=0.25,
        center_of_mass=np.zeros(3),
        inertia=np.diag([y + z, x + z, x + y]) * 0.25 / 3,
        cloud=cloud,
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), half[2], 0.75),),
        provenance=Provenance("a test", "CC0"),
        quality=Quality(deviation=0.01, solo_rate=1.0, solo_trials=256, solo_steps=22.5),
        flags=("a flag",),
    )
