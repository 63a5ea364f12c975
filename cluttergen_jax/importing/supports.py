"""A user's own furniture as a support: read, its surfaces found, what objects can touch made, stored by name.

Of a table with one top that are boxes which cover it, and what rises above it (rims, risers, screens). Legs
and all else below the top are drawn but do not collide, since whatever falls past the top has failed already.
Of furniture with several surfaces, or a sloping one, all boards, walls and legs collide: what is convex by
itself is taken as it is, most of what furniture is made of. Of the rest, what has only faces at right angles
is made of boxes, exactly, and CoACD cuts what is left.

Convex parts of a drawer or a compartment with thin walls fill it. What of them is where the mesh has nothing,
in upright boxes over rectangles of the surface, is cut away, which leaves convex parts around each box.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import Manifold
from scipy.spatial import ConvexHull, cKDTree

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import NARROW_SURFACE, SURFACE_AIR, DecompositionConfig
from cluttergen_jax.assets.decompose import decompose
from cluttergen_jax.assets.mesh import Mesh, clean_mesh, component_labels, join_meshes
from cluttergen_jax.assets.orientation import orient_faces
from cluttergen_jax.assets.parts import (
    as_meshes,
    heights_over,
    hull_of,
    reduce_vertices,
    sound_points,
)
from cluttergen_jax.assets.shape import Joint, Piece, Shape
from cluttergen_jax.assets.solid import Solid, Voxels, solid_of
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
    cells_below,
    cover,
    free_height,
    largest_rectangle,
    level_faces,
    look_down,
    surface_heights,
)
from cluttergen_jax.errors import AssetError, ClutterGenError, PoolError
from cluttergen_jax.files import writing
from cluttergen_jax.geometry import box_corners, rotate_in_plane, yaw_matrix
from cluttergen_jax.importing.cache import files_outside, outside_note
from cluttergen_jax.importing.compartments import (
    open_compartments,
    why_not_closed,
    with_room_when_closed,
)
from cluttergen_jax.importing.furniture import (
    FoundSurface,
    find_furniture,
    find_surfaces,
    num_cells,
    read_upright,
    without_cracks,
)
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ReadOptions
from cluttergen_jax.kept_folder import PATIENCE, lock_beside
from cluttergen_jax.progress import Progress

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
    support, notes = _opened_or_not(shape, bool(joints))
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


def _opened_or_not(shape: Shape, is_posed: bool) -> tuple[SupportAsset, list[str]]:
    """`support_with_notes` of furniture with its doors and drawers open where that shows more surfaces.

    Args:
      is_posed: joints were asked for, and are left there.
    """
    opened, of_doors = (shape, []) if is_posed else open_compartments(shape)
    if opened is shape:
        support, notes = support_with_notes(shape)
        return support, [*of_doors, *notes]
    support, notes = support_with_notes(opened, shape)
    support, of_room = with_room_when_closed(support)
    if why := why_not_closed(support):
        support, notes = support_with_notes(shape)
        return support, [*notes, f"left as its file has it: {why}"]
    return support, [*of_doors, *notes, *of_room]


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


def support_with_notes(shape: Shape, closed: Shape | None = None) -> tuple[SupportAsset, list[str]]:
    """Finds the surfaces of a table, a shelf or a board, and makes it carry objects.

    The top is the height at which the largest level area is open to the sky. Its outline is covered with
    boxes to half a centimetre; gaps of up to 2 cm, as between planks, are closed. The region is the largest
    rectangle on it, along the sides of the smallest rectangle around the top. Other surfaces follow from the
    highest to the lowest (`importing.furniture`): shelf_1, shelf_2 ...

    Args:
      shape: furniture in metres, z up, as authored or scaled by its reader.
      closed: the same with its doors closed, where they are open in `shape`.

    Returns:
      The support on the floor, its bounding box (of `closed`, if given) centred on the z axis; and in words
      what is no surface of it and what does not collide.

    Raises:
      AssetError: nothing level of at least 10 cm x 10 cm that is open to the sky, and no other surface.
    """
    whole = join_meshes([piece.mesh for piece in shape.pieces])
    bounds = whole.bounds
    if closed is not None:
        bounds = join_meshes([piece.mesh for piece in closed.pieces]).bounds
    shift = -np.append(bounds.mean(0)[:2], bounds[0, 2])
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
        solids = [kept for points in solids if (kept := _lower(points, surface)) is not None]
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


def _lower(points: np.ndarray, surface: Surface) -> np.ndarray | None:
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


_SMALL = 0.03
_MINOR = 0.25
_MOST_VERTICES = 64
_MOST_PLANES = 48
_FILLS = 0.97
_FLATNESS = 0.001
_SPACE = 0.5
_SLACK = 0.002
_BOX = 0.985
"""The share of its box that a board with broken edges fills at least."""


def collision_of(
    meshes: Sequence[Mesh], yaw: float, surfaces: Sequence[Surface]
) -> tuple[list[Box], list[np.ndarray], list[str]]:
    """Boxes and convex parts, f64[V, 3] each, in place of surfaces; what is below 3 cm is left out.

    Args:
      meshes: world frame, metres.
      yaw: radians, the direction of the furniture's sides.
      surfaces: what is small and not within 50 cm above one of them, such as a caster, becomes its hull.

    Returns:
      Boxes, parts, and in words what could not be made to collide.
    """
    hulls: list[np.ndarray] = []
    rest: list[Mesh] = []
    notes: list[str] = []
    for mesh in chain.from_iterable(_components(clean_mesh(each)) for each in meshes):
        hull = _hull_if_convex(mesh)
        if hull is None:
            rest.append(mesh)
        else:
            hulls.append(hull)
    pieces = _components(clean_mesh(join_meshes(rest))) if rest else []
    pieces = [mesh for mesh in pieces if _size(mesh.vertices) >= _SMALL]
    with Progress("cutting into convex parts", len(pieces), "piece") as progress:
        for mesh in pieces:
            hull = _hull_if_convex(mesh)
            if hull is not None:
                hulls.append(hull)
            elif _size(mesh.vertices) < _MINOR and not any(
                _is_above(mesh.vertices, s) for s in surfaces
            ):
                hulls.append(sound_points(mesh.vertices))
            elif not any(is_inside(mesh.vertices, each) for each in hulls):
                try:
                    hulls += _cut(solid_of([mesh]), yaw)
                except AssetError as error:
                    notes.append(
                        f"a piece at {mesh.bounds.mean(0).round(2)} does not collide: {error.given}"
                    )
            progress.update()
    boxes = []
    parts = []
    for points in _without_inner([each for each in hulls if _size(each) >= _SMALL]):
        box = as_box(points, yaw)
        if box is None:
            parts.append(reduce_vertices(points, count=_MOST_VERTICES))
        else:
            boxes.append(box)
    return boxes, parts, notes


def cut_off(points: np.ndarray, T_world_surface: np.ndarray, height: float) -> np.ndarray | None:
    """What of a convex part, f64[V, 3], is below a height in a surface's frame; None if nothing is."""
    normal = T_world_surface[:3, 2]
    below = Manifold.hull_points(points).trim_by_plane(
        -normal, -(normal @ T_world_surface[:3, 3] + height)
    )
    vertices = np.array(below.to_mesh64().vert_properties)[:, :3]
    hull = hull_of(vertices) if len(vertices) > 3 else None
    return None if hull is None else vertices[hull.vertices]


