"""Where the camera stands: as close as it can while the content fits the picture."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from cluttergen_jax.rendering.config import CameraView


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
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        rotation = data.geom_xmat[geom].reshape(3, 3)
        points.append(corners(center - half, center + half) @ rotation.T + data.geom_xpos[geom])
    return np.concatenate(points)


def axes(azimuth: float, elevation: float) -> np.ndarray:
    """f64[3, 3]: rows are the camera's right, up and forward in the world; angles in degrees."""
    az, el = math.radians(azimuth), math.radians(elevation)
    forward = np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el)])
    right = np.array([math.sin(az), -math.cos(az), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def fitted_eye(points: np.ndarray, view: CameraView, aspect: float) -> np.ndarray:
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
        _centred(seen[:, k], ahead, high[k] + t * depth, -low[k] - t * depth) for k, t in enumerate(tangents)
    ]
    return np.array([*sides, depth]) @ turn


def _centred(side: np.ndarray, ahead: np.ndarray, least: float, most: float) -> float:
    """Where between two bounds the eye sees points as far to one side as to the other, by bisection.

    Args:
      side, ahead: f64[P], the points across and along the line of sight.
    """
    for _ in range(50):
        middle = (least + most) / 2
        slopes = (side - middle) / ahead
        least, most = (middle, most) if slopes.max() + slopes.min() > 0 else (least, middle)
    return (least + most) / 2


def placed_camera(points: np.ndarray, view: CameraView, aspect: float) -> mujoco.MjvCamera:
    """MuJoCo's camera at the place that `fitted_eye` finds, looking at the middle of the content's depth."""
    eye = fitted_eye(points, view, aspect)
    forward = axes(view.azimuth, view.elevation)[2]
    distance = max(float(((points - eye) @ forward).mean()), 1e-3)
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = view.azimuth, view.elevation, distance
    camera.lookat = eye + distance * forward
    return camera
