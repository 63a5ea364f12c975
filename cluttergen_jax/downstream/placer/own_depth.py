"""Stable places for an object in a user's own depth images: no bank, no pool, no scene."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from cluttergen_jax.assets import Box, ObjectAsset, Rectangle, SupportAsset, find_support
from cluttergen_jax.assets import parse_region as region_of_text
from cluttergen_jax.config import check_range
from cluttergen_jax.downstream.bank_scenes import check_one_level
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import DepthView, QueryMaker
from cluttergen_jax.downstream.placer.proposers import FullState, find_placer
from cluttergen_jax.downstream.placer.query import (
    PlacementQuery,
    Placer,
    PlainPlacer,
    Proposals,
    ask_plain,
    check_proposals,
    is_plain,
    pad_map,
)
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.generation import body_of, problem_alone
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.numerics import new_key, with_own_settings
from cluttergen_jax.own_parts import array_of, is_own, part_name
from cluttergen_jax.placement import VOID, HeightMap
from cluttergen_jax.sensing import Camera, Grid, level_camera

_FARTHEST = 20.0
"""Metres: images of which half shows more are not in metres."""
_WIDTH = 160
"""Pixels across of the images that placers learn from; of larger ones every second, third ... counts."""
_SLAB = 0.02
_BELOW = 0.03
"""Metres below the level at which a cell has nothing to stand on."""
_LEVEL = 0.015
_ABOVE = 0.4
# Shares of the points over a region that lie on its level, at least, and of its cells that are seen.
_LEAST_LEVEL = 0.02
_LEAST_SEEN = 0.05
_CELLS = 16
"""Maps have a multiple of so many cells a side, so that one program serves many regions."""
_COLUMNS = 512
_TURN = 1e-3
"""By which a turn that was written with few digits may be off."""
_MOST_SEED = 999_999
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_FORMS = "a `Rectangle`, 'X,Y,W,D[,YAW]' (metres, degrees) with `height`, or a support or its name"


class PlaceProposals(NamedTuple):
    """Where an object could be let go, best first.

    Attributes:
      poses: f64[M, 7], T_world_mesh: metres, then a quaternion wxyz.
      chances: f64[M], that it will stand there and disturb nothing; nan from placers that tell none.
    """

    poses: np.ndarray
    chances: np.ndarray


@with_own_settings
def propose_places(
    depth: Any,
    K: Any,
    T_world_camera: Any,
    region: Rectangle | SupportAsset | str,
    mesh: Any,
    *,
    height: float | None = None,
    placer: str | Path | Placer | PlainPlacer = "scored",
    seed: int = 0,
) -> PlaceProposals:
    """Where an object will stand on what depth images of your own show.

        import numpy as np, trimesh
        import cluttergen_jax as cg

        K = np.array([[154.0, 0, 80], [0, 154, 60], [0, 0, 1]])
        T_world_camera = np.diag([1.0, -1, -1, 1])  # looks straight down ...
        T_world_camera[2, 3] = 0.75                 # ... from 0.75 m above an empty table at z = 0
        depth = np.full((120, 160), 0.75)
        cube = trimesh.creation.box((0.06, 0.06, 0.06))
        poses, chances = cg.propose_places(depth, K, T_world_camera, "0,0,0.4,0.3", cube)

    What stands in the region is known from the images alone. The first pose is the best; let the object go
    there. Errors of the camera's height and tilt of up to 1 cm and 2 degrees are corrected by the level that
    it sees.

    Args:
      depth: f[H, W], metres along the optical axis; nan or 0 where nothing was measured, inf where nothing is
        (over the region that counts as not measured). Or several images, with K and T_world_camera of each.
      K: f[3, 3], pixels from the picture's corner, so that the first one's middle is at (0.5, 0.5); one for
        all images will do.
      T_world_camera: f[4, 4], metres, in OpenCV's axes: x right, y down, z forward; z of the world is up.
        From OpenGL's axes: `T @ np.diag([1, -1, -1, 1])`.
      region: where the object's middle may be, on a flat surface: a `Rectangle`, or 'X,Y,W,D[,YAW]' in world
        metres and degrees. Or a support in its own frame, or its name: its region.
      mesh: the object as it shall stand, z up: the path of its file, what has `vertices` and `faces`
        (trimesh), or an object of a pool.
      height: metres, the level of a region in the world; 0 if not given.
      placer: "scored", or another that looks (`cluttergen placer`), by name, folder or in Python.
      seed: of candidates.

    Returns:
      `poses` f64[M, 7] of the mesh's own frame in the world, and `chances` f64[M]; M is 5 at most.

    Raises:
      ConfigError: shapes or numbers are of no image, no camera sees the region, or its level is not seen.
      AssetError: the mesh is no body.
      PoolError: there is no such placer or support.
    """
    check_range("seed", seed, 0, _MOST_SEED, 0)
    views = [
        _view(*each, number)
        for number, each in enumerate(zip(*_as_lists(depth, K, T_world_camera), strict=True))
    ]
    support, is_known = _support_of(region, height)
    asset, T_object_mesh = body_of(mesh)
    radius = float(np.linalg.norm(asset.half_extents[:2]))
    known = support if is_known else None
    maker = copy(_maker_of(known, support.top, asset, support.region, 2 * radius))
    views = [_over_region(view, maker) for view in views]
    _check_sight(views, maker)
    seen = [DepthView(each.depth, level_camera(*each, maker.grid)) for each in views]
    if not is_known:
        maker.grid = _cut_off(maker.grid, seen)
    sight = maker.fuse(seen, REALSENSE, np.random.default_rng(seed))
    found = _ask(placer, seed, _pad(maker.query(sight, 0)))
    half = np.asarray(support.region.half_extents)
    is_inside = (np.abs(found.pose[:, :2]) <= half).all(1) & np.isfinite(found.pose).all(1)
    local = np.array(found.pose, np.float64)[is_inside]
    T_region_object = matrix_of(
        np.array([[*each[:3], *yaw_quaternion(each[3])] for each in local]).reshape(-1, 7)
    )
    poses = pose_of(maker.T_world_region @ T_region_object @ T_object_mesh)
    return PlaceProposals(poses, np.array(found.score, np.float64)[is_inside])


def _as_lists(depth: Any, K: Any, T: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """Images, intrinsics and poses, as many of each."""
    if isinstance(depth, Sequence) and not len(depth):
        raise ConfigError("no depth image", "one or more, f[H, W]")
    is_many = isinstance(depth, list | tuple) and np.ndim(depth[0]) == 2
    depths = list(depth) if is_many or np.ndim(depth) == 3 else [depth]
    number = len(depths)
    Ks = _matrices(K, "K", 3)
    Ks = Ks * number if len(Ks) == 1 else Ks
    Ts = _matrices(T, "T_world_camera", 4)
    if len(Ks) != number or len(Ts) != number:
        raise ConfigError(
            f"{number} depth images, {len(Ks)} K and {len(Ts)} T_world_camera",
            "one T_world_camera for each image, and one K for each or for all",
        )
    return depths, Ks, Ts


def _matrices(given: Any, name: str, side: int) -> list[np.ndarray]:
    """f64[side, side], one or several."""
    try:
        found = np.stack([array_of(each) for each in given]).astype(np.float64)
        found = found[None] if found.ndim == 2 else found
        if found.shape[1:] == (side, side):
            return [_nearest_rigid(each) if side == 4 else each for each in found]
        told = f"shape {np.shape(given)}"
    except (TypeError, ValueError) as error:
        told = str(error)
    raise ConfigError(f"{name}: {told}", f"f[{side}, {side}], or one for each image")


def _nearest_rigid(T: np.ndarray) -> np.ndarray:
    """The pose with its turn made exact, where it is one to three digits."""
    turn = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _TURN:
        return T
    u, _, vt = np.linalg.svd(turn)
    exact = T.copy()
    exact[:3, :3] = u @ vt
    return exact


def _view(depth: Any, K: np.ndarray, T: np.ndarray, number: int) -> DepthView:
    """One image as it is worked with: f32[H, W], nan where nothing was measured."""
    which = f"depth image {number}" if number else "depth"
    given = array_of(depth)
    if given.ndim != 2 or min(given.shape) < 2 or given.dtype.kind not in "fiu":
        raise ConfigError(
            f"{which} of shape {given.shape} and type {given.dtype}",
            "f[H, W], metres, or a list of such",
            "depth[..., 0] of an image with channels",
        )
    metres = given.astype(np.float64)
    measured = metres[np.isfinite(metres) & (metres != 0)]
    if not len(measured):
        raise ConfigError(f"{which} without a measured pixel", "metres along the optical axis")
    if measured.min() < 0:
        raise ConfigError(
            f"{which} with {measured.min():g} m", "metres in front of the camera, above 0", "-depth"
        )
    if given.dtype.kind != "f" or np.median(measured) > _FARTHEST:
        raise ConfigError(
            f"{which} of {given.dtype} whose middle value is {np.median(measured):g}",
            f"metres as floats, most of them up to {_FARTHEST:g}",
            "depth / 1000, if it is in millimetres",
        )
    height, width = metres.shape
    camera = Camera(width, height, K, T)
    middle = camera.K[:2, 2]
    if not ((middle > 0) & (middle < (width, height))).all():
        raise ConfigError(
            f"K with its principal point at {middle.round(1).tolist()} for {which} of {width} x {height} "
            "pixels",
            "K of this picture's size",
            "K[:2] * (the picture's width / the width that K is for)",
        )
    metres[metres == 0] = np.nan
    return _thin(metres, camera)


def _thin(depth: np.ndarray, camera: Camera) -> DepthView:
    """Every second, third ... pixel of a large picture, as many as placers learn from."""
    step = max(1, camera.width // _WIDTH)
    first = step // 2
    kept = np.ascontiguousarray(depth[first::step, first::step], np.float32)
    K = camera.K.copy()
    K[:2, :2] /= step
    K[:2, 2] = (K[:2, 2] - first - 0.5) / step + 0.5
    height, width = kept.shape
    return DepthView(kept, Camera(width, height, K, camera.T_world_camera))


def _support_of(region: Any, height: float | None) -> tuple[SupportAsset, bool]:
    """What carries the region; whether it is known beyond it."""
    try:
        if isinstance(region, str) and region[:1] in "-+.0123456789" and region:
            region = region_of_text(region, Rectangle())
        if isinstance(region, str | Path):
            region = find_support(region)
    except (ConfigError, PoolError) as error:
        raise ConfigError(f"region {region!r}: {error.given}", _FORMS, "'0,0,0.4,0.3'") from error
    if isinstance(region, SupportAsset):
        if height is not None:
            raise ConfigError(f"height = {height!r} beside a support", "one of both")
        check_one_level(region, "a placer")
        return region, True
    if not isinstance(region, Rectangle):
        raise ConfigError(f"region = {region!r}", _FORMS, "'0,0,0.4,0.3'")
    level = 0.0 if height is None else height
    if not isinstance(level, int | float) or not np.isfinite(level):
        raise ConfigError(f"height = {height!r}", "metres, a finite number", "height=0.0")
    return _slab(region, float(level)), False


def _slab(region: Rectangle, level: float, beyond: float = 0.0) -> SupportAsset:
    half = [each + beyond for each in region.half_extents]
    box = Box((*region.center, level - _SLAB / 2), (half[0], half[1], _SLAB / 2), region.yaw)
    usual = find_support("table")
    return replace(usual, name="region", label="region", boxes=(box,), top=level, region=region)


@lru_cache(maxsize=16)
def _maker_of(
    known: SupportAsset | None, level: float, asset: ObjectAsset, region: Rectangle, beyond: float
) -> QueryMaker:
    """Of queries for an object on a support, or on a level that goes on so far beyond the region."""
    support = known or _slab(region, level, beyond)
    return QueryMaker(problem_alone(asset, support, region))


def _over_region(view: DepthView, maker: QueryMaker) -> DepthView:
    """With nan where nothing came back though the region's level is behind: it was not measured."""
    depth = view.depth
    camera = view.camera
    is_nothing = np.isinf(depth)
    if not is_nothing.any():
        return view
    T = maker.T_world_region
    eye = (camera.eye - T[:3, 3]) @ T[:3, :3]
    way = camera.directions @ T[:3, :3]
    down = np.where(way[..., 2] < -1e-9, way[..., 2], np.nan)
    place = eye[:2] + way[..., :2] * (-eye[2] / down)[..., None]
    half = np.abs(maker.grid.corner)
    with np.errstate(invalid="ignore"):
        is_over = (np.abs(place) < half).all(-1)
    return DepthView(np.where(is_nothing & is_over, np.nan, depth).astype(np.float32), camera)


