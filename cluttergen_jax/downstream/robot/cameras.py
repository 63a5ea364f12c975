"""Cameras of the robot: one over the table, one on the hand."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.sensing import REALSENSE_FOCAL, Camera, intrinsics, overhead

# Of pictures: a depth camera of the RealSense kind at half of its resolution.
SIZE = (320, 240)
FOCAL = REALSENSE_FOCAL / 2

_WRIST_PLACE = np.array([0.06, 0.0, -0.08])
_WRIST_TILT = np.radians(-8.0)


def wrist_camera(T_world_tool: np.ndarray) -> Camera:
    """The camera on the hand: before it, looking along it and a little towards what is between the fingers.

    Args:
      T_world_tool: f64[4, 4], of the tool (docs/contract.md).
    """
    turn = Rotation.from_euler("zy", [-np.pi / 2, _WRIST_TILT]).as_matrix()
    T_tool_camera = rigid(turn, _WRIST_PLACE)
    return Camera(*SIZE, intrinsics(*SIZE, FOCAL), T_world_tool @ T_tool_camera)


def above(support: SupportAsset) -> Camera:
    """The camera over the table, which sees the whole region."""
    return overhead(support, *SIZE, FOCAL)
