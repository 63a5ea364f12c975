"""Datasets of labelled grasps in clutter, a scene at a time, resumable.

Besides Parquet the files of other projects are written. Those of VGN and GIGA (Breyer et al., "Volumetric
Grasping Network: Real-time 6 DOF Grasp Detection in Clutter", CoRL 2020, and its code; Jiang et al., RSS
2021) are in their frames and numbers; those of ACRONYM, Contact-GraspNet and GraspNet `object_sets` writes.
VGN's task frame has its origin at a lower corner of a cube; the table lies one finger's depth above it. Its
tool frame is at the root of the fingers. Scenes have names that begin with a letter: they are read from a
table, where digits alone would be a number.

dataset.json                    how it was made
grasps.parquet, README.md       every candidate with its labels, and the card
raw/                            VGN's files: setup.json, grasps.csv, scenes/scene_NUMBER.npz
                                GIGA's: meshes, mesh_pose_list/scene_NUMBER.npz, occ/scene_NUMBER/0000.npz
voxels/                         the same as volumes: grasps.csv, scenes/scene_NUMBER.npz
acronym/, graspnet/             as `acronym` and `graspnet` tell
parts/NUMBER.parquet            the candidates of a scene, written when all else of it is there
"""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.assets import Mesh, ObjectAsset, SupportAsset, join_meshes
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.downstream.robot.grasping.acronym import DEPTH, TABLE_TOP, check_installed
from cluttergen_jax.downstream.robot.grasping.arrays import write_mesh, write_npz
from cluttergen_jax.downstream.robot.grasping.candidates import Union
from cluttergen_jax.downstream.robot.grasping.clutter import (
    FINGER_DEPTH,
    LIFT,
    RAISED,
    Lift,
    LiftEnd,
    LiftScene,
    Source,
    StillScene,
    label_grasps,
)
from cluttergen_jax.downstream.robot.grasping.object_labels import can_hold
from cluttergen_jax.downstream.robot.grasping.object_sets import (
    ACRONYM_FOLDER,
    GRASPNET_FOLDER,
    SEEN,
    ObjectSets,
)
from cluttergen_jax.downstream.robot.grasping.suction import (
    Hand,
    LiftCups,
    StillCups,
    SuctionCup,
    can_seal,
    draw_cups,
)
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of, rigid, shift_along
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import versions
from cluttergen_jax.files import remove_partial, write_atomically, writing
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import find_backend
from cluttergen_jax.scene import (
    Scene,
    assets_section,
    front_matter,
    read_bank,
    read_scenes,
    write_unless_own,
)
from cluttergen_jax.sensing import Camera
from cluttergen_jax.stores import BlockStore
from cluttergen_jax.tables import markdown_table

CUBE = 0.3
"""Metres: the cube's side, six times `FINGER`."""
FINGER = 0.05
"""Metres that a finger is long there."""
RESOLUTION = 40
# Of pictures, pixels; half of theirs.
WIDTH = 320
HEIGHT = 240
FOCAL = 270.0

_TRUNCATION = 4
"""Voxels around a surface within which distances are kept."""
_EDGE = 0.98
"""Truncated distances nearer to 1 are not in their grids."""
_FAR = (1.6, 2.4)
_TILT = np.pi / 4
_OCCUPANCY = 100_000
"""Points of a scene that are said to be inside an object or not, as GIGA's script draws them."""
_AROUND = 0.02
"""Metres by which they reach beyond the objects."""
CSV = "scene_id,qx,qy,qz,qw,x,y,z,width,label"
VOXEL_CSV = "scene_id,qx,qy,qz,qw,i,j,k,width,label"


def task_frame(support: SupportAsset) -> np.ndarray:
    """f64[4, 4]: T_world_task, a lower corner of the cube, which has the region's middle and turn."""
    turn = support.region.yaw
    cos = np.cos(turn)
    sin = np.sin(turn)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = support.region_points[0]
    corner = middle[:2] + rotate_in_plane(np.array([-CUBE / 2, -CUBE / 2]), turn)
    return rigid(rotation, np.array([*corner, middle[2] - FINGER]))