def _local_points(view: DepthView, grid: Grid) -> np.ndarray:
    """f64[N, 3]: what a view shows, region frame."""
    points = view.camera.points(view.depth)[np.isfinite(view.depth)]
    T = grid.T_world_region
    return (points - T[:3, 3]) @ T[:3, :3]


def _seen_over(views: Sequence[DepthView], maker: QueryMaker) -> np.ndarray:
    """f64[N, 3]: points over the region, as high as objects are or as low as a wrong level makes them."""
    half = maker.half_extents
    points = np.concatenate([_local_points(view, maker.grid) for view in views])
    return points[(np.abs(points[:, :2]) < half).all(1)]


def _share_in_view(views: Sequence[DepthView], maker: QueryMaker) -> float:
    """Of the region's middle, corners and what is between, the share that is in some picture."""
    half = maker.half_extents
    line = np.linspace(-1, 1, 9)
    flat = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2) * half
    T = maker.T_world_region
    points = np.c_[flat, np.zeros(len(flat))] @ T[:3, :3].T + T[:3, 3]
    is_seen = np.zeros(len(points), bool)
    for _, camera in views:
        pixels, far = camera.project(points)
        is_seen |= (far > 0) & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(1)
    return float(is_seen.mean())


def _check_sight(views: Sequence[DepthView], maker: QueryMaker) -> None:
    """Refuses pictures that do not show the region, or a level at which nothing lies.

    Raises:
      ConfigError: so it is; the message names other axes in which they would show it.
    """
    points = _seen_over(views, maker)
    is_near = np.abs(points[:, 2]) < _ABOVE
    if _share_in_view(views, maker) < _LEAST_SEEN or not is_near.any():
        others = {
            "T_world_camera @ np.diag([1, -1, -1, 1]), for what is given in OpenGL's axes": (
                lambda T: T @ _FLIP
            ),
            "np.linalg.inv(T_world_camera), for what is given as T_camera_world": inverse,
            "np.linalg.inv(T_world_camera) @ np.diag([1, -1, -1, 1]), for a view matrix of OpenGL": (
                lambda T: inverse(T) @ _FLIP
            ),
        }
        hint = "x right, y down, z forward in the camera's frame, z up in the world"
        for text, change in others.items():
            turned = [
                DepthView(depth, replace(each, T_world_camera=change(each.T_world_camera)))
                for depth, each in views
            ]
            if _share_in_view(turned, maker) >= _LEAST_SEEN and _level_share(turned, maker):
                hint = text
        eyes = [np.round(camera.eye, 3).tolist() for _, camera in views]
        ways = [np.round(camera.rotation[:, 2], 2).tolist() for _, camera in views]
        raise ConfigError(
            f"cameras at {eyes} that look along {ways} and see nothing of the region",
            "a camera that sees the region",
            hint,
        )
    if not _level_share(views, maker):
        level = float(maker.T_world_region[2, 3])
        heights, edges = np.histogram(
            points[:, 2], bins=np.arange(points[:, 2].min(), points[:, 2].max() + 0.011, 0.01)
        )
        most = level + float(edges[heights.argmax()]) + 0.005
        raise ConfigError(
            f"a region at {level:g} m, where cameras see next to nothing",
            "the height of a flat surface that they see",
            f"height={most:.2f}, where most of what they see there is",
        )


