"""Where the camera stands: as close as it can while the content fits the picture; and as OpenGL takes it."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.sensing.camera import Camera, intrinsics


def corners(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """f64[8, 3]: the corners of an axis-aligned box."""
    grid = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
    return np.where(grid == 0, lower, upper)


def drawn_points(model: mujoco.MjModel, data: mujoco.MjData, is_drawn: np.ndarray) -> np.ndarray:
    """f64[P, 3]: corners of the boxes around all drawn geoms but planes, world frame, metres.

    Args:
      is_drawn: bool[ngeom].
    """
    points = [np.zeros((0, 3))]
    for geom in np.flatnonzero(is_drawn & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)):
        center = model.geom_aabb[geom, :3]
        half = model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        points.append(corners(center - half, center + half) @ rotation.T + data.geom_xpos[geom])
    return np.concatenate(points)


def axes(azimuth: float, elevation: float) -> np.ndarray:
    """f64[3, 3]: rows are the camera's right, up and forward in the world; angles in degrees."""
    az = math.radians(azimuth)
    el = math.radians(elevation)
    forward = np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el)])
    right = np.array([math.sin(az), -math.cos(az), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def fit_eye(points: np.ndarray, view: CameraView, aspect: float) -> np.ndarray:
    """The nearest place from which all `points` lie inside the picture, centred.

    Seen from (ex, ez), a point (x, z) lies right of the left edge and left of the right edge if
    |x - ex| <= t (z - ez), t being the tangent of half the field of view. Both are linear in the eye, so the
    largest ez follows in closed form, and so for y.

    Args:
      points: f64[P, 3], world frame, metres.
      aspect: width over height.

    Returns:
      f64[3], world frame.
    """
    turn = axes(view.azimuth, view.elevation)
    seen = points @ turn.T
    shrink = 1.0 - 2.0 * view.margin
    tangent = math.tan(math.radians(view.field_of_view) / 2) * shrink
    tangents = np.array([tangent * aspect, tangent])
    low = np.max(-seen[:, :2] - tangents * seen[:, 2:], axis=0)
    high = np.max(seen[:, :2] - tangents * seen[:, 2:], axis=0)
    depth = np.min(-(low + high) / (2 * tangents))
    ahead = seen[:, 2] - depth
    sides = [
        _center(seen[:, k], ahead, high[k] + t * depth, -low[k] - t * depth)
        for k, t in enumerate(tangents)
    ]
    return np.array([*sides, depth]) @ turn


def _center(side: np.ndarray, ahead: np.ndarray, least: float, most: float) -> float:
    """Where between two bounds the eye sees points as far to one side as to the other, by bisection.

    Args:
      side, ahead: f64[P], the points across and along the line of sight.
    """
    for _ in range(50):
        middle = (least + most) / 2
        slopes = (side - middle) / ahead
        least, most = (middle, most) if slopes.max() + slopes.min() > 0 else (least, middle)
    return (least + most) / 2


def fit_camera(points: np.ndarray, view: CameraView, width: int, height: int) -> Camera:
    """The camera at the place that `fit_eye` finds."""
    T = np.eye(4)
    T[:3, :3] = (axes(view.azimuth, view.elevation) * [[1.0], [-1.0], [1.0]]).T
    T[:3, 3] = fit_eye(points, view, width / height)
    focal = height / 2 / math.tan(math.radians(view.field_of_view) / 2)
    return Camera(width, height, intrinsics(width, height, focal), T)


def orbit_camera(camera: Camera) -> mujoco.MjvCamera:
    """MuJoCo's camera at the same place, looking the same way; it knows neither roll nor intrinsics."""
    forward = camera.rotation[:, 2]
    seen = mujoco.MjvCamera()
    seen.azimuth = math.degrees(math.atan2(forward[1], forward[0]))
    seen.elevation = math.degrees(math.asin(np.clip(forward[2], -1.0, 1.0)))
    seen.distance = 1.0
    seen.lookat = camera.eye + forward
    return seen


def set_view(scene: mujoco.MjvScene, camera: Camera) -> None:
    """Makes a scene that has been updated for `orbit_camera` be seen by exactly this camera."""
    K = camera.K
    rotation = camera.rotation
    for seen in scene.camera:
        seen.pos = camera.eye
        seen.forward = rotation[:, 2]
        seen.up = -rotation[:, 1]
        near = seen.frustum_near
        seen.frustum_width = near * camera.width / 2 / K[0, 0]
        seen.frustum_center = near * (camera.width / 2 - K[0, 2]) / K[0, 0]
        seen.frustum_top = near * K[1, 2] / K[1, 1]
        seen.frustum_bottom = -near * (camera.height - K[1, 2]) / K[1, 1]
