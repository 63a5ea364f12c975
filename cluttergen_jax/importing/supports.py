"""A user's own table as a support: read, its flat top found and covered with boxes, stored by name.

Only what objects can touch is made: the top, and what rises above it (rims, risers, screens). Legs, shelves
and all else below the top are drawn but do not collide, since whatever falls past the top has failed already.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.mesh_repair.orientation import orient_faces
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset
from cluttergen_jax.assets.support_file import (
    embedded_supports,
    is_support_name,
    read_support,
    support_hash,
    user_supports,
    write_support,
)
from cluttergen_jax.assets.support_map import Overhead, Span, cover, largest_rectangle, level_faces, look_down
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape


def write_table(path: str | Path, name: str | None, options: ReadOptions, force: bool) -> SupportAsset:
    """The support of a table's file, among the user's own; see `cluttergen_jax.import_support`."""
    sources = find_sources(path)
    if len(sources) > 1:
        names = ", ".join(source.name for source in sources[:5])
        raise AssetError(
            f"{path} holds {len(sources)} objects ({names})", "one table", "the table's own file"
        )
    name = sources[0].name if name is None else name
    if not is_support_name(name) or name in embedded_supports():
        raise PoolError(
            f"a support called {name!r}",
            "names of a-z, 0-9, '_' and '-' that are neither embedded nor of any size: not "
            f"{', '.join(embedded_supports())}, table-WxD, bin-WxD",
            "name='my_table'",
        )
    support = replace(support_from_mesh(read_shape(sources[0], options)), name=name)
    folder = user_supports() / name
    if folder.exists() and not force:
        if _is_same(folder, support):
            return support
        raise PoolError(f"support {name!r} exists and is another", "a new `name`", "`force` to replace it")
    write_support(folder, support, overwrite=force)
    return support


def _is_same(folder: Path, support: SupportAsset) -> bool:
    try:
        return support_hash(read_support(folder)) == support_hash(support)
    except ClutterGenError:
        return False


PITCH = 0.01
_SAME_HEIGHT = 0.003
_THICKNESS = 0.04
_RIM = 0.05
_MAX_CELLS = 300
_MIN_AREA = 0.01


def support_from_mesh(shape: Shape) -> SupportAsset:
    """Finds a table's top and makes it carry objects.

    The top is the height at which the largest level area is open to the sky. Its outline is covered with
    boxes to half a centimetre; gaps of up to 2 cm, as between planks, are closed. The region is the largest
    rectangle on it, along the sides of the smallest rectangle around the top.

    Args:
      shape: a table in metres, z up, as authored or scaled by its reader.

    Returns:
      The support on the floor, its bounding box centred on the z axis.

    Raises:
      AssetError: no level area of at least 10 cm x 10 cm.
    """
    whole = join_meshes([piece.mesh for piece in shape.pieces])
    shift = -np.append(whole.bounds.mean(0)[:2], whole.bounds[0, 2])
    mesh = whole.transform(np.eye(3), shift)
    top = _top_height(shape.name, mesh)
    yaw = _top_yaw(mesh, top)
    aligned = mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    view = _view(aligned, top)
    risen = view.height > top + _SAME_HEIGHT
    flat = view.is_level & (np.abs(view.height - top) <= _SAME_HEIGHT)
    closed = ndimage.binary_closing(np.pad(flat, 1), np.ones((3, 3)))[1:-1, 1:-1] & ~risen
    spans = cover(closed)
    boxes = [_box(view, span, max(top - _THICKNESS, 0.0), top, yaw) for span in spans]
    for span in cover(risen, 0.01):
        highest = float(view.height[span[0] : span[1], span[2] : span[3]].max())
        boxes.append(_box(view, span, top, highest, yaw))
    region = _box(view, largest_rectangle(closed), 0.0, top, yaw)
    return SupportAsset(
        name=shape.name,
        label=shape.label,
        boxes=tuple(boxes),
        top=top,
        region=Rectangle(region.center[:2], region.half_extents[:2], yaw),
        provenance=shape.provenance,
        pieces=orient_faces([piece.transform(np.eye(3), shift) for piece in shape.pieces], None),
    )


def _cells(size: np.ndarray, pitch: float) -> np.ndarray:
    """i[2]: how many cells of at most `pitch` fill a rectangle."""
    return np.maximum(np.ceil(size / pitch - 1e-9), 1).astype(int)


def _top_height(name: str, mesh: Mesh) -> float:
    """The height of the largest level area that is open to the sky."""
    lower, upper = mesh.bounds[:, :2]
    pitch = max(PITCH, float((upper - lower).max()) / _MAX_CELLS)
    view = look_down(mesh, lower, upper, _cells(upper - lower, pitch))
    heights = np.sort(view.height[view.is_level])
    count = np.searchsorted(heights, heights + _SAME_HEIGHT, side="right") - np.arange(len(heights))
    area = float(count.max() * view.cell.prod()) if len(heights) else 0.0
    if area < _MIN_AREA:
        raise AssetError(
            f"table {name!r}, whose largest level area has {1e4 * area:.0f} cm^2",
            f"at least {1e4 * _MIN_AREA:.0f} cm^2, facing up with nothing over it",
            "scaling the mesh to metres, or turning its z axis up",
        )
    lowest = int(count.argmax())
    return float(np.median(heights[lowest : lowest + count[lowest]]))


def _top_vertices(mesh: Mesh, top: float) -> np.ndarray:
    """f64[N, 2]: corners of the level triangles at the top's height."""
    corners = mesh.vertices[mesh.faces[level_faces(mesh)]].reshape(-1, 3)
    return corners[np.abs(corners[:, 2] - top) <= _SAME_HEIGHT, :2]


