"""One mesh as a body, without a pool: as it stands in its file, and where its own frame is in the body's."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.body import make_object
from cluttergen_jax.assets.cloud import surface_cloud
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.assets.solid import solid_of
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.readers.read import MAX_SIZE, MIN_SIZE
from cluttergen_jax.importing.readers.source import own_up, turn_of
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import Problem, ProblemConfig, compose

_FORMS = (
    "a file that `cluttergen import` reads, a mesh with `vertices` f[V, 3] and `faces` i[F, 3] "
    "(trimesh), or an object of a pool"
)


def problem_alone(asset: ObjectAsset, support: SupportAsset, region: Rectangle) -> Problem:
    """The placement of one object alone in a region of a support."""
    config = ProblemConfig(
        objects=(asset.name,),
        region=region,
        engine="native",
        num_threads=1,
        placement=PlacementConfig(num_objects=1),
    )
    return compose([asset], support, config)


def body_of(mesh: Any) -> tuple[ObjectAsset, np.ndarray]:
    """The body of a mesh, and T_object_mesh, f64[4, 4]; made once in a process.

    It keeps the pose of its file; what does not stand so falls over, and `T_object_mesh` says how far.

    Args:
      mesh: the path of one object's file; what has `vertices` f[V, 3] (metres, z up) and `faces` i[F, 3]; or
        an object of a pool, whose frame is the body's.

    Raises:
      AssetError: it is none of these, nothing with a volume can be made of it, or its size is impossible.
    """
    if isinstance(mesh, ObjectAsset):
        return mesh, np.eye(4)
    if isinstance(mesh, str | Path):
        path = Path(mesh)
        changed = path.stat().st_mtime_ns if path.is_file() else 0
        return _of_file(str(mesh), changed)
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        vertices = np.ascontiguousarray(mesh.vertices, np.float64)
        faces = np.ascontiguousarray(mesh.faces, np.int64)
        return _of_arrays(_Arrays(vertices, faces))
    raise AssetError(f"a mesh that is a {type(mesh).__name__}", _FORMS)


@lru_cache(maxsize=64)
def _of_file(path: str, changed: int) -> tuple[ObjectAsset, np.ndarray]:
    sources = find_sources(path)
    if len(sources) != 1:
        names = ", ".join(each.name for each in sources[:5])
        raise AssetError(f"{path}: {len(sources)} objects ({names})", "the file of one object")
    (source,) = sources
    T_shape_file = np.eye(4)
    T_shape_file[:3, :3] = turn_of(own_up(source.path, source.kind).axis)
    asset, T_object_shape = _of_shape(read_shape(source, ReadOptions(up="file")))
    return asset, T_object_shape @ T_shape_file


class _Arrays:
    """A mesh that equals another of the same numbers."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = vertices
        self.faces = faces
        self.digest = hashlib.sha256(vertices.tobytes() + faces.tobytes()).hexdigest()

    def __hash__(self) -> int:
        return hash(self.digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Arrays) and other.digest == self.digest


@lru_cache(maxsize=64)
def _of_arrays(mesh: _Arrays) -> tuple[ObjectAsset, np.ndarray]:
    vertices = mesh.vertices
    faces = mesh.faces
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.isfinite(vertices).all():
        raise AssetError(
            f"a mesh whose vertices are {vertices.shape}", f"f[V, 3], finite: {_FORMS}"
        )
    is_of_faces = faces.ndim == 2 and faces.shape[1:] == (3,) and len(faces) > 0
    if not is_of_faces or faces.min() < 0 or faces.max() >= len(vertices):
        raise AssetError(
            f"a mesh whose faces are {faces.shape}", f"i[F, 3], numbers of vertices: {_FORMS}"
        )
    size = float(np.ptp(vertices, axis=0).max())
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise AssetError(
            f"a mesh of {size:g} m across",
            f"{MIN_SIZE} to {MAX_SIZE} m",
            "vertices in metres: millimetres times 0.001",
        )
    piece = Piece(Mesh(vertices, faces))
    shape = Shape(
        "object", "object", (piece,), Provenance("own mesh", "not stated"), is_from_file=True
    )
    return _of_shape(shape)


def _of_shape(shape: Shape) -> tuple[ObjectAsset, np.ndarray]:
    """The body and T_object_shape, found by points that go with it: surfaces may be simplified."""
    asset = make_object(shape)
    before = surface_cloud(solid_of([piece.mesh for piece in shape.pieces]))
    after = np.asarray(asset.cloud, np.float64)
    u, _, vt = np.linalg.svd((after - after.mean(0)).T @ (before - before.mean(0)))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    T = np.eye(4)
    T[:3, :3] = turn
    T[:3, 3] = after.mean(0) - turn @ before.mean(0)
    return asset, T