def _components(mesh: Mesh) -> list[Mesh]:
    """Its pieces that share no vertex."""
    if not len(mesh.faces):
        return []
    edges = np.concatenate([mesh.faces[:, :2], mesh.faces[:, 1:]])
    own = component_labels(edges, len(mesh.vertices))[mesh.faces[:, 0]]
    found = []
    for each in np.unique(own):
        used, faces = np.unique(mesh.faces[own == each], return_inverse=True)
        found.append(Mesh(mesh.vertices[used], faces.reshape(-1, 3)))
    return found


def _hull_if_convex(mesh: Mesh) -> np.ndarray | None:
    """f64[V, 3]: the corners of a surface that is its own convex hull, or a flat sheet that is convex."""
    area = mesh.areas / 2
    points = sound_points(mesh.vertices)
    hull = hull_of(points)
    if hull is None:
        return None
    is_sheet = hull.volume < _FLATNESS * hull.area / 2
    if hull.area > (2.0 if is_sheet else 1.0) * area.sum() / _FILLS:
        return None
    centers = mesh.corners.mean(1)
    away = -heights_over(centers, hull).max(1)
    return points if (area * (away < _SLACK)).sum() > _FILLS * area.sum() else None


def _cut(solid: Solid, yaw: float) -> list[np.ndarray]:
    aligned = solid.mesh.transform(yaw_matrix(-yaw), np.zeros(3))
    boxes = _rectangular(aligned) if solid.is_exact else None
    if boxes is not None:
        return [points @ yaw_matrix(-yaw) for points in boxes]
    return decompose(solid, DecompositionConfig())


