"""Small changes from picture to picture, whose average is soft light and smooth edges."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.rendering.lighting import KEY_DIRECTION, KEY_LIGHT, SKY_LIGHT

_KEY_SPREAD = 0.10


def low_discrepancy(index: int) -> np.ndarray:
    """f64[6] in [0, 1): the index-th point of a sequence that fills the cube evenly (Kronecker's)."""
    base = np.array([0.7548776662, 0.5698402910, 0.8191725134, 0.6710436067, 0.5497004779, 0.4503])
    return (0.5 + index * base) % 1.0


def _hemisphere(u: float, v: float) -> np.ndarray:
    """A downward direction, even over the sky down to 30 degrees above the horizon."""
    height = 0.5 + 0.5 * u
    ring, turn = math.sqrt(1.0 - height**2), 2 * math.pi * v
    return -np.array([ring * math.cos(turn), ring * math.sin(turn), height])


def _around(direction: np.ndarray, u: float, v: float, spread: float) -> np.ndarray:
    """A direction within `spread` radians of the given one, even over the disc."""
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    radius, turn = spread * math.sqrt(u), 2 * math.pi * v
    tilted = direction + radius * (math.cos(turn) * side + math.sin(turn) * other)
    return tilted / np.linalg.norm(tilted)


def shift_lights(
    scene: mujoco.MjvScene,
    names: dict[int, str],
    u: np.ndarray,
    center: np.ndarray,
    reach: float,
    yaw: float = 0.0,
) -> None:
    """Turns the lights of `lighting` a little: averaged over many pictures, small lights become soft ones.

    Args:
      yaw: radians by which all of them are turned about the vertical besides, to follow a camera.
    """
    key = yaw_matrix(yaw) @ KEY_DIRECTION
    key /= np.linalg.norm(key)
    directions = {
        KEY_LIGHT: _around(key, u[0], u[1], _KEY_SPREAD),
        SKY_LIGHT: _hemisphere(u[2], u[3]),
    }
    for light in scene.lights[: scene.nlight]:
        name = names.get(light.id, "") if not light.headlight else ""
        if name in directions:
            light.dir = directions[name]
            light.pos = center - directions[name] * 2 * reach


def shift_pixel(scene: mujoco.MjvScene, u: float, v: float, width: int, height: int) -> None:
    """Moves the picture by a part of a pixel: averaged, edges become smooth."""
    for camera in scene.camera:
        span = camera.frustum_top - camera.frustum_bottom
        half_width = camera.frustum_width or 0.5 * span * width / height
        camera.frustum_center += (u - 0.5) * 2 * half_width / width
        camera.frustum_top += (v - 0.5) * span / height
        camera.frustum_bottom += (v - 0.5) * span / height