def _level_share(views: Sequence[DepthView], maker: QueryMaker) -> bool:
    """Whether enough of what is seen over the region lies on its level."""
    points = _seen_over(views, maker)
    if not len(points):
        return False
    return bool((np.abs(points[:, 2]) < _LEVEL).mean() >= _LEAST_LEVEL)


def _cut_off(grid: Grid, views: Sequence[DepthView]) -> Grid:
    """Without ground in cells through which something far below the level is seen."""
    columns = grid.columns.reshape(-1, 3)
    is_off = np.zeros(len(columns), bool)
    for depth, camera in views:
        pixels, far = camera.project(columns)
        column, row = np.floor(pixels).astype(int).T
        is_in = (far > 0) & (column >= 0) & (column < camera.width)
        is_in &= (row >= 0) & (row < camera.height)
        shown = np.full(len(columns), np.nan)
        shown[is_in] = depth[row[is_in], column[is_in]]
        fall = (camera.eye[2] - columns[:, 2]) / np.maximum(far, 1e-9)
        is_off |= np.isfinite(shown) & (np.nan_to_num(shown - far) * fall > _BELOW)
    bare = np.where(is_off.reshape(grid.bare.shape), np.float32(VOID), grid.bare)
    return replace(grid, bare=bare)


def _pad(query: PlacementQuery) -> PlacementQuery:
    """The same in arrays of few sizes, so that one program serves many regions and objects."""

    def larger(surface: HeightMap) -> HeightMap:
        shape = [-(-side // _CELLS) * _CELLS for side in surface.height.shape]
        return surface.replace(height=pad_map(surface.height, (shape[0], shape[1])))

    under: Any = query.under
    more = max(0, _COLUMNS - len(under.bottom))
    under = under.replace(
        xy=np.pad(under.xy, [(0, more), (0, 0)]),
        bottom=np.pad(under.bottom, (0, more)),
        is_column=np.pad(under.is_column, (0, more)),
    )
    return query.replace(
        heights=larger(query.heights), ceilings=larger(query.ceilings), under=under
    )


_compiled: Any = jax.jit(lambda placer, key, query: placer(key, query))


def _ask(placer: str | Path | Placer | PlainPlacer, seed: int, query: PlacementQuery) -> Proposals:
    found = find_placer(placer)
    if isinstance(found, FullState):
        raise ConfigError(
            f"placer {found.method!r}, which knows the whole scene",
            "one that looks at images",
            "placer='scored'",
        )
    key = new_key(seed)
    if is_plain(found):
        return ask_plain(found, key, query)
    answer: Any = _compiled(found, key, query)
    return check_proposals(answer, part_name(found)) if is_own(found) else answer