def _rectangular(mesh: Mesh) -> list[np.ndarray] | None:
    """A closed mesh whose faces are all at right angles as boxes, f64[8, 3] each; None if it is none such."""
    normals = mesh.normals
    straight = np.abs(normals).max(1) > 0.9999 * mesh.areas
    planes = [np.unique(np.round(mesh.vertices[:, axis], 4)) for axis in range(3)]
    if not straight.all() or max(map(len, planes)) > _MOST_PLANES:
        return None
    # Planes are a cell apart: lines through the cells' middles meet no edge.
    index = np.stack(
        [np.abs(mesh.vertices[:, k, None] - planes[k]).argmin(1) for k in range(3)], axis=1
    )
    shape = np.array([len(each) - 1 for each in planes])
    if shape.min() < 1:
        return None
    grid = Mesh(index.astype(np.float64), mesh.faces)
    turn = np.zeros((*shape[:2], shape[2] + 1), int)
    up = np.sign(grid.normals[:, 2]).astype(int)
    # Beside the cells' middles, so that no line meets the diagonal of a face.
    lower = np.array([-0.1283, -0.2917])
    for face, window, over, is_hit in cells_below(grid, lower, lower + shape[:2], shape[:2]):
        x, y = np.nonzero(is_hit)
        place = x + window[0].start, y + window[1].start, np.round(over[x, y]).astype(int)
        np.add.at(turn, place, up[face])
    is_solid = np.cumsum(turn, axis=2)[:, :, :-1] < 0
    boxes = []
    for a, b, c, d, e, f in _blocks(is_solid):
        sides = (planes[0][[a, b]], planes[1][[c, d]], planes[2][[e, f]])
        boxes.append(np.array(list(product(*sides))))
    return boxes


def _blocks(solid: np.ndarray) -> list[tuple[int, int, int, int, int, int]]:
    """Disjoint blocks of cells that fill the True cells of a bool[X, Y, Z], each grown along z, x, then y."""
    rest = solid.copy()
    found = []
    while rest.any():
        x, y, z = np.argwhere(rest)[0]
        ends = [x + 1, y + 1, z + 1]
        for axis in (2, 0, 1):
            while ends[axis] < rest.shape[axis]:
                more = [slice(x, ends[0]), slice(y, ends[1]), slice(z, ends[2])]
                more[axis] = slice(ends[axis], ends[axis] + 1)
                if not rest[tuple(more)].all():
                    break
                ends[axis] += 1
        rest[x : ends[0], y : ends[1], z : ends[2]] = False
        found.append((int(x), ends[0], int(y), ends[1], int(z), ends[2]))
    return found


def as_box(points: np.ndarray, yaw: float) -> Box | None:
    """The box that the hull of points is, its sides along the furniture's; None if it is none."""
    local = points @ yaw_matrix(yaw)
    low = local.min(0)
    high = local.max(0)
    hull = hull_of(points)
    if hull is None or hull.volume < _BOX * (high - low).prod():
        return None
    center = (yaw_matrix(yaw) @ ((low + high) / 2)).tolist()
    half = ((high - low) / 2).tolist()
    return Box((center[0], center[1], center[2]), (half[0], half[1], half[2]), yaw)


