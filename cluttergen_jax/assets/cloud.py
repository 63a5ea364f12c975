"""Points of surfaces: samples, clouds whose every prefix is a good sample, and whole scenes as PLY."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.solid import Solid, Voxels
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.geometry import rotate_in_plane, transform_points


class Samples(NamedTuple):
    """Points of a mesh: f64[N, 3], i64[N], the triangle of each, and f64[N, 3], the shares of its corners."""

    points: np.ndarray
    faces: np.ndarray
    weights: np.ndarray


def sample_faces(mesh: Mesh, count: int, seed: int) -> Samples:
    """Points on the mesh, uniform by area, the same for the same seed."""
    return next(_sample_blocks(mesh, count, count, seed))


def _sample_blocks(mesh: Mesh, count: int, size: int, seed: int) -> Iterator[Samples]:
    """The points of `sample_faces`, so many at a time."""
    area = np.cumsum(mesh.areas)
    rng = np.random.default_rng(seed)
    corners = mesh.corners
    places = rng.uniform(0, area[-1], count)
    squares = rng.uniform(size=count)
    alongs = rng.uniform(size=count)
    for start in range(0, count, size):
        block = slice(start, start + size)
        which = np.searchsorted(area, places[block], side="right").clip(0, len(area) - 1)
        root = np.sqrt(squares[block])
        along = alongs[block]
        weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
        yield Samples(np.einsum("nk,nkd->nd", weights, corners[which]), which, weights)


def sample_surface(mesh: Mesh, count: int, seed: int) -> np.ndarray:
    """f64[count, 3]: the points of `sample_faces`."""
    return sample_faces(mesh, count, seed).points


def sample_exposed(mesh: Mesh, count: int, seed: int, is_convex: bool = False) -> np.ndarray:
    """f64[<= count, 3]: of three times as many points of a surface the first that can be seen from outside.

    Of a convex surface all can.
    """
    voxels = None if is_convex else Voxels.of(mesh)
    number = 0
    found = [np.zeros((0, 3))]
    for points, _, _ in _sample_blocks(mesh, 3 * count, count, seed):
        found.append(points if voxels is None else points[voxels.is_exposed(points)])
        number += len(found[-1])
        if number >= count:
            break
    return np.concatenate(found)[:count]


def sample_solid(solid: Solid, count: int, seed: int) -> np.ndarray:
    """f64[<= count, 3]: points of the object's own surface that can be seen from outside.

    Of an exact solid all of its surface; else of all triangles those that a flood from outside reaches.
    """
    if solid.is_exact:
        return sample_surface(solid.mesh, count, seed)
    return sample_exposed(solid.surface, count, seed)


def surface_cloud(solid: Solid, seed: int = 0) -> np.ndarray:
    """f64[1024, 3]: points of the outer surface, uniform by area, in farthest-point order."""
    points = sample_solid(solid, CLOUD_SIZE, seed)
    if len(points) < CLOUD_SIZE:
        points = np.concatenate([points, sample_solid(solid, 8 * CLOUD_SIZE, seed + 1)])[
            :CLOUD_SIZE
        ]
    return points[farthest_first(points)]


def farthest_first(
    points: np.ndarray, count: int | None = None, weight: np.ndarray | float = 1.0
) -> np.ndarray:
    """i64[M]: an order in which each point is the farthest from all before it.

    Starts with the point farthest from the mean, so that the order does not depend on how points came.

    Args:
      points: f64[N, D].
      count: how many to take, all of them by default.
      weight: f64[N]: distances to points that are to lie denser count for more.
    """
    order = np.empty(len(points) if count is None else min(count, len(points)), np.int64)
    # Axis by axis: sums along the short axis of an array are slow.
    axes = list(np.ascontiguousarray(points.T))
    squared_weight = weight**2
    distance = np.full(len(points), np.inf)
    current = int(((points - points.mean(0)) ** 2).sum(1).argmax())
    for index in range(len(order)):
        order[index] = current
        squared = sum((axis - axis[current]) ** 2 for axis in axes)
        distance = np.minimum(distance, squared)
        current = int((distance * squared_weight).argmax())
    return order


_DENSE = 8
"""Surface samples per cloud point from which a point's colour is taken."""
_PER_SQUARE_METRE = 4000


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a scene.

    Attributes:
      points: f32[P, 3], metres, world frame.
      colours: uint8[P, 3].
      labels: i32[P]: 1 for the support's top, 2 + k for object k (as in `sensing.rays`).
    """

    points: np.ndarray
    colours: np.ndarray
    labels: np.ndarray


def cloud_colours(asset: ObjectAsset) -> np.ndarray:
    """uint8[1024, 3]: the colour of the surface next to each point of the asset's cloud."""
    from scipy.spatial import cKDTree

    if not asset.pieces:
        return np.full((len(asset.cloud), 3), 180, np.uint8)
    areas = np.array([piece.mesh.areas.sum() for piece in asset.pieces])
    counts = np.ceil(_DENSE * len(asset.cloud) * areas / max(areas.sum(), 1e-30)).astype(int)
    spots = [np.zeros((0, 3))]
    shades = [np.zeros((0, 3))]
    for seed, (piece, count) in enumerate(zip(asset.pieces, counts.tolist(), strict=True)):
        if count:
            points, shade = coloured_points(piece, count, seed)
            spots.append(points)
            shades.append(shade)
    nearest = cKDTree(np.concatenate(spots)).query(asset.cloud)[1]
    return np.round(255 * np.clip(np.concatenate(shades)[nearest], 0, 1)).astype(np.uint8)


