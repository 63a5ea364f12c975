"""The conventions of VGN and GIGA, whose files `robot dataset` writes: their frames, views, volumes, numbers.

Breyer et al., "Volumetric Grasping Network: Real-time 6 DOF Grasp Detection in Clutter" (CoRL 2020), and its
code, which GIGA (Jiang et al., RSS 2021) shares. The task frame has its origin at a lower corner of a cube;
the table lies one finger's depth above it. Their tool frame is at the root of the fingers.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.robot.grasping.clutter import FINGER_DEPTH
from cluttergen_jax.downstream.transforms import inverse, pose_of, rigid, shift_along
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.sensing import Camera

SIZE = 0.3
"""Metres: the cube's side, six times `DEPTH`."""
DEPTH = 0.05
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
CSV = "scene_id,qx,qy,qz,qw,x,y,z,width,label"
VOXEL_CSV = "scene_id,qx,qy,qz,qw,i,j,k,width,label"


def task_frame(support: SupportAsset) -> np.ndarray:
    """f64[4, 4]: T_world_task, a lower corner of the cube, which has the region's middle and turn."""
    turn = support.region.yaw
    cos = np.cos(turn)
    sin = np.sin(turn)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    middle = support.region_points[0]
    corner = middle[:2] + rotate_in_plane(np.array([-SIZE / 2, -SIZE / 2]), turn)
    return rigid(rotation, np.array([*corner, middle[2] - DEPTH]))


def draw_cameras(T_world_task: np.ndarray, number: int, rng: np.random.Generator) -> list[Camera]:
    """Cameras on a dome around the cube's foot, as VGN draws them; they look at the table's middle."""
    middle = (T_world_task @ [SIZE / 2, SIZE / 2, DEPTH, 1.0])[:3]
    cameras = []
    for _ in range(number):
        tilt = rng.uniform(0.02, _TILT)
        turn = rng.uniform(0, 2 * np.pi)
        far = rng.uniform(*_FAR) * SIZE
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
    voxel = SIZE / RESOLUTION
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


def sensor_file(
    depths: Sequence[np.ndarray], cameras: Sequence[Camera], T_world_task: np.ndarray
) -> bytes:
    """`depth_imgs` f32[V, H, W], metres, 0 where nothing was measured, and `extrinsics` f32[V, 7]."""
    extrinsics = [_numbers(inverse(each.T_world_camera) @ T_world_task) for each in cameras]
    images = np.stack([np.where(np.isfinite(each), each, 0.0) for each in depths])
    return _npz(depth_imgs=images.astype(np.float32), extrinsics=np.array(extrinsics, np.float32))


def voxel_file(grid: np.ndarray) -> bytes:
    """`grid`, as their networks are trained on."""
    return _npz(grid=grid)


def mesh_file(meshes: Sequence[tuple[str, np.ndarray]]) -> bytes:
    """`pc`, GIGA's list of meshes: file, scale, T_task_mesh; an array of objects, which NumPy pickles."""
    rows = np.empty((len(meshes), 3), object)
    for row, (name, pose) in zip(rows, meshes, strict=True):
        row[:] = name, 1.0, pose
    return _npz(pc=rows)


def setup(opening: float) -> dict[str, Any]:
    """What `setup.json` holds, of a hand that opens by so many metres.

    Open3D, which they use, has whole numbers at the middles of pixels, where `Camera` has halves.
    """
    K = [FOCAL, 0.0, WIDTH / 2 - 0.5, 0.0, FOCAL, HEIGHT / 2 - 0.5, 0.0, 0.0, 1.0]
    return {
        "size": SIZE,
        "intrinsic": {"width": WIDTH, "height": HEIGHT, "K": K},
        "max_opening_width": opening,
        "finger_depth": DEPTH,
    }


def grasp_numbers(pose: np.ndarray, T_world_task: np.ndarray) -> np.ndarray:
    """f64[C, 7]: qx, qy, qz, qw, x, y, z of their tool frame in the task's, of T_world_tool f64[C, 4, 4]."""
    T_task_tool = inverse(T_world_task) @ shift_along(pose, (0.0, 0.0, -FINGER_DEPTH))
    return np.array([_numbers(each) for each in T_task_tool]).reshape(-1, 7)


def is_inside(numbers: np.ndarray) -> np.ndarray:
    """bool[C]: grasps f64[C, 7] (`grasp_numbers`) in the cube."""
    inside: np.ndarray = np.all((numbers[:, 4:] >= 0) & (numbers[:, 4:] < SIZE), axis=1)
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
    """f64[7]: a pose f64[4, 4] as x, y, z, w of a quaternion, then the position."""
    pose = pose_of(matrix)
    return np.array([*pose[4:], pose[3], *pose[:3]])


def _npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