def _is_above(points: np.ndarray, surface: Surface) -> bool:
    """Whether the box around points reaches into the space above a surface."""
    local = surface.local(points)
    low = np.append(surface.polygon.min(0), _SLACK)
    high = np.append(surface.polygon.max(0), _SPACE)
    return bool((local.max(0) > low).all() and (local.min(0) < high).all())


def _size(points: np.ndarray) -> float:
    """Metres across the box around points."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def is_inside(points: np.ndarray, other: np.ndarray) -> bool:
    """Whether all points are inside the hull of others, to 2 mm."""
    if (points.min(0) < other.min(0) - _SLACK).any() or (
        points.max(0) > other.max(0) + _SLACK
    ).any():
        return False
    hull = hull_of(other)
    return hull is not None and bool(heights_over(points, hull).max() < _SLACK)


def _without_inner(hulls: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The convex parts that are not inside of another, the largest first."""
    kept: list[np.ndarray] = []
    for points in sorted(hulls, key=lambda each: -float(np.ptp(each, axis=0).prod())):
        if not any(is_inside(points, each) for each in kept):
            kept.append(points)
    return kept


_SAMPLES = 4096
"""Points on all surfaces of a link."""
_NO_LIMIT = 100.0
"""Radians or metres: files state such limits where they mean none."""


def moved_together(joints: Sequence[Joint], meshes: Sequence[Mesh]) -> list[list[Mesh]]:
    """Surfaces in groups: those that stand still first, then those of each joint; no group is empty."""
    moved = [set(joint.pieces) for joint in joints]
    still = set(range(len(meshes))).difference(*moved)
    groups = [[meshes[number] for number in sorted(group)] for group in (still, *moved)]
    return [group for group in groups if group]


def with_joints(support: SupportAsset, joints: Sequence[Joint]) -> SupportAsset:
    """A support with joints, each with what of the collision it moves: what lies nearest to its surfaces.

    Args:
      joints: world frame; they know the surfaces that they move.
    """
    moved = [joint.pieces for joint in joints]
    still = sorted(set(range(len(support.pieces))).difference(*moved))
    trees = []
    for group in (still, *moved):
        mesh = join_meshes([support.pieces[number].mesh for number in group]) if group else None
        trees.append(None if mesh is None else cKDTree(sample_surface(mesh, _SAMPLES, 0)))

    def nearest(points: np.ndarray) -> int:
        """The joint that moves f64[V, 3]; -1 for none."""
        far = [np.inf if tree is None else float(tree.query(points)[0].mean()) for tree in trees]
        return int(np.argmin(far)) - 1

    boxes = [nearest(box.mesh.vertices) for box in support.boxes]
    parts = [nearest(part.vertices) for part in support.parts]
    made = [
        replace(
            joint,
            range=_limits_of(joint),
            boxes=tuple(place for place, by in enumerate(boxes) if by == number),
            parts=tuple(place for place, by in enumerate(parts) if by == number),
        )
        for number, joint in enumerate(joints)
    ]
    return replace(support, joints=tuple(made))


def estimates_of(joints: Sequence[Joint]) -> list[str]:
    """What files do not state of joints that move in exports, in words."""
    missing: dict[tuple[str, ...], list[str]] = {}
    for what in ("mass", "damping", "friction", "armature"):
        names = tuple(joint.name for joint in joints if getattr(joint, what) is None)
        missing.setdefault(names, []).append(what)
    said = []
    for names, unstated in missing.items():
        if names:
            said.append(f"{', '.join(unstated)} of {', '.join(map(repr, names))}")
    if not said:
        return []
    return [f"its file states none, so exports with joints that move estimate: {'; '.join(said)}"]


def _limits_of(joint: Joint) -> tuple[float, float] | None:
    """Its limits with where it stands, which files may put beyond them; None where they limit nothing."""
    if joint.range is None or max(map(abs, joint.range)) > _NO_LIMIT:
        return None
    return min(joint.range[0], joint.value), max(joint.range[1], joint.value)