def coloured_points(piece: Piece, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """f64[count, 3], even over the area, and f64[count, 3], the colours there, each in [0, 1]."""
    points, faces, weights = sample_faces(piece.mesh, count, seed)
    shade = np.tile(np.array(piece.rgba[:3]), (count, 1))
    if piece.uv is not None and piece.texture is not None:
        uv = np.einsum("nk,nkd->nd", weights, piece.uv[piece.mesh.faces[faces]])
        shade *= piece.texture.at(uv)
    return points, shade


def scene_points(
    objects: Sequence[ObjectAsset], poses: np.ndarray, support: SupportAsset | None
) -> Cloud:
    """The surface points of all objects (1,024 each) and of the support's region (4,000 per square metre).

    These are whole surfaces, hidden sides included; what one camera sees is a `sensing.View`.
    """
    points = [np.zeros((0, 3))]
    colours = [np.zeros((0, 3), np.uint8)]
    labels = [np.zeros(0, np.int32)]
    if support is not None and (support.pieces or support.boxes or support.parts):
        top = top_points(support)
        drawn = [each.mean_rgba for each in support.pieces] or [each.rgba for each in support.boxes]
        rgba = [*drawn, PART_RGBA][0]
        points.append(top)
        colours.append(np.tile(np.round(255 * np.array(rgba[:3])).astype(np.uint8), (len(top), 1)))
        labels.append(np.full(len(top), 1, np.int32))
    known: dict[int, np.ndarray] = {}
    for number, (asset, pose) in enumerate(zip(objects, poses, strict=True)):
        if id(asset) not in known:
            known[id(asset)] = cloud_colours(asset)
        points.append(transform_points(pose, asset.cloud))
        colours.append(known[id(asset)])
        labels.append(np.full(len(asset.cloud), 2 + number, np.int32))
    return Cloud(
        np.concatenate(points).astype(np.float32), np.concatenate(colours), np.concatenate(labels)
    )


def top_points(support: SupportAsset) -> np.ndarray:
    """f64[P, 3]: an even grid over the support's default region, at its top, world frame."""
    region = support.region
    half = np.array(region.half_extents)
    counts = np.maximum(np.round(2 * half * np.sqrt(_PER_SQUARE_METRE)), 2).astype(int)
    x, y = (np.linspace(-h, h, n) for h, n in zip(half, counts, strict=True))
    flat = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    return support.on_top(rotate_in_plane(flat, region.yaw) + region.center)


def ply_of(cloud: Cloud) -> bytes:
    """A binary PLY file: x, y, z in metres (float), red, green, blue (uchar), label (int)."""
    kind = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3), ("label", "<i4")])
    rows = np.empty(len(cloud.points), kind)
    rows["xyz"] = cloud.points
    rows["rgb"] = cloud.colours
    rows["label"] = cloud.labels
    properties = [f"property float {axis}" for axis in "xyz"]
    properties += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres, world frame, z up; label 1 is the support's top, 2 + k is object k",
        f"element vertex {len(rows)}",
        *properties,
        "property int label",
        "end_header",
    ]
    return "\n".join(lines).encode() + b"\n" + rows.tobytes()