def draw_cameras(T_world_task: np.ndarray, number: int, rng: np.random.Generator) -> list[Camera]:
    """Cameras on a dome around the cube's foot, as VGN draws them; they look at the table's middle."""
    middle = (T_world_task @ [CUBE / 2, CUBE / 2, FINGER, 1.0])[:3]
    cameras = []
    for _ in range(number):
        tilt = rng.uniform(0.02, _TILT)
        turn = rng.uniform(0, 2 * np.pi)
        far = rng.uniform(*_FAR) * CUBE
        away = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        cameras.append(Camera.looking(middle + far * away, middle, WIDTH, HEIGHT, FOCAL))
    return cameras


def tsdf_grid(
    depths: Sequence[np.ndarray], cameras: Sequence[Camera], T_world_task: np.ndarray
) -> np.ndarray:
    """f32[1, N, N, N]: truncated signed distances of `RESOLUTION` voxels a side, x first.

    As VGN's networks read them: (d + 1) / 2 of a distance d in front of (above 0) or behind the surface, in
    units of four voxels; 0 where nothing was measured or the surface is farther away than that.

    Args:
      depths: f32[H, W] each, metres along the optical axis; not finite where nothing was measured.
      cameras: where they were taken, as far as is known.
    """
    voxel = CUBE / RESOLUTION
    steps = (np.arange(RESOLUTION) + 0.5) * voxel
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points @ T_world_task[:3, :3].T + T_world_task[:3, 3]
    total = np.zeros(len(points))
    weight = np.zeros(len(points))
    for depth, camera in zip(depths, cameras, strict=True):
        pixels, far = camera.project(points)
        column, row = np.floor(pixels).astype(int).T
        is_seen = (
            (far > 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        )
        measured = np.full(len(points), np.nan)
        measured[is_seen] = depth[row[is_seen], column[is_seen]]
        # Along the ray, not along the optical axis.
        slant = np.linalg.norm(points - camera.eye, axis=1) / np.maximum(far, 1e-9)
        distance = (measured - far) * slant / (_TRUNCATION * voxel)
        is_used = np.isfinite(distance) & (distance > -1)
        total[is_used] += np.minimum(1.0, distance[is_used])
        weight[is_used] += 1
    mean = np.divide(total, weight, out=np.ones_like(total), where=weight > 0)
    grid = np.where((weight > 0) & (np.abs(mean) < _EDGE), (mean + 1) / 2, 0.0)
    return grid.astype(np.float32).reshape(1, RESOLUTION, RESOLUTION, RESOLUTION)


def _setup(opening: float) -> dict[str, Any]:
    """What `setup.json` holds, of a hand that opens by so many metres.

    Open3D, which they use, has whole numbers at the middles of pixels, where `Camera` has halves.
    """
    K = [FOCAL, 0.0, WIDTH / 2 - 0.5, 0.0, FOCAL, HEIGHT / 2 - 0.5, 0.0, 0.0, 1.0]
    return {
        "size": CUBE,
        "intrinsic": {"width": WIDTH, "height": HEIGHT, "K": K},
        "max_opening_width": opening,
        "finger_depth": FINGER,
    }


def grasp_numbers(
    pose: np.ndarray, width: np.ndarray, hand: Hand, T_world_task: np.ndarray
) -> np.ndarray:
    """f64[C, 7]: qx, qy, qz, qw, x, y, z of their tool frame in the task's, of T_world_tool f64[C, 4, 4].

    Args:
      width: f64[C], metres between the pads: where one of them stands still, the middle is beside the tool.
    """
    if not isinstance(hand, SuctionCup):
        side = gripper_of(hand).side_of(width)
        pose = pose.copy()
        pose[:, :3, 3] += side[:, None] * pose[:, :3, 1]
    return _numbers(inverse(T_world_task) @ shift_along(pose, (0.0, 0.0, -FINGER_DEPTH)))


def is_inside(numbers: np.ndarray) -> np.ndarray:
    """bool[C]: grasps f64[C, 7] (`grasp_numbers`) in the cube: their nearest voxel, by rounding, is in it."""
    voxel = np.round(numbers[:, 4:] * RESOLUTION / CUBE)
    inside: np.ndarray = np.all((numbers[:, 4:] >= 0) & (voxel < RESOLUTION), axis=1)
    return inside


def csv_lines(
    scene: str, numbers: np.ndarray, width: np.ndarray, label: np.ndarray, scale: float
) -> list[str]:
    """Rows of `grasps.csv`; lengths are divided by `scale`, 1 for metres."""
    lines = []
    for number, each, good in zip(numbers, width, label, strict=True):
        values = [*number[:4], *(number[4:] / scale), each / scale]
        lines.append(",".join([scene, *(f"{value:.9g}" for value in values), str(int(good))]))
    return lines


def _numbers(matrix: np.ndarray) -> np.ndarray:
    """f64[..., 7]: poses f64[..., 4, 4] as x, y, z, w of a quaternion, then the position."""
    return pose_of(matrix)[..., [4, 5, 6, 3, 0, 1, 2]]


def _write_table(path: Path, table: pa.Table) -> None:
    buffer = io.BytesIO()
    pq.write_table(table, buffer, write_page_checksum=True)
    write_atomically(path, buffer.getvalue())


GRASPS = "grasps.parquet"
_DATASET = BlockStore("grasps", "dataset.json", "grasps of scenes", "cluttergen robot dataset")
_COLUMNS = {
    "scene": (pa.int32(), "number of the scene in its bank"),
    "object": (pa.string(), "name of the object that is meant"),
    "source": (
        pa.string(),
        "antipodal: about two points that fingers can press; surface: along a normal",
    ),
    "pose": (
        pa.list_(pa.float64(), 7),
        "T_world_tool, metres, wxyz; z the approach, y the closing direction",
    ),
    "width": (pa.float64(), "metres between the points that are pressed; of `surface` the widest"),
    "is_free": (
        pa.bool_(),
        "the open hand touches nothing there, nor on the last 10 cm of its straight way",
    ),
    "blocked_by": (pa.string(), "the first body that it touches; empty where it is free"),
    "lift": (pa.string(), "lifted, empty, lost or diverged; null where it was not executed"),
    "lifted_object": (pa.string(), "name of the object that came up; null where none did"),
    "lifted_width": (
        pa.float64(),
        "metres between the fingers in the end; null where nothing came up",
    ),
    "others_moved": (
        pa.float64(),
        "metres that another object moved, at most; null where not executed",
    ),
    "in_cube": (pa.bool_(), "inside VGN's cube, so that it is in the files of VGN"),
}
SCHEMA = pa.schema([(name, kind) for name, (kind, _) in _COLUMNS.items()])


@dataclass(frozen=True)
class GraspPlan:
    """How a dataset is made.

    Attributes:
      robot: whose hand it is, or a suction cup.
      format: of which projects files are written.
      num_object_grasps: candidates of each object, where a format labels objects.
      num_grasps: candidates kept of each scene. num_lifts: of the free ones, how many are executed.
      num_views: pictures of each scene. noise: factor of a usual depth camera's.
      seed: of all that is drawn.
    """

    robot: Hand
    format: tuple[str, ...]
    num_object_grasps: int
    num_grasps: int
    num_lifts: int
    num_views: int
    noise: float
    seed: int


@dataclass(frozen=True)
class GraspDataset:
    """A dataset that is made.

    Attributes:
      path: its folder. num_scenes, num_grasps, num_free: what is in it.
      lifts: how many lifts ended in each way.
      format: of which projects there are files.
      num_held: of the grasps of objects by themselves, how many of how many hold, by object.
    """

    path: Path
    num_scenes: int
    num_grasps: int
    num_free: int
    lifts: dict[str, int]
    format: tuple[str, ...] = ("vgn", "giga")
    num_held: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def lacking(self) -> tuple[str, ...]:
        """The objects of which no grasp holds."""
        return tuple(name for name, (held, _) in self.num_held.items() if not held)

    def __str__(self) -> str:
        lifts = ", ".join(f"{name} {number}" for name, number in self.lifts.items()) or "none"
        lines = [f"grasps     {self.num_grasps} of {self.num_scenes} scenes, {self.num_free} free"]
        if self.num_held:
            held, number = np.sum(list(self.num_held.values()), axis=0)
            lines.append(f"objects    {len(self.num_held)}, {held} of {number} grasps hold")
        if self.lacking:
            lines.append(f"no grasp   of {', '.join(self.lacking)}")
        places = ", ".join(dict.fromkeys(_PLACES[each] for each in self.format))
        lines += [f"lifts      {lifts}", f"files      {self.path}: {GRASPS}, {places}"]
        return "\n".join(lines)


_PLACES = {
    "vgn": "raw and voxels (VGN)",
    "giga": "raw and voxels (GIGA)",
    "acronym": f"{ACRONYM_FOLDER} (ACRONYM)",
    "contact_graspnet": f"{ACRONYM_FOLDER} (Contact-GraspNet)",
    "graspnet": f"{GRASPNET_FOLDER} (GraspNet-1Billion)",
}


def make(
    bank: Path, num_scenes: int | None, plan: GraspPlan, out: Path, num_threads: int
) -> GraspDataset:
    """A dataset in a folder, begun or continued; see `cluttergen_jax.robot.dataset`."""
    source = read_bank(bank)
    scenes = list(read_scenes(source))[:num_scenes]
    objects = list({asset.name: asset for scene in scenes for asset in scene.objects}.values())
    _check_formats(plan)
    if not (out / _DATASET.index).exists():
        _check_objects(objects, plan)
    recipe = {
        "bank": {"name": bank.resolve().name, "recipe": source.recipe},
        **vars(plan),
        "robot": {
            "name": plan.robot.name,
            "hash": plan.robot.hash,
            "is_cup": isinstance(plan.robot, SuctionCup),
        },
        "versions": versions(),
    }
    with _DATASET.hold(out), writing(out):
        remove_partial(out)
        _DATASET.begin(out, recipe)
        if "giga" in plan.format:
            for asset in objects:
                write_mesh(out / _mesh_name(asset.name), _surface_of(asset))
        sets = ObjectSets(
            out,
            objects,
            plan.format,
            plan.robot,
            plan.num_object_grasps,
            plan.num_views,
            plan.noise,
            plan.seed,
        )
        sets.make_objects(_surface_of, num_threads)
        missing = [scene for scene in scenes if not (out / _part_name(scene)).is_file()]
        done = len(scenes) - len(missing)
        pool = ThreadPoolExecutor(num_threads)
        try:
            with Progress("grasps", len(scenes), "scene", done) as progress:
                waiting = [
                    pool.submit(partial(_make_scene, out, plan, sets), scene) for scene in missing
                ]
                for future in as_completed(waiting):
                    progress.update(1, future.result())
        finally:
            pool.shutdown(cancel_futures=True)
        sets.draw_scenes(scenes)
        return _finish(out, scenes, sets, recipe, plan.robot)


def _opening(robot: Hand) -> float:
    """Metres that a hand opens, between its pads; 0 of a cup."""
    return 0.0 if isinstance(robot, SuctionCup) else 2 * gripper_of(robot).max_opening


def _check_formats(plan: GraspPlan) -> None:
    """Refuses what the hand or the machine does not allow, before anything is made.

    Raises:
      ConfigError, MissingExtraError, RendererError: see there.
    """
    if isinstance(plan.robot, SuctionCup) and "contact_graspnet" in plan.format:
        raise ConfigError(
            "format contact_graspnet for a suction cup",
            "a hand whose fingers touch at two points",
            "the formats vgn, giga, acronym and graspnet (as SuctionNet-1Billion)",
        )
    if not {"acronym", "contact_graspnet"}.isdisjoint(plan.format):
        check_installed()
    if not set(SEEN).isdisjoint(plan.format):
        find_backend()


def _check_objects(objects: Sequence[ObjectAsset], plan: GraspPlan) -> None:
    """Refuses a bank of whose objects the hand can hold none (ConfigError)."""
    hand = plan.robot
    if isinstance(hand, SuctionCup):
        held = any(can_seal(asset, hand) for asset in objects)
        why = f"on none of them a rim of {2e3 * hand.radius:g} mm seals"
    else:
        held = any(can_hold(asset, hand) for asset in objects)
        why = f"it opens by {1e3 * _opening(hand):.0f} mm, and all are wider or too slanted"
    if not held:
        names = ", ".join(asset.name for asset in objects[:5])
        more = f" and {len(objects) - 5} more" if len(objects) > 5 else ""
        raise ConfigError(
            f"no object of the bank that the hand of {hand.name} can hold ({names}{more}): {why}",
            "a bank with at least one that it can",
            'objects="width<0.07" in `generate`, or another robot',
        )


def _make_scene(out: Path, plan: GraspPlan, sets: ObjectSets, scene: Scene) -> str:
    """Makes all files of a scene, that of its candidates last; a note."""
    streams = np.random.default_rng([plan.seed, scene.origin.index]).spawn(3)
    T_world_task = task_frame(scene.support)
    hand = plan.robot
    still: StillScene | StillCups
    if isinstance(hand, SuctionCup):
        still = StillCups(scene, hand)
        labelled = draw_cups(scene, still, plan.num_grasps, streams[0])
    else:
        still = StillScene(scene, hand)
        labelled = label_grasps(scene, still, plan.num_grasps, streams[0])
    grasps = labelled.grasps
    is_free = labelled.blocked_by == ""
    lifts: dict[int, Lift] = {}
    if plan.num_lifts and is_free.any():
        chosen = np.sort(streams[1].permutation(np.flatnonzero(is_free))[: plan.num_lifts])
        if isinstance(hand, SuctionCup):
            cups = LiftCups(scene, hand)
            lifts = {
                int(row): cups.lift(grasps.pose[row], int(grasps.target[row])) for row in chosen
            }
        else:
            executed = LiftScene(scene, hand)
            lifts = {int(row): executed.lift(grasps.pose[row], grasps.width[row]) for row in chosen}
    if not _OF_CUBE.isdisjoint(plan.format):
        noise = REALSENSE.scale(plan.noise)
        depths = []
        cameras = []
        for camera in draw_cameras(T_world_task, plan.num_views, streams[2]):
            depth, believed = noisy(still.depth(camera), camera, noise, streams[2])
            depths.append(depth)
            cameras.append(believed)
        _write_scene(out, scene, T_world_task, depths, cameras)
    if "giga" in plan.format:
        _write_giga(out, scene, T_world_task, plan.seed)
    sets.make_scene(scene, still)
    numbers = grasp_numbers(grasps.pose, grasps.width, hand, T_world_task)
    table = _table(scene, grasps, labelled.blocked_by, lifts, is_inside(numbers))
    counts = {"drawn": str(labelled.num_drawn), "free": str(labelled.num_free)}
    _write_table(out / _part_name(scene), table.replace_schema_metadata(counts))
    good = sum(lift.end is LiftEnd.LIFTED for lift in lifts.values())
    return f"{int(is_free.sum())} of {len(is_free)} free, {good} of {len(lifts)} lifted"


_OF_CUBE = {"vgn", "giga"}


def _write_scene(
    out: Path,
    scene: Scene,
    T_world_task: np.ndarray,
    depths: Sequence[np.ndarray],
    cameras: Sequence[Camera],
) -> None:
    """What was seen, as pictures and as a volume."""
    extrinsics = [_numbers(inverse(each.T_world_camera) @ T_world_task) for each in cameras]
    images = [np.where(np.isfinite(each), each, 0.0) for each in depths]
    grid = tsdf_grid(depths, cameras, T_world_task)
    name = f"{scene_id(scene)}.npz"
    write_npz(
        out / "raw/scenes" / name,
        depth_imgs=np.array(images, np.float32),
        extrinsics=np.array(extrinsics, np.float32),
    )
    write_npz(out / "voxels/scenes" / name, grid=grid)


def _write_giga(out: Path, scene: Scene, T_world_task: np.ndarray, seed: int) -> None:
    """Where the meshes are, and which points of space are inside them."""
    T_task_world = inverse(T_world_task)
    placed = T_task_world @ matrix_of(scene.poses)
    # GIGA's list: file, scale, T_task_mesh; an array of objects, which NumPy pickles.
    meshes = np.empty((len(scene.names), 3), object)
    for row, asset, pose in zip(meshes, scene.objects, placed, strict=True):
        row[:] = _mesh_name(asset.name), 1.0, pose
    write_npz(out / f"raw/mesh_pose_list/{scene_id(scene)}.npz", pc=meshes)
    corners = np.concatenate(
        [
            asset.vertices @ pose[:3, :3].T + pose[:3, 3]
            for asset, pose in zip(scene.objects, placed, strict=True)
        ]
    )
    rng = np.random.default_rng([seed, scene.origin.index, 90])
    points = rng.uniform(corners.min(0) - _AROUND, corners.max(0) + _AROUND, (_OCCUPANCY, 3))
    # As they keep them, in half precision.
    points = points.astype(np.float16)
    is_inside_any = np.zeros(len(points), bool)
    for asset, pose in zip(scene.objects, placed, strict=True):
        local = (points.astype(np.float64) - pose[:3, 3]) @ pose[:3, :3]
        near = np.flatnonzero((np.abs(local) <= asset.half_extents + 1e-6).all(1))
        is_inside_any[near] |= Union(asset.parts).distance(local[near]) < 0
    write_npz(out / f"raw/occ/{scene_id(scene)}/0000.npz", points=points, occ=is_inside_any)


def _table(
    scene: Scene, grasps: Any, blocked_by: np.ndarray, lifts: dict[int, Lift], in_cube: np.ndarray
) -> pa.Table:
    rows = []
    for row, pose in enumerate(pose_of(grasps.pose)):
        lift = lifts.get(row)
        is_up = lift is not None and lift.raised >= 0
        rows.append(
            {
                "scene": scene.origin.index,
                "object": scene.names[grasps.target[row]],
                "source": str(Source.ANTIPODAL if grasps.is_antipodal[row] else Source.SURFACE),
                "pose": pose.tolist(),
                "width": float(grasps.width[row]),
                "is_free": not blocked_by[row],
                "blocked_by": str(blocked_by[row]),
                "lift": None if lift is None else str(lift.end),
                "lifted_object": scene.names[lift.raised] if lift is not None and is_up else None,
                "lifted_width": lift.width if lift is not None and is_up else None,
                "others_moved": None if lift is None else lift.moved,
                "in_cube": bool(in_cube[row]),
            }
        )
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def _finish(
    out: Path,
    scenes: Sequence[Scene],
    sets: ObjectSets,
    recipe: dict[str, Any],
    hand: Hand,
) -> GraspDataset:
    """Joins what the scenes have: the tables of all formats, and the card."""
    parts = [pq.read_table(out / _part_name(scene)) for scene in scenes]
    counts = {
        name: sum(int((part.schema.metadata or {})[name.encode()]) for part in parts)
        for name in ("drawn", "free")
    }
    whole = pa.concat_tables([part.replace_schema_metadata(None) for part in parts])
    _write_table(out / GRASPS, whole)
    num_csv = 0
    if not _OF_CUBE.isdisjoint(recipe["format"]):
        num_csv = _write_cubes(out, scenes, parts, recipe["num_lifts"], hand)
    lifts = Counter(each for each in whole["lift"].to_pylist() if each is not None)
    made = GraspDataset(
        out,
        len(scenes),
        len(whole),
        int(np.sum(whole["is_free"].to_numpy())),
        dict(lifts.most_common()),
        tuple(recipe["format"]),
        {name: (int(each.is_held.sum()), len(each.is_held)) for name, each in sets.labels.items()},
    )
    write_unless_own(out, lambda: _card(made, whole, counts, num_csv, scenes[0], sets, recipe))
    return made


def _write_cubes(
    out: Path, scenes: Sequence[Scene], parts: Sequence[pa.Table], num_lifts: int, hand: Hand
) -> int:
    """Writes the tables of VGN and GIGA; how many rows each has."""
    setup = json.dumps(_setup(_opening(hand)), indent=4) + "\n"
    write_atomically(out / "raw/setup.json", setup.encode())
    raw = [CSV]
    voxels = [VOXEL_CSV]
    for scene, part in zip(scenes, parts, strict=True):
        rows = _labelled_rows(part, num_lifts, hand, task_frame(scene.support))
        raw += csv_lines(scene_id(scene), *rows, 1.0)
        voxels += csv_lines(scene_id(scene), *rows, CUBE / RESOLUTION)
    write_atomically(out / "raw/grasps.csv", ("\n".join(raw) + "\n").encode())
    write_atomically(out / "voxels/grasps.csv", ("\n".join(voxels) + "\n").encode())
    return len(raw) - 1


def _labelled_rows(
    part: pa.Table, num_lifts: int, hand: Hand, T_world_task: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers f64[C, 7], widths f64[C] and labels bool[C] of the candidates that VGN's files have.

    A label is that of the lift; a candidate that is not free has failed. Free ones that were not executed are
    left out, unless none was to be: then what is free is good.
    """
    is_free = part["is_free"].to_numpy()
    lift = np.array(part["lift"].to_pylist(), object)
    label = lift == str(LiftEnd.LIFTED) if num_lifts else is_free
    is_known = ~is_free | (lift != None) if num_lifts else np.ones(len(lift), bool)  # noqa: E711
    chosen = np.flatnonzero(part["in_cube"].to_numpy() & is_known)
    pose = matrix_of(np.array(part["pose"].to_pylist(), np.float64).reshape(-1, 7))
    final = np.array(part["lifted_width"].to_pylist(), np.float64)
    width = np.where(np.isfinite(final), final, part["width"].to_numpy())
    # As wide as it was when it came: what is in the cube was decided by that.
    numbers = grasp_numbers(pose, part["width"].to_numpy(), hand, T_world_task)
    return numbers[chosen], width[chosen], label[chosen].astype(bool)


def _card(
    made: GraspDataset,
    whole: pa.Table,
    counts: dict[str, int],
    num_csv: int,
    scene: Scene,
    sets: ObjectSets,
    recipe: dict[str, Any],
) -> str:
    """The card as Markdown."""
    objects = sets.objects
    licences = [*(each.provenance.licence for each in objects), scene.support.provenance.licence]
    tags = ["robotics", "simulation", "mujoco", "grasping", "clutter"]
    head = front_matter(
        licences, tags, "grasps in clutter", f"[{{split: train, path: '{GRASPS}'}}]"
    )
    sources = whole["source"].to_pylist()
    facts = {
        "scenes": f"{made.num_scenes} of the bank `{recipe['bank']['name']}`",
        "candidates": f"{made.num_grasps}, {Counter(sources)[str(Source.ANTIPODAL)]} of them antipodal",
        "free": f"{made.num_free} of these; of all {counts['drawn']} that were drawn {counts['free']}",
        "lifts": ", ".join(f"{name} {number}" for name, number in made.lifts.items())
        or "none executed",
        "in VGN's files": f"{num_csv}, those inside its cube of {CUBE:g} m whose label is known",
        "views": f"{recipe['num_views']} a scene, noise {recipe['noise']:g}",
        "seed": recipe["seed"],
        "versions": ", ".join(f"{name} {number}" for name, number in recipe["versions"].items()),
    }
    columns = markdown_table(
        ("column", "type", "meaning"),
        [(f"`{name}`", f"`{kind}`", text) for name, (kind, text) in _COLUMNS.items()],
    )
    about = (
        f"# {made.path.resolve().name}\n\nGrasps of the hand of {recipe['robot']['name']} "
        "in cluttered scenes, failures kept. A "
        "lift: from the pose, everything awake, the fingers close and the hand rises by "
        f"{LIFT:g} m; `lifted` means that an object came up by at least {RAISED:g} of it."
    )
    if made.num_held:
        held, number = np.sum(list(made.num_held.values()), axis=0)
        facts["objects by themselves"] = f"{len(made.num_held)}, {held} of {number} grasps hold"
        facts["objects without a grasp"] = ", ".join(made.lacking) or "none"
    tried = np.concatenate([np.zeros(0, bool), *sets.simulated])
    if len(tried):
        facts["GraspNet's, good at the object's friction, simulated"] = (
            f"{tried.sum()} of {len(tried)} hold"
        )
    texts = dict.fromkeys(_FILES[each] for each in made.format)
    files = "\n\n".join(["## Files", *texts, *([_CUP] if _is_cup(recipe) else [])])
    lines = "\n".join(f"- {name}: {value}" for name, value in facts.items())
    return (
        "\n\n".join([head, about, lines, f"## Columns\n\n{columns}", files])
        + "\n\n"
        + (assets_section(objects, scene.support) + "\n")
    )


_CUBE_FILES = (
    "`raw` is what VGN's `construct_dataset.py` reads: depth in metres (0: not measured), `extrinsics` of "
    "each view, x, y, z, w of the quaternion and the position of the cube in the camera's frame, "
    "`grasps.csv` with the tool frame at the root of the fingers. `voxels` is what it makes of them."
)
_FILES = {
    "vgn": _CUBE_FILES,
    "giga": "`raw/mesh_pose_list`, `raw/meshes` and `raw/occ` are GIGA's, which reads `raw` and `voxels` as "
    "VGN does. Meshes are named from this folder: its scripts run here.",
    "acronym": f"`{ACRONYM_FOLDER}` is the root for `acronym_tools`: `grasps/*.h5`, `meshes`. A grasp's "
    "frame is the root of the Panda's hand, z the approach, x the closing direction; any hand is put so that "
    f"the middle of its open pads is {DEPTH} m ahead of that. The hand comes open as wide as it goes; pads "
    "that close on arcs touch a little ahead. "
    "`object_in_gripper`: it touched nothing, and held the object lifted by 15 cm, shaken and turned, "
    "slipping by less than 5 mm and 10 degrees. `grasps/qualities/cluttergen` has what else is known.",
    "contact_graspnet": f"`{ACRONYM_FOLDER}` is the data path of Contact-GraspNet, with ACRONYM's files: "
    "`mesh_contacts`, `splits`, `scene_contacts`, and `scene_views` for its inference (blue comes first). "
    f"The top of its table is at {TABLE_TOP} m; a support that is no plane is one more mesh, without grasps. "
    "Its config takes hands that open by 0.08 m: for a wider one set `gripper_width` and `offset_bins`.",
    "graspnet": f"`{GRASPNET_FOLDER}` is the root for graspnetAPI, camera `realsense`, split `custom`, with "
    "as many views as were asked for (theirs has 256, and 88 objects: `checkDataCompleteness` asks for "
    "those, and for `rect`, which its scripts make). The middle of the pads is `depth` ahead of a point. "
    "Scores are the least friction by the contacts; `simulated` in `grasp_label`: 1 held, 0 did not, "
    "-1 not tried.",
}
_CUP = (
    "The hand is a suction cup: its tool's origin is the middle of the rim, widths are 0. In place of grasps "
    "GraspNet's layout has the labels of SuctionNet-1Billion: `seal_label`, `wrench_label`, "
    "`suction_collision_label`. Held means: the rim seals (Dex-Net 3.0's rule), and the weight, shaken, "
    "stays within the cup's bounds."
)


def _is_cup(recipe: dict[str, Any]) -> bool:
    return recipe["robot"]["is_cup"]


def scene_id(scene: Scene) -> str:
    """What VGN's and GIGA's tables call a scene: never a number."""
    return f"scene_{scene.origin.index:06d}"


def _part_name(scene: Scene) -> str:
    return f"parts/{scene.origin.index:06d}.parquet"


def _mesh_name(name: str) -> str:
    return f"raw/meshes/{name}.obj"


def _surface_of(asset: ObjectAsset) -> Mesh:
    """What is seen of an object as one mesh; its parts where it has no surface."""
    return join_meshes(
        [piece.mesh for piece in asset.pieces] or [part.hull() for part in asset.parts]
    )