_START = 0.005
"""Metres over a surface from which on something hangs over it."""
# Of a region: metres from its edges, and the share of it, that do not count.
_INSET = 0.01
_SHARE = 0.02

# Metres, and the share of what is seen, by which parts may leave less.
_LESS = 0.02
_LESS_SHARE = 0.1

_CELL = 0.005
_VOXELS = 140
_INSETS = (0.0, 0.005, 0.01, 0.02)
"""Metres."""
_MOST_COLUMNS = 8
_MISSING = 0.05
_MOST_PARTS = 400
# Metres and cubic metres: thinner and smaller pieces of a part are dropped.
_THIN = 0.001
_GRAIN = 1e-7


@dataclass(frozen=True)
class Air:
    """Metres of free air over a surface: as seen, and as the collision leaves it; inf under the open sky."""

    seen: float
    collided: float

    @property
    def is_short(self) -> bool:
        """Whether the collision fills what is seen free."""
        return self.collided < self.seen - max(_LESS, _LESS_SHARE * min(self.seen, 1.0))


def air_over(mesh: Mesh, support: SupportAsset, surface: Surface) -> Air:
    """The air over the region of a surface, its edges aside; of the lowest places 2 % do not count.

    Args:
      mesh: what is seen of the furniture, world frame; support: with its collision.
    """
    half = np.maximum(np.array(surface.region.half_extents) - _INSET, 1e-3)
    inverse = np.linalg.inv(surface.T_world_surface)
    local = mesh.transform(inverse[:3, :3], inverse[:3, 3])
    turn = np.eye(4)
    turn[:2, :2] = rotate_in_plane(np.eye(2), -surface.region.yaw).T
    aligned = Mesh(local.vertices @ turn[:3, :3].T, local.faces)
    center = rotate_in_plane(np.array(surface.region.center), -surface.region.yaw)
    shape = np.maximum(np.ceil(2 * half / _CELL), 1).astype(int)
    over = np.full(shape, np.inf)
    for _, window, height, is_hit in cells_below(aligned, center - half, center + half, shape):
        hangs = is_hit & (height > _START)
        over[window] = np.where(hangs, np.minimum(over[window], height), over[window])
    heights = surface_heights(support, surface, _CELL)
    xy = rotate_in_plane(heights.centers - surface.region.center, -surface.region.yaw)
    is_in = (np.abs(xy) <= half).all(-1)
    left = np.where(heights.ground > _START, 0.0, heights.ceiling)[is_in]
    return Air(_low(over.ravel()), _low(left))


def _low(heights: np.ndarray) -> float:
    return float(np.sort(heights)[int(_SHARE * len(heights))]) if len(heights) else math.inf


def note_of_air(surface: Surface, before: Air, after: Air) -> str:
    """What is to be said of a surface over which the collision fills, or filled, what is seen free."""
    height = f"{surface.position[2]:.2f} m"
    seen = f"{_metres(after.seen)} of air are seen over it"
    left = _metres(after.collided)
    if after.collided < SURFACE_AIR:
        return f"no surface at {height}: {seen}, and its parts leave {left}"
    if after.is_short:
        return f"the surface at {height}: {seen}, and its parts leave {left}"
    if before.is_short:
        filled = f"convex parts left {_metres(before.collided)}"
        return f"the surface at {height}: {seen}, and {filled}: they were cut, and leave {left}"
    return ""


def _metres(height: float) -> str:
    return "all" if math.isinf(height) else f"{height:.2f} m"


