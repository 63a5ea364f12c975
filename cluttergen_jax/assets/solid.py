"""A closed solid from whatever surfaces an object has; and surfaces on a grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import manifold3d
import numpy as np

from cluttergen_jax.assets.mesh import Mesh, clean_mesh, join_meshes
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.errors import AssetError
from cluttergen_jax.phases import say_phase

_MAX_PIECES = 64
_MAX_FACES = 100_000
_MOST_PLAIN = 20_000
"""Triangles: of finer surfaces nobody knows the components."""
_HAIR = 2e-4
_CELLS = 80
"""Along the longest side of a surface that is rebuilt."""
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Solid:
    """The space that an object takes.

    Attributes:
      mesh: watertight and oriented outwards, without inner walls.
      is_exact: whether it is made of the object's own triangles; else it was rebuilt from a grid.
      surface: what was given: all triangles, welded.
      components: closed surfaces whose union is `mesh`; none of rebuilt or fine ones.
    """

    mesh: Mesh
    is_exact: bool
    surface: Mesh
    components: tuple[Mesh, ...] = ()

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return as_manifold(self.mesh).volume()

    def shells(self) -> list[manifold3d.Manifold]:
        """Its pieces that do not touch one another; the surfaces of hollows inside are none."""
        return _solid_pieces(as_manifold(self.mesh))

    def rotate(self, rotation: np.ndarray) -> Solid:
        """The solid with every point p at rotation @ p."""
        meshes = (self.mesh, self.surface, *self.components)
        mesh, surface, *components = (each.transform(rotation) for each in meshes)
        return Solid(mesh, self.is_exact, surface, tuple(components))

    @cached_property
    def is_convex(self) -> bool:
        """Whether it is its convex hull."""
        return is_convex(self.mesh)

    @cached_property
    def diagonal(self) -> float:
        """Metres across the bounding box of what was given."""
        return self.surface.diagonal


def solid_of(meshes: Sequence[Mesh]) -> Solid:
    """The solid enclosed by several surfaces together.

    Closed surfaces are united exactly; of more than 100,000 triangles, as scans have, as many are left as
    keep the surface within 0.02 % of the diagonal. Others are mended where a hole is small, and else rebuilt
    on a grid around all triangles, within half a percent of the object's size.

    Raises:
      AssetError: nothing with a volume can be made of them.
    """
    surface = clean_mesh(join_meshes(list(meshes)))
    if hull_of(surface.vertices) is None:
        raise AssetError(
            "a surface that lies in a plane or on a line", "a mesh of an object with some thickness"
        )
    shells = _closed_shells(meshes) if len(meshes) <= _MAX_PIECES else []
    united = as_mesh(_union(shells)) if shells else surface
    is_exact = bool(shells) and _covers(united, surface)
    if not is_exact:
        say_phase(f"closing its open surface of {len(surface.faces):,} triangles on a grid")
    mesh = united if is_exact else _rebuild(surface)
    if len(mesh.faces) == 0:
        raise AssetError(
            "a surface that encloses nothing", "a mesh of an object with some thickness"
        )
    is_plain = is_exact and sum(each.num_tri() for each in shells) <= _MOST_PLAIN
    solid = Solid(mesh, is_exact, surface, tuple(map(as_mesh, shells)) if is_plain else ())
    if len(mesh.faces) <= _MAX_FACES:
        return solid
    return replace(solid, mesh=simplify_solid(mesh, _HAIR * solid.diagonal))


def enclosed_volume(meshes: Sequence[Mesh]) -> float | None:
    """Cubic metres that closed surfaces enclose together; None if one is open, or they are more than 64.

    Each place counts once, and a void that is closed on all sides counts as filled, as in `solid_of`.
    """
    shells = [_shells(clean_mesh(mesh, is_closed=True)) for mesh in meshes[:_MAX_PIECES]]
    if not 0 < len(meshes) <= _MAX_PIECES or not all(shells):
        return None
    return union_volume(list(chain.from_iterable(shells)))


def union_volume(solids: Sequence[manifold3d.Manifold]) -> float:
    """Cubic metres that solids fill together, each place counted once."""
    return float(_union(solids).volume())


def _union(solids: Sequence[manifold3d.Manifold]) -> manifold3d.Manifold:
    return manifold3d.Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def is_convex(mesh: Mesh) -> bool:
    """Whether a closed mesh is its convex hull."""
    hull = hull_of(mesh.vertices)
    return hull is not None and mesh.volume >= (1 - _ROUNDING) * hull.volume


def simplify_solid(mesh: Mesh, tolerance: float) -> Mesh:
    """The closed mesh with fewer triangles, nowhere moved by more than `tolerance` metres."""
    return as_mesh(as_manifold(mesh).simplify(tolerance))


def as_manifold(mesh: Mesh) -> manifold3d.Manifold:
    """A closed mesh for manifold3d."""
    raw = manifold3d.Mesh64(
        np.array(mesh.vertices, np.float64, order="C"), np.array(mesh.faces, np.uint64, order="C")
    )
    return manifold3d.Manifold(raw)


def _solid_pieces(manifold: manifold3d.Manifold) -> list[manifold3d.Manifold]:
    """Its components without the voids inside of others."""
    return [each for each in manifold.decompose() if each.volume() > 0]


def as_mesh(manifold: manifold3d.Manifold) -> Mesh:
    raw = manifold.to_mesh64()
    return Mesh(raw.vert_properties[:, :3], raw.tri_verts)


def _covers(united: Mesh, surface: Mesh) -> bool:
    """Whether no vertex of the surface is outside of the solid by more than a cell.

    Mending can close a surface in the wrong way, and what faces inwards is taken for a void.
    """
    voxels = Voxels.of(united)
    lower, upper = united.bounds
    is_near = (surface.vertices > lower - voxels.pitch) & (surface.vertices < upper + voxels.pitch)
    return bool(is_near.all() and dilate(voxels.solid)[voxels.index(surface.vertices)].all())


def _closed_shells(meshes: Sequence[Mesh]) -> list[manifold3d.Manifold]:
    """The components of surfaces; none if one of these is neither closed nor easily mended."""
    solids: list[manifold3d.Manifold] = []
    for mesh in meshes:
        shells = _shells(clean_mesh(mesh, is_closed=True)) or _shells(_mend(mesh))
        if not shells:
            return []
        solids += shells
    return solids


def _shells(mesh: Mesh) -> list[manifold3d.Manifold]:
    """The components of a closed surface, voids inside others left out; empty if it is not closed."""
    for faces in (mesh.faces, mesh.faces[:, ::-1]):
        manifold = as_manifold(Mesh(mesh.vertices, faces))
        if manifold.status() != manifold3d.Error.NoError or manifold.is_empty():
            return []
        if manifold.volume() > 0:
            return _solid_pieces(manifold)
    return []


def _mend(mesh: Mesh) -> Mesh:
    """The surface with small holes filled and faces turned alike."""
    # Loaded when an object is imported: it takes as long as JAX, and placing objects needs none of it.
    import trimesh

    mesh = clean_mesh(mesh)
    if not len(mesh.faces):
        return mesh
    tri = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    trimesh.repair.fill_holes(tri)
    trimesh.repair.fix_normals(tri)
    return clean_mesh(Mesh(tri.vertices, tri.faces), is_closed=True)


def _rebuild(surface: Mesh) -> Mesh:
    """A closed surface just around all triangles, drawn back onto them.

    The level set lies most of a cell outside of the samples, so that sheets without thickness and small
    gaps are closed; then each vertex goes back to a quarter of a cell from its nearest sample.
    """
    from scipy import ndimage
    from scipy.spatial import cKDTree

    voxels = Voxels.of(surface, _CELLS)
    # What lies deep inside counts as filled: only the skin is drawn.
    skin = voxels.surface & dilate(voxels.outside)
    tree = cKDTree(voxels.samples[skin[voxels.index(voxels.samples)]])
    offset = 0.8 * voxels.pitch
    field = np.where(voxels.outside, -1.0, 1.0) * 2 * voxels.pitch
    near = np.argwhere(ndimage.binary_dilation(skin, iterations=3))
    distance = tree.query(voxels.origin + near * voxels.pitch)[0]
    is_out = (voxels.outside | skin)[tuple(near.T)]
    field[tuple(near.T)] = np.where(is_out, -distance, distance)
    value = _interpolator(field + offset, voxels)
    lower = voxels.origin
    upper = voxels.origin + (np.array(field.shape) - 1) * voxels.pitch
    manifold = manifold3d.Manifold.level_set(value, [*lower, *upper], voxels.pitch)
    shells = _solid_pieces(manifold)
    if not shells:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    mesh = as_mesh(_union(shells).simplify(0.1 * voxels.pitch))
    reach, nearest = tree.query(mesh.vertices)
    share = np.clip(1 - 0.25 * voxels.pitch / np.maximum(reach, 1e-12), 0, 1)
    return Mesh(mesh.vertices + (tree.data[nearest] - mesh.vertices) * share[:, None], mesh.faces)


def _interpolator(field: np.ndarray, voxels: Voxels) -> Callable[[float, float, float], float]:
    """Trilinear interpolation in plain floats: called a million times, where NumPy would be slower."""
    from scipy import ndimage

    flat = field.ravel().tolist()
    nx, ny, nz = field.shape
    last_x = nx - 2
    last_y = ny - 2
    last_z = nz - 2
    around = (
        ndimage.maximum_filter(field, 2, origin=-1),
        ndimage.minimum_filter(field, 2, origin=-1),
    )
    is_even = np.equal(*around).ravel().tolist()
    (ox, oy, oz) = voxels.origin.tolist()
    pitch = voxels.pitch

    def value(x: float, y: float, z: float) -> float:
        x = (x - ox) / pitch
        y = (y - oy) / pitch
        z = (z - oz) / pitch
        i = int(x)
        j = int(y)
        k = int(z)
        if not (0 <= i <= last_x and 0 <= j <= last_y and 0 <= k <= last_z):
            i = min(max(i, 0), last_x)
            j = min(max(j, 0), last_y)
            k = min(max(k, 0), last_z)
        a = (i * ny + j) * nz + k
        if is_even[a]:
            return flat[a]
        u = x - i
        v = y - j
        w = z - k
        b = a + nz
        c = a + ny * nz
        d = c + nz
        low = (flat[a] * (1 - w) + flat[a + 1] * w) * (1 - v) + (
            flat[b] * (1 - w) + flat[b + 1] * w
        ) * v
        high = (flat[c] * (1 - w) + flat[c + 1] * w) * (1 - v) + (
            flat[d] * (1 - w) + flat[d + 1] * w
        ) * v
        return low * (1 - u) + high * u

    return value


_MARGIN = 2


@dataclass(frozen=True, eq=False)
class Voxels:
    """A grid of cubic cells around a surface, with a margin of empty cells.

    Attributes:
      origin: f64[3], centre of cell (0, 0, 0), metres.
      pitch: side of a cell, metres.
      surface: bool[X, Y, Z], cells that the surface passes through.
      outside: bool[X, Y, Z], cells that can be reached from outside without crossing the surface.
      samples: f64[N, 3], points of the surface; every point of it is within 0.47 cells of one.
    """

    origin: np.ndarray
    pitch: float
    surface: np.ndarray
    outside: np.ndarray
    samples: np.ndarray

    @staticmethod
    def of(mesh: Mesh, cells: int = 72) -> Voxels:
        """The grid of a mesh, `cells` along its longest side.

        Where a path from a cell to its neighbour crosses the surface, a sample is within half a cell, so one
        of the two cells is marked: a flood from outside cannot slip through a closed surface.
        """
        from scipy import ndimage

        lower, upper = mesh.bounds
        pitch = float((upper - lower).max()) / cells
        samples = scan_lines(mesh, 0.35 * pitch, 0.6 * pitch)
        origin = lower - _MARGIN * pitch
        shape = np.ceil((upper - origin) / pitch).astype(int) + 1 + _MARGIN
        surface = np.zeros(shape, bool)
        surface[tuple(np.round((samples - origin) / pitch).astype(int).T)] = True
        regions, _ = ndimage.label(~surface)
        return Voxels(origin, pitch, surface, regions == regions[0, 0, 0], samples)

    @property
    def solid(self) -> np.ndarray:
        """bool[X, Y, Z]: the surface's cells and all that they enclose."""
        return ~self.outside

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """f64[N, 3]: centres of the True cells of a bool[X, Y, Z]."""
        return self.origin + np.argwhere(cells) * self.pitch

    def index(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """The cells in which `points` lie, as an index; points beyond the grid get its outermost cells."""
        cells = np.round((points - self.origin) / self.pitch).astype(int)
        return tuple(np.clip(cells, 0, np.array(self.surface.shape) - 1).T)

    def is_exposed(self, points: np.ndarray) -> np.ndarray:
        """bool[N]: whether surface points can be seen from outside, to within a cell."""
        return dilate(self.outside)[self.index(points)]

    def water(self) -> np.ndarray:
        """bool[X, Y, Z]: cells outside that would stay full if the object were filled with water.

        Level by level from below: water leaves a cell if it can leave the cell beneath, or flow sideways
        to a cell that it leaves.
        """
        from scipy import ndimage

        is_dry = np.zeros_like(self.outside)
        below = np.ones(self.outside.shape[:2], bool)
        for level in range(self.outside.shape[2]):
            regions, _ = ndimage.label(self.outside[:, :, level])
            drain = below.copy()
            drain[[0, -1], :] = drain[:, [0, -1]] = True
            drained = np.unique(regions[drain])
            below = np.isin(regions, drained[drained > 0])
            is_dry[:, :, level] = below
        return self.outside & ~is_dry


def dilate(cells: np.ndarray) -> np.ndarray:
    """bool[X, Y, Z]: the True cells with all around them, corners included."""
    from scipy import ndimage

    return np.asarray(ndimage.binary_dilation(cells, np.ones((3, 3, 3), bool)))


def scan_lines(mesh: Mesh, line_spacing: float, spacing: float) -> np.ndarray:
    """f64[N, 3]: points on lines along each triangle's longest edge, so slivers cost no more than their area.

    Lines are at most `line_spacing` apart and points on a line at most `spacing`. A point of the triangle is
    at most `line_spacing` from the longer of the two lines beside it, and so within
    sqrt(line_spacing^2 + spacing^2 / 4) of a sample.
    """
    corners = mesh.corners
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(edges, axis=2).argmax(1)
    rows = np.arange(len(corners))
    start = corners[rows, longest]
    along = edges[rows, longest]
    apex = corners[rows, (longest + 2) % 3] - start
    length = np.linalg.norm(along, axis=1)
    height = np.linalg.norm(np.cross(along, apex), axis=1) / np.maximum(length, 1e-12)
    which, share = _steps(height, line_spacing)
    start = start[which] + apex[which] * share[:, None]
    along = along[which] * (1 - share)[:, None]
    which, share = _steps(length[which] * (1 - share), spacing)
    return start[which] + along[which] * share[:, None]


def _steps(lengths: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """For each length, steps from 0 to 1 that are at most `spacing` long: whose they are, and where."""
    counts = np.ceil(lengths / spacing).astype(np.int64) + 1
    which = np.repeat(np.arange(len(lengths)), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    share = (np.arange(len(which)) - first) / np.maximum(counts[which] - 1, 1)
    return which, share