def _view(mesh: Mesh, top: float) -> Overhead:
    """The top and a rim's width around it from above; cells that a thin wall crosses have its height.

    Cell borders fall on the top's own sides, so a rectangular top is met exactly.
    """
    points = _top_vertices(mesh, top)
    lower, upper = points.min(0), points.max(0)
    shape = _cells(upper - lower, PITCH)
    cell = (upper - lower) / shape
    more = np.ceil(_RIM / cell).astype(int)
    view = look_down(mesh, lower - more * cell, upper + more * cell, shape + 2 * more)
    walls = mesh.faces[mesh.vertices[mesh.faces, 2].max(1) > top + _SAME_HEIGHT]
    if len(walls) == 0:
        return view
    samples, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, walls, float(cell.min()) / 2, max_iter=20)
    samples = samples[samples[:, 2] > top + _SAME_HEIGHT]
    # A rim's inner face lies on a cell's border: it belongs to the cell farther out.
    outwards = 0.001 * np.sign(samples[:, :2] - (lower + upper) / 2)
    index = np.floor((samples[:, :2] + outwards - view.origin) / view.cell).astype(int)
    is_seen = ((index >= 0) & (index < view.height.shape)).all(1)
    np.maximum.at(view.height, tuple(index[is_seen].T), samples[is_seen, 2])
    return view


def _top_yaw(mesh: Mesh, top: float) -> float:
    """The turn of the smallest rectangle around the top, in (-45, 45] degrees; 0 unless turning saves 3 %."""
    points = _top_vertices(mesh, top)
    rim = points[ConvexHull(points).vertices]
    edges = np.roll(rim, -1, 0) - rim
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    areas = [float(np.ptp(rim @ yaw_matrix(angle)[:2, :2], axis=0).prod()) for angle in angles]
    best = int(np.argmin(areas))
    if areas[best] > 0.97 * float(np.ptp(rim, axis=0).prod()):
        return 0.0
    quarter = math.pi / 2
    return float(angles[best] - quarter * round(float(angles[best]) / quarter))


def _box(view: Overhead, span: Span, low: float, high: float, yaw: float) -> Box:
    """A span of cells as a box between two heights, turned back into the table's frame."""
    lower = view.origin + view.cell * (span[0], span[2])
    upper = view.origin + view.cell * (span[1], span[3])
    x, y, _ = (yaw_matrix(yaw) @ np.append((lower + upper) / 2, 0.0)).tolist()
    half_x, half_y = ((upper - lower) / 2).tolist()
    return Box((x, y, (low + high) / 2), (half_x, half_y, (high - low) / 2), yaw)
