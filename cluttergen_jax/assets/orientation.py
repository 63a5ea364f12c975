"""Which way visual surfaces face: outwards, and both ways where both sides of a sheet can be seen.

Drawing programs leave out what faces away from the camera, and light it from the wrong side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_faces
from cluttergen_jax.assets.mesh import Mesh, component_labels, shared_edges, unique_rows
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.solid import Solid
from cluttergen_jax.geometry import unit

_NUM_SAMPLES = 100_000
# A surface this far from the solid's own, over the diagonal, is hidden inside it.
_NEAR = 0.02
# Where less than this share of a patch agrees more than disagrees with the solid, it is a sheet.
_CLEAR = 0.35
# A patch with holes of less than this share of its area counts as closed.
_MAX_HOLES = 0.01
_GAPING = 0.1
# What is seen of less than this share of a patch is too little to tell.
_MIN_SEEN = 0.05
_THICKNESS = 0.0002
_SPOTS = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])


@dataclass(frozen=True, eq=False)
class Skin:
    """Points of a solid's surface, f64[N, 3] in a tree, and the directions in which it faces, f64[N, 3]."""

    tree: cKDTree
    normals: np.ndarray
    reach: float  # Metres within which a surface is taken for a part of the skin.
    is_exact: bool  # See `Solid`.

    @staticmethod
    def of(solid: Solid) -> Skin:
        """The skin of a solid, to 1 mm or so on an object of 30 cm."""
        points, faces, _ = sample_faces(solid.mesh, _NUM_SAMPLES, 0)
        normals = solid.mesh.directions[faces]
        return Skin(cKDTree(points), normals, _NEAR * solid.diagonal, solid.is_exact)

    def agreement(self, mesh: Mesh) -> np.ndarray:
        """f64[F]: for each triangle, 1 if it faces as the solid does, -1 if it faces inwards, 0 if hidden."""
        spots = np.einsum("sk,fkd->fsd", _SPOTS, mesh.corners)
        distance, nearest = self.tree.query(spots)
        along = np.einsum("fd,fsd->fs", mesh.directions, self.normals[nearest])
        is_told = (distance < self.reach) & (np.abs(along) > 0.5)
        return (np.sign(along) * is_told).mean(1)


def orient_faces(pieces: Sequence[Piece], solid: Solid | None) -> tuple[Piece, ...]:
    """The pieces with their triangles turned outwards, patch by patch; sheets get a second side.

    A patch is what hangs together by edges of two triangles each. In each all triangles are turned alike;
    then a closed patch is turned by the sign of its volume, an open one as most of it faces on the solid.
    An open patch with air on both sides, such as a bowl made of one sheet, gets a second side, 0.2 mm
    within, so that programs which draw both sides of a triangle see the nearer one.

    Args:
      solid: what the surfaces enclose, in their frame; None draws both sides of whatever is open.
    """
    patches = [_patches(piece.mesh) for piece in pieces]
    has_open = any((each.holes >= _MAX_HOLES).any() for each in patches)
    skin = Skin.of(solid) if solid is not None and has_open else None
    return tuple(_orient(piece, each, skin) for piece, each in zip(pieces, patches, strict=True))


def _orient(piece: Piece, patches: _Patches, skin: Skin | None) -> Piece:
    mesh = piece.mesh
    closed = patches.holes < _MAX_HOLES
    turned = _flip(mesh, patches.is_turned)
    volume = _sums(patches, _volumes(turned, patches))
    vote = np.zeros(patches.count)
    is_seen = np.ones(patches.count, bool)
    if skin is not None and not closed.all():
        agreement = skin.agreement(turned)
        area = turned.areas
        seen = _sums(patches, area * np.abs(agreement))
        vote = _sums(patches, area * agreement) / np.maximum(seen, 1e-30)
        is_seen = seen > _MIN_SEEN * np.maximum(_sums(patches, area), area.mean())
    is_told = ~closed & (np.abs(vote) >= _CLEAR)
    faces_in = np.where(is_told, vote, volume) < 0
    # What is open in a solid that had to be rebuilt may have a back that nothing covers.
    may_gape = skin is not None and not skin.is_exact and patches.holes > _GAPING
    is_sheet = ~closed & is_seen & (~is_told | may_gape)
    # What cannot be seen stays as it is, and so does what has only one side.
    is_kept = (~closed & ~is_seen) | patches.is_one_sided
    flips = np.where(is_kept[patches.label], False, patches.is_turned ^ faces_in[patches.label])
    return _add_back_sides(replace(piece, mesh=_flip(mesh, flips)), is_sheet[patches.label])


