"""Cameras of views and of the robot: from above, around the table, and on the hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.downstream.robot.frames import made
from cluttergen_jax.sensing.camera import REALSENSE_FOCAL, Camera, free, intrinsics, overhead

SIZE, FOCAL = (320, 240), REALSENSE_FOCAL / 2
"""Of pictures: a depth camera of the RealSense kind at half of its resolution."""
Kind = Literal["free", "overhead", "wrist"]
"""Of cameras."""
_WRIST_PLACE = np.array([0.06, 0.0, -0.08])
_WRIST_TILT = np.radians(-8.0)
_TILT, _SHIFT = np.radians(4.0), 0.03


def wrist_camera(T_world_tool: np.ndarray) -> Camera:
    """The camera on the hand: before it, looking along it and a little towards what is between the fingers.

    Args:
      T_world_tool: f64[4, 4], of the tool (docs/contract.md).
    """
    turn = Rotation.from_euler("zy", [-np.pi / 2, _WRIST_TILT]).as_matrix()
    T_tool_camera = made(turn, _WRIST_PLACE)
    return Camera(*SIZE, intrinsics(*SIZE, FOCAL), T_world_tool @ T_tool_camera)


def above(support: SupportAsset) -> Camera:
    """The camera over the table, which sees the whole region."""
    return overhead(support, *SIZE, FOCAL)


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
