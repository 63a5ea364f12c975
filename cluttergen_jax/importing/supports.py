"""A user's own furniture as a support: read, its surfaces found, what objects can touch made, stored by name.

Of a table with one top that are boxes which cover it, and what rises above it (rims, risers, screens). Legs
and all else below the top are drawn but do not collide, since whatever falls past the top has failed already.
Of furniture with several surfaces, or a sloping one, all boards, walls and legs collide.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.config import NARROW_SURFACE, SURFACE_AIR
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.orientation import orient_faces
from cluttergen_jax.assets.parts import as_meshes
from cluttergen_jax.assets.shape import Piece, Shape
from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset, Surface
from cluttergen_jax.assets.support_file import (
    embedded_supports,
    is_support_name,
    read_support,
    support_hash,
    user_supports,
    write_support,
)
from cluttergen_jax.assets.support_map import (
    Overhead,
    Span,
    cover,
    free_height,
    largest_rectangle,
    level_faces,
    look_down,
    surface_heights,
)
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.files import writing
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.importing.cache import files_outside, outside_note
from cluttergen_jax.importing.furniture import find_furniture, read_upright
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ReadOptions
from cluttergen_jax.importing.support_collision import (
    air_over,
    as_box,
    collision_of,
    columns_over,
    cut_off,
    estimates_of,
    is_inside,
    moved_together,
    note_of_air,
    surface_samples,
    with_joints,
    without_air,
)
from cluttergen_jax.importing.surfaces import FoundSurface, find_surfaces, num_cells, without_cracks
from cluttergen_jax.kept_folder import PATIENCE, lock_beside

_NAMED = re.compile(r"'[^']*'|\S+\.(obj|mtl|dae|stl|ply|glb|png|jpe?g)\b", re.IGNORECASE)
_OF_MASS = ("its file states no", "the mass that its file")
"""How readers' notes on an object's mass begin, which a support has none of."""
_READING = 120
"""Seconds of a processor that reading furniture may take."""


def write_table(
    path: str | Path,
    name: str | None,
    options: ReadOptions,
    force: bool,
    joints: Mapping[str, float],
) -> SupportAsset:
    """The support of a table's file, among the user's own; see `cluttergen_jax.import_support`."""
    source, of_bodies = find_furniture(path)
    if name is None and source.name in embedded_supports():
        name = f"my_{source.name}"
        of_bodies.append(f"called {name!r}, as {source.name!r} comes with the package (--name)")
    name = source.name if name is None else name
    if not is_support_name(name) or name in embedded_supports():
        raise PoolError(
            f"a support called {name!r}",
            "names of a-z, 0-9, '_' and '-' that are neither embedded nor of any size: not "
            f"{', '.join(embedded_supports())}, table-WxD, bin-WxD",
            "name='my_table'",
        )
    source = replace(source, outside=files_outside(source, source.path))
    shape, of_pose = call_limited(
        source.path, read_upright, source, options, joints, seconds=_READING
    )
    support, notes = support_with_notes(shape)
    of_file = [note for note in shape.notes if not note.startswith(_OF_MASS)]
    said = [
        *outside_note(source.outside),
        *of_bodies,
        *of_pose,
        *map(_with_option, of_file),
        *notes,
    ]
    said += [*estimates_of(support.joints), *_alarms(support)]
    for note in _together(said):
        print(note, file=sys.stderr)
    support = replace(support, name=name)
    folder = user_supports() / name
    with writing(folder), lock_beside(folder, PATIENCE):
        if folder.exists() and not force:
            if _is_same(folder, support):
                return support
            raise PoolError(
                f"support {name!r} exists and is another", "a new `name`", "`force` to replace it"
            )
        write_support(folder, support, overwrite=force)
    return support


def _together(notes: Sequence[str]) -> list[str]:
    """Notes; of those that differ by a file's or another name alone, the first with the number of others."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(_NAMED.sub("", note), []).append(note)
    return [
        first + (f" ({len(rest)} more like it)" if rest else "") for first, *rest in alike.values()
    ]


def _alarms(support: SupportAsset) -> list[str]:
    """What says that furniture is on its edge, or of another unit than it says."""
    widest = max(2 * min(surface.region.half_extents) for surface in support.surfaces)
    if widest >= NARROW_SURFACE - _SAME_HEIGHT:
        return []
    return [
        f"ALARM: its largest surface is {100 * widest:.0f} cm wide: is it on its edge (--up x, y, z, -x, -y "
        "or -z), or of another unit (--scale)? cluttergen inspect draws it"
    ]


def _with_option(note: str) -> str:
    return f"{note} (--joint NAME=VALUE moves one)" if note.startswith("frozen joints") else note


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
_SHEET = 0.005
"""Metres: a thinner board is not trusted to carry: boxes so thick are laid below it."""
_SMOOTH = 0.0005
_MOSTLY = 0.98
_HAIR = 0.001
_BULGE = 0.02
_MORE = 1.05


