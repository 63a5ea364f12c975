"""Cameras of views: from above, around the table, and on the hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, above, wrist_camera
from cluttergen_jax.downstream.robot.frames import made
from cluttergen_jax.sensing.camera import Camera, free

Kind = Literal["free", "overhead", "wrist"]
"""Of cameras."""
_TILT, _SHIFT = np.radians(4.0), 0.03


def draw_camera(
    kind: Kind, support: SupportAsset, tool: np.ndarray | None, rng: np.random.Generator
) -> Camera:
    """A camera for a view: around the table, nearly overhead, or as the one on the hand.

    Args:
      tool: f64[4, 4], T_world_tool, where the arm is in the view; None if there is none.
    """
    if kind == "free":
        return free(support, rng, *SIZE, FOCAL)
    if kind == "overhead":
        return _shaken(above(support), rng)
    return wrist_camera(_draw_tool(support, rng) if tool is None else tool)


def _shaken(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera moved and turned by a little."""
    T = camera.T_world_camera.copy()
    T[:3, 3] += rng.uniform(-_SHIFT, _SHIFT, 3)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0, _TILT, 3)).as_matrix() @ T[:3, :3]
    return replace(camera, T_world_camera=T)


def _draw_tool(support: SupportAsset, rng: np.random.Generator) -> np.ndarray:
    """f64[4, 4]: a hand that looks down on the region from 30 to 60 cm, tilted by up to a few degrees."""
    half = 0.6 * np.asarray(support.region.half_extents)
    place = np.array([*support.region.center, support.top])
    place += [*rng.uniform(-half, half), rng.uniform(0.3, 0.6)]
    turn = Rotation.from_euler("zx", [rng.uniform(0, 2 * np.pi), np.pi])
    tilt = Rotation.from_rotvec(rng.normal(0, np.radians(6.0), 3))
    return made((tilt * turn).as_matrix(), place)