@dataclass(frozen=True, eq=False)
class AirBox:
    """A box of air over a surface.

    Attributes:
      T_world_surface: f64[4, 4]; corners: f64[4, 2], in the surface's frame, counter-clockwise, metres.
      height: metres.
    """

    T_world_surface: np.ndarray
    corners: np.ndarray
    height: float

    @property
    def planes(self) -> list[tuple[np.ndarray, float]]:
        """Normals f64[3] that point out of the box, world frame, and offsets: the board below first."""
        following = np.roll(self.corners, -1, axis=0)
        sides = []
        for (x0, y0), (x1, y1) in zip(self.corners, following, strict=True):
            normal = np.array([y1 - y0, x0 - x1, 0.0]) / math.hypot(x1 - x0, y1 - y0)
            sides.append((normal, np.array([x0, y0, 0.0])))
        up = np.array([0.0, 0.0, 1.0])
        local = [(-up, np.zeros(3)), *sides, (up, self.height * up)]
        R = self.T_world_surface[:3, :3]
        shift = self.T_world_surface[:3, 3]
        return [(R @ normal, float(R @ normal @ (R @ point + shift))) for normal, point in local]


def columns_over(samples: np.ndarray, found: FoundSurface, surface: Surface) -> list[AirBox]:
    """Boxes of air in which nothing of a mesh is, over the largest rectangles of a surface.

    Over what leans over an edge, boxes farther inside are higher.

    Args:
      samples: f64[N, 3], points of the mesh, at most half a centimetre or so apart (`surface_samples`).
    """
    local = surface.local(samples)
    local = local[local[:, 2] > 2 * _START]
    top = float(local[:, 2].max(initial=0.0)) + 2 * _START
    low = surface.polygon.min(0)
    high = surface.polygon.max(0)
    local = local[((local[:, :2] > low) & (local[:, :2] < high)).all(1)]
    yaw = surface.region.yaw
    flat = rotate_in_plane(local[:, :2], -yaw)
    columns = []
    for span in cover(found.mask, _MISSING, _MOST_COLUMNS):
        ends = rotate_in_plane(found.corners(span), -yaw)
        highest = _LESS
        for inset in _INSETS:
            low = ends.min(0) + inset
            high = ends.max(0) - inset
            if (high - low).min() < _LESS:
                break
            is_over = ((flat > low + _START / 2) & (flat < high - _START / 2)).all(1)
            height = float(local[is_over, 2].min(initial=top)) - _START
            if height > highest:
                corners = box_corners(low, high)
                columns.append(
                    AirBox(surface.T_world_surface, rotate_in_plane(corners, yaw), height)
                )
                highest = height + _START
    return columns


def surface_samples(mesh: Mesh) -> np.ndarray:
    """f64[N, 3]: points of a surface, every point of it near one."""
    return Voxels.of(mesh, _VOXELS).samples


def without_air(parts: list[np.ndarray], columns: list[AirBox]) -> list[np.ndarray]:
    """Convex parts, f64[V, 3] each, with what is inside of the columns cut away."""
    for column in columns:
        cut = [piece for points in parts for piece in _around(points, column)]
        if len(cut) > _MOST_PARTS:
            break
        parts = cut
    return parts


def _around(points: np.ndarray, column: AirBox) -> list[np.ndarray]:
    """A part itself if it is not in the box, or the convex pieces of it that are around it."""
    local = (points - column.T_world_surface[:3, 3]) @ column.T_world_surface[:3, :3]
    low = column.corners.min(0)
    high = column.corners.max(0)
    is_beside = (local[:, :2].max(0) <= low).any() or (local[:, :2].min(0) >= high).any()
    if is_beside or local[:, 2].max() <= _THIN or local[:, 2].min() >= column.height:
        return [points]
    rest = Manifold.hull_points(points)
    around = []
    for normal, offset in column.planes:
        outside, rest = rest.split_by_plane(normal, offset)
        around.append(outside)
    if rest.is_empty() or not _is_thick(_corners(rest)):
        return [points]
    corners = [_corners(each) for each in around if not each.is_empty()]
    return [each for each in corners if _is_thick(each)]


def _corners(solid: Manifold) -> np.ndarray:
    return np.array(solid.to_mesh64().vert_properties)[:, :3]


def _is_thick(points: np.ndarray) -> bool:
    hull = hull_of(points) if len(points) > 3 else None
    return hull is not None and hull.volume > max(_GRAIN, _THIN * hull.area / 2)