def support_with_notes(shape: Shape) -> tuple[SupportAsset, list[str]]:
    """Finds the surfaces of a table, a shelf or a board, and makes it carry objects.

    The top is the height at which the largest level area is open to the sky. Its outline is covered with
    boxes to half a centimetre; gaps of up to 2 cm, as between planks, are closed. The region is the largest
    rectangle on it, along the sides of the smallest rectangle around the top. Other surfaces follow from the
    highest to the lowest (`importing.surfaces`): shelf_1, shelf_2 ...

    Args:
      shape: furniture in metres, z up, as authored or scaled by its reader.

    Returns:
      The support on the floor, its bounding box centred on the z axis; and in words what is no surface of it
      and what does not collide.

    Raises:
      AssetError: nothing level of at least 10 cm x 10 cm that is open to the sky, and no other surface.
    """
    whole = join_meshes([piece.mesh for piece in shape.pieces])
    shift = -np.append(whole.bounds.mean(0)[:2], whole.bounds[0, 2])
    support, notes = _without_joints(shape, whole, shift)
    if not shape.joints:
        return support, notes
    return with_joints(
        support, [each.transform(np.eye(3), 1.0, shift) for each in shape.joints]
    ), notes


def _without_joints(shape: Shape, whole: Mesh, shift: np.ndarray) -> tuple[SupportAsset, list[str]]:
    """`support_with_notes` without its joints.

    Args:
      whole: all surfaces; shift: from the shape's frame to the world.
    """
    mesh = whole.transform(np.eye(3), shift)
    height = None
    try:
        height = _top_height(shape.name, mesh)
    except AssetError:
        found, notes = find_surfaces(mesh, 0.0)
        if not found:
            raise
    pieces = orient_faces([piece.transform(np.eye(3), shift) for piece in shape.pieces], None)
    if height is None:
        return _several(shape, pieces, found[0].surface, found, notes)
    table = _flat_table(shape, mesh, pieces, height)
    found, notes = find_surfaces(mesh, table.region.yaw)
    others = [each for each in found if not _is_top(each.surface, height)]
    if not others:
        return table, notes
    # The largest at that height, and more than is open to the sky: what hangs over some of it is real here.
    tops = [each for each in found if _is_top(each.surface, height)]
    top = max(tops, key=lambda each: each.surface.area, default=None)
    level = [box for box in table.boxes if box.center[2] < height]
    open_area = sum(4 * math.prod(box.half_extents[:2]) for box in level)
    if top is not None and top.surface.area > _MORE * open_area:
        own = replace(top.surface, region=table.region, position=(0.0, 0.0, height))
        return _several(shape, pieces, own, [replace(top, surface=own), *others], notes)
    depth = _THICKNESS if top is None else max(top.thickness, _SHEET)
    low = max(height - depth, 0.0)
    level = [
        replace(
            box,
            center=(*box.center[:2], (low + height) / 2),
            half_extents=(*box.half_extents[:2], (height - low) / 2),
        )
        for box in level
    ]
    (own,) = replace(table, boxes=tuple(level)).surfaces
    return _several(shape, pieces, own, others, notes, level)


def _flat_table(shape: Shape, mesh: Mesh, pieces: tuple[Piece, ...], top: float) -> SupportAsset:
    yaw = _top_yaw(mesh, top)
    aligned = mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    view = _view(aligned, top)
    risen = view.height > top + _SAME_HEIGHT
    flat = view.is_level & (np.abs(view.height - top) <= _SAME_HEIGHT)
    closed = without_cracks(flat) & ~risen
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
        pieces=pieces,
    )


def _is_top(surface: Surface, top: float) -> bool:
    return surface.is_level and abs(surface.position[2] - top) <= 2 * _SAME_HEIGHT