@dataclass(frozen=True, eq=False)
class _Patches:
    """Triangles grouped by what hangs together.

    Attributes:
      count: of patches.
      label: i[F], each triangle's patch.
      is_turned: bool[F], whether a triangle has to be turned to face as the rest of its patch.
      holes: f64[count], the area of a patch's holes over its own. A crack without width is no hole.
      is_one_sided: bool[count], whether no turning makes all of a patch face alike (a Moebius strip).
    """

    count: int
    label: np.ndarray
    is_turned: np.ndarray
    holes: np.ndarray
    is_one_sided: np.ndarray


def _patches(mesh: Mesh) -> _Patches:
    """Every triangle stands twice in a graph, as it is and turned; what faces alike is connected."""
    num = len(mesh.faces)
    _, place = unique_rows(np.round(mesh.vertices, 7))
    corners = place[mesh.faces]
    start = corners.ravel()
    end = np.roll(corners, -1, axis=1).ravel()
    shared, is_rim = shared_edges(corners)
    # Two triangles that face alike pass their common edge in opposite directions.
    is_unlike = np.equal(*(start < end)[shared.T])
    a, b = shared.T // 3
    pairs = np.concatenate(
        [np.stack([a, b + num * is_unlike], 1), np.stack([a + num, b + num * ~is_unlike], 1)]
    )
    as_is, turned = component_labels(pairs, 2 * num).reshape(2, num)
    _, label = np.unique(np.minimum(as_is, turned), return_inverse=True)
    label = label.reshape(-1)
    total = int(label.max()) + 1
    is_one_sided = np.zeros(total, bool)
    is_one_sided[label[as_is == turned]] = True
    is_turned = turned < as_is
    rim = np.flatnonzero(is_rim)
    area = np.bincount(label, mesh.areas / 2, total)
    ends = np.where(is_turned[rim // 3], [end[rim], start[rim]], [start[rim], end[rim]])
    points = np.empty((int(corners.max()) + 1, 3))
    points[corners] = mesh.corners
    holes = _hole_areas(points, ends, label[rim // 3], total) / np.maximum(area, 1e-30)
    return _Patches(total, label, is_turned, holes, is_one_sided)


def _hole_areas(points: np.ndarray, ends: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    """f64[count]: the areas of the loops that rim edges make, summed over each patch.

    Args:
      points: f64[V, 3]; ends: i[2, E], from which point to which each edge goes; label: i[E], its patch.
    """
    loop_of = component_labels(ends.T, len(points))
    num_loops = int(loop_of.max()) + 1
    loop = label * num_loops + loop_of[ends[0]]
    loops, which = np.unique(loop, return_inverse=True)
    start = points[ends[0]]
    end = points[ends[1]]
    about = _means(which, start, len(loops))
    swept = np.cross(start - about[which], end - about[which]) / 2
    area = np.zeros((len(loops), 3))
    np.add.at(area, which, swept)
    return np.bincount(loops // num_loops, np.linalg.norm(area, axis=1), count)


def _means(which: np.ndarray, vectors: np.ndarray, count: int) -> np.ndarray:
    """f64[count, 3]: the mean of the vectors of each group."""
    total = np.zeros((count, 3))
    np.add.at(total, which, vectors)
    return total / np.bincount(which, minlength=count)[:, None]


def _flip(mesh: Mesh, which: np.ndarray) -> Mesh:
    return Mesh(mesh.vertices, np.where(which[:, None], mesh.faces[:, ::-1], mesh.faces))


def _sums(patches: _Patches, values: np.ndarray) -> np.ndarray:
    return np.bincount(patches.label, values, patches.count)


def _volumes(mesh: Mesh, patches: _Patches) -> np.ndarray:
    """f64[F]: each triangle's share of its patch's volume, taken about the patch's own middle."""
    corners = mesh.corners
    centers = _means(patches.label, corners.mean(1), patches.count)
    a, b, c = (corners[:, k] - centers[patches.label] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6


def _add_back_sides(piece: Piece, is_sheet: np.ndarray) -> Piece:
    """The piece with the triangles `is_sheet` a second time, facing the other way from just behind them."""
    if not is_sheet.any():
        return piece
    mesh = piece.mesh
    sheet = mesh.faces[is_sheet]
    copied, corners = np.unique(sheet, return_inverse=True)
    normals = np.zeros((len(mesh.vertices), 3))
    np.add.at(normals, sheet, (mesh.directions * mesh.areas[:, None])[is_sheet][:, None])
    behind = mesh.vertices[copied] - _THICKNESS * unit(normals[copied])
    back = len(mesh.vertices) + corners.reshape(-1, 3)[:, ::-1]
    whole = Mesh(np.concatenate([mesh.vertices, behind]), np.concatenate([mesh.faces, back]))
    uv = None if piece.uv is None else np.concatenate([piece.uv, piece.uv[copied]])
    return replace(piece, mesh=whole, uv=uv)
