"""A triangle mesh as two arrays, and what its triangles alone tell and need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.geometry import unit

ORIGIN = np.zeros(3)
UV_DIGITS = 6
"""To which texture coordinates are one."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in some frame, in metres.

    Attributes:
      vertices: f64[V, 3].
      faces: i32[F, 3], counter-clockwise seen from outside. A convex part may leave its
        faces out (F = 0): its convex hull is meant.
    """

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", np.asarray(self.vertices, np.float64).reshape(-1, 3))
        object.__setattr__(self, "faces", np.asarray(self.faces, np.int32).reshape(-1, 3))

    @staticmethod
    def points(vertices: np.ndarray) -> Mesh:
        """The convex part spanned by `vertices`, f64[V, 3]."""
        return Mesh(vertices, np.zeros((0, 3), np.int32))

    @staticmethod
    def convex_parts(sets: Sequence[Sequence[Sequence[float]]]) -> tuple[Mesh, ...]:
        """The convex part spanned by each of several sets of vertices."""
        none = np.zeros((0, 3), np.int32)
        return tuple([Mesh(np.array(vertices, np.float64), none) for vertices in sets])

    @property
    def bounds(self) -> np.ndarray:
        """f64[2, 3]: the lower and the upper corner of the axis-aligned box."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @property
    def diagonal(self) -> float:
        """Metres across the axis-aligned box."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    @property
    def corners(self) -> np.ndarray:
        """f64[F, 3, 3]: the three points of each triangle."""
        return self.vertices[self.faces]

    @property
    def normals(self) -> np.ndarray:
        """f64[F, 3]: each triangle's normal, twice as long as its area."""
        corners = self.corners
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    @property
    def areas(self) -> np.ndarray:
        """f64[F]: twice each triangle's area."""
        return np.linalg.norm(self.normals, axis=1)

    @property
    def directions(self) -> np.ndarray:
        """f64[F, 3]: each triangle's normal of length 1; zero where it has no area."""
        return unit(self.normals)

    @property
    def decimals(self) -> int:
        """To which vertices are one: a millionth of what the mesh measures."""
        return 6 - int(np.floor(np.log10(max(float(np.ptp(self.vertices)), 1e-9))))

    @property
    def volume(self) -> float:
        """Cubic metres enclosed by a closed mesh, positive if its triangles face outwards."""
        a, b, c = (self.corners[:, i] - self.vertices.mean(0) for i in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    def hull(self) -> Mesh:
        """A convex part with its faces, counter-clockwise seen from outside."""
        from scipy.spatial import ConvexHull

        hull = ConvexHull(self.vertices)
        inward = (Mesh(self.vertices, hull.simplices).normals * hull.equations[:, :3]).sum(1) < 0
        faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
        return Mesh(self.vertices, faces)

    def transform(self, rotation: np.ndarray, translation: np.ndarray = ORIGIN) -> Mesh:
        """The mesh with every vertex v moved to rotation @ v + translation."""
        return Mesh(self.vertices @ np.asarray(rotation).T + np.asarray(translation), self.faces)


def join_meshes(meshes: list[Mesh] | tuple[Mesh, ...]) -> Mesh:
    """All triangles of several meshes as one mesh, nothing welded."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
    )


def clean_mesh(mesh: Mesh, is_closed: bool = False) -> Mesh:
    """The mesh with equal vertices welded; collapsed and doubled triangles and unused vertices dropped.

    Slivers stay: to drop one would open a closed surface. Of coinciding triangles one stays; of a surface
    that should be closed, a triangle and its reverse cancel out.
    """
    return weld(mesh, is_closed=is_closed)[0] if len(mesh.faces) else mesh


def weld(
    mesh: Mesh, uv: np.ndarray | None = None, is_closed: bool = False
) -> tuple[Mesh, np.ndarray]:
    """A mesh as `clean_mesh` leaves it, and i64[V], which vertex each of its vertices was.

    Args:
      uv: f[V, 2]: vertices of one place with other texture coordinates stay apart.
    """
    first, place = unique_rows(np.round(mesh.vertices, mesh.decimals))
    corners = place[mesh.faces]
    faces = corners
    if uv is not None:
        first, own = unique_rows(place, np.round(uv, UV_DIGITS))
        faces = own[mesh.faces]
    is_sound = (corners != np.roll(corners, 1, axis=1)).all(1)
    faces = faces[is_sound]
    corners = corners[is_sound]
    _, which = unique_rows(np.sort(corners, axis=1))
    if is_closed:
        turn = np.sign(_parity(corners))
        stays = np.bincount(which, turn)[which] * turn > 0
        which = which[stays]
        faces = faces[stays]
    faces = faces[np.sort(np.unique(which, return_index=True)[1])]
    used, faces = np.unique(faces, return_inverse=True)
    kept = first[used]
    return Mesh(mesh.vertices[kept], faces.reshape(-1, 3)), kept


def unique_rows(*columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the rows of columns side by side each once, in order.

    Returns:
      i64[U], where each comes first; i64[N], which of them each row is.
    """
    rows = np.column_stack(columns)
    _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, index.reshape(-1)


def component_labels(pairs: np.ndarray, count: int) -> np.ndarray:
    """i[count]: which of the sets that pairs, i[N, 2], connect each of so many things belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    return connected_components(links, directed=False)[1]


def shared_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the edges behind the corners i64[F, 3], numbered one after another, those of two triangles.

    Returns:
      i64[N, 2], the pairs of edges that are one; bool[3 F], which edges are in none.
    """
    start = faces.reshape(-1)
    end = np.roll(faces, -1, axis=1).reshape(-1)
    keys = np.minimum(start, end) * (faces.max(initial=0) + 1) + np.maximum(start, end)
    _, edge, number = np.unique(keys, return_inverse=True, return_counts=True)
    is_alone = number[edge.reshape(-1)] != 2
    order = np.argsort(edge.reshape(-1), kind="stable")
    return order[~is_alone[order]].reshape(-1, 2), is_alone


def _parity(faces: np.ndarray) -> np.ndarray:
    """Positive where a triangle's corners are an even permutation of their sorted order."""
    a, b, c = faces.T
    return np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)