def _several(
    shape: Shape,
    pieces: tuple[Piece, ...],
    top: Surface,
    found: list[FoundSurface],
    notes: list[str],
    level: Sequence[Box] = (),
) -> tuple[SupportAsset, list[str]]:
    """Furniture with several surfaces, or with a sloping one.

    Args:
      top: the surface that comes first.
      found: all of them, or all others where `level` covers the top.
    """
    yaw = top.region.yaw
    surfaces = [each.surface for each in found]
    surfaces = [top, *surfaces] if level else surfaces
    surfaces = _called_in_order(surfaces)
    covers = [(surfaces[0], [box.mesh.vertices for box in level])] if level else []
    solids = []
    lost = []
    for group in moved_together(shape.joints, [piece.mesh for piece in pieces]):
        boxes, parts, notes_of_group = collision_of(group, yaw, surfaces)
        solids += [box.mesh.vertices for box in boxes] + parts
        lost += notes_of_group
    bare = _support_of(shape, pieces, surfaces, solids, yaw)
    for each, surface in zip(found, surfaces[-len(found) :], strict=True):
        if each.thickness < _SHEET or not _is_flat(bare, surface, each):
            covers.append((surface, _plates(each)))
    for surface, _ in covers:
        solids = [kept for points in solids if (kept := _lowered(points, surface)) is not None]
    plates = [points for _, group in covers for points in group]
    solids = [points for points in solids if not any(is_inside(points, plate) for plate in plates)]
    whole = join_meshes([piece.mesh for piece in pieces])
    first = _support_of(shape, pieces, surfaces, plates + solids, yaw)
    before = [air_over(whole, first, surface) for surface in surfaces]
    seen = list(zip(found, surfaces[-len(found) :], before[-len(found) :], strict=True))
    samples = np.zeros((0, 3))
    if any(air.is_short for _, _, air in seen):
        samples = surface_samples(whole)
    columns = []
    for each, surface, air in seen:
        if air.is_short:
            columns += columns_over(samples, each, surface)
    if columns:
        solids = without_air(plates + solids, columns)
        first = _support_of(shape, pieces, surfaces, solids, yaw)
    after = [air_over(whole, first, surface) for surface in surfaces] if columns else before
    of_air = [note_of_air(*each) for each in zip(surfaces, before, after, strict=True)]
    counted = [
        surface
        for number, (surface, air) in enumerate(zip(surfaces, after, strict=True))
        if number == 0 or air.collided >= SURFACE_AIR
    ]
    named = [
        replace(each, free_height=free_height(surface_heights(first, each), each.region))
        for each in _called_in_order(counted)
    ]
    return replace(first, named=tuple(named)), notes + lost + [note for note in of_air if note]


def _called_in_order(surfaces: Sequence[Surface]) -> list[Surface]:
    """The first as "top", the others as shelf_1, shelf_2 ..."""
    names = ["top", *(f"shelf_{number}" for number in range(1, len(surfaces)))]
    return [replace(surface, name=name) for surface, name in zip(surfaces, names, strict=True)]


def _support_of(
    shape: Shape,
    pieces: tuple[Piece, ...],
    surfaces: list[Surface],
    solids: list[np.ndarray],
    yaw: float,
) -> SupportAsset:
    """A support whose collision are the hulls of points f64[V, 3] each: boxes where they are."""
    boxes = []
    parts = []
    for points in solids:
        box = as_box(points, yaw)
        if box is None:
            parts.append(points)
        else:
            boxes.append(box)
    return SupportAsset(
        name=shape.name,
        label=shape.label,
        boxes=tuple(boxes),
        top=surfaces[0].position[2],
        region=surfaces[0].region,
        provenance=shape.provenance,
        pieces=pieces,
        parts=as_meshes(parts),
        named=tuple(surfaces),
    )


def _is_flat(support: SupportAsset, surface: Surface, found: FoundSurface) -> bool:
    """Whether the collision has a surface where the mesh has it."""
    heights = surface_heights(support, surface)
    is_on = found.is_on(heights.centers)
    return bool(is_on.any() and (np.abs(heights.ground[is_on]) <= _SMOOTH).mean() >= _MOSTLY)


def _plates(found: FoundSurface) -> list[np.ndarray]:
    """f64[8, 3] each: boards that cover a surface."""
    T = found.surface.T_world_surface
    depth = max(found.thickness, _SHEET)
    depths = np.repeat([0.0, -depth], 4)
    boards = [np.column_stack([np.tile(plate, (2, 1)), depths]) for plate in found.plates]
    return [points @ T[:3, :3].T + T[:3, 3] for points in boards]


def _lowered(points: np.ndarray, surface: Surface) -> np.ndarray | None:
    """A convex part that ends about a covered surface, cut a millimetre below it; others as they are."""
    local = surface.local(points)
    end = float(local[:, 2].max())
    ends_there = -_SMOOTH - _HAIR <= end <= _BULGE and local[:, 2].mean() < 0
    low = surface.polygon.min(0)
    high = surface.polygon.max(0)
    is_over = (local[:, :2].max(0) > low).all() and (local[:, :2].min(0) < high).all()
    return cut_off(points, surface.T_world_surface, -_HAIR) if ends_there and is_over else points


def _top_height(name: str, mesh: Mesh) -> float:
    """The height of the largest level area that is open to the sky."""
    lower, upper = mesh.bounds[:, :2]
    pitch = max(PITCH, float((upper - lower).max()) / _MAX_CELLS)
    view = look_down(mesh, lower, upper, num_cells(upper - lower, pitch))
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
    lower = points.min(0)
    upper = points.max(0)
    shape = num_cells(upper - lower, PITCH)
    cell = (upper - lower) / shape
    more = np.ceil(_RIM / cell).astype(int)
    view = look_down(mesh, lower - more * cell, upper + more * cell, shape + 2 * more)
    walls = mesh.faces[mesh.vertices[mesh.faces, 2].max(1) > top + _SAME_HEIGHT]
    if len(walls) == 0:
        return view
    samples, _ = trimesh.remesh.subdivide_to_size(
        mesh.vertices, walls, float(cell.min()) / 2, max_iter=20
    )
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
