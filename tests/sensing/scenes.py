"""Boxes on a table: scenes whose surfaces and heights are known without any renderer."""

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset, cuboid_table
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.sensing.partial import Grid
from tests.helpers.worlds import box

TABLE = cuboid_table()


def model_of(objects: list[ObjectAsset], support: SupportAsset = TABLE) -> mujoco.MjModel:
    """Objects without surfaces, parked."""
    return populated_spec(
        [each.name for each in objects], objects, support, 0.004, ContactConfig()
    ).compile()


def standing(
    x: float, y: float, half_height: float, yaw: float = 0.0, top: float = TABLE.top
) -> np.ndarray:
    """f64[7]: upright on the table."""
    return np.array([x, y, top + half_height, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])


def random_boxes(
    rng: np.random.Generator, count: int
) -> tuple[list[ObjectAsset], np.ndarray, np.ndarray]:
    """Boxes that may overlap, their poses f64[K, 7], and f64[K, 6]: x, y, yaw and half extents."""
    half = rng.uniform([0.02, 0.02, 0.01], [0.08, 0.08, 0.12], (count, 3))
    place = rng.uniform([-0.22, -0.27, -np.pi], [0.22, 0.27, np.pi], (count, 3))
    objects = [box(f"box-{index}", sides) for index, sides in enumerate(half)]
    poses = [standing(x, y, sides[2], yaw) for (x, y, yaw), sides in zip(place, half, strict=True)]
    return objects, np.stack(poses), np.hstack([place, half])


def true_heights(grid: Grid, boxes: np.ndarray) -> np.ndarray:
    """f64[W, H]: heights above the top at the middles of the cells, by arithmetic; 0 on the bare top."""
    xy = grid.columns[..., :2]
    height = np.zeros(grid.bare.shape)
    for x, y, yaw, along, across, up in boxes:
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        local = np.abs((xy - [x, y]) @ turn)
        height = np.where((local <= [along, across]).all(-1), np.maximum(height, 2 * up), height)
    return height
