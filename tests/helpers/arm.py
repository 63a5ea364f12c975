"""Two boxes on a table before the arm, and a rearrangement of them, for tests of the robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.downstream.rearrange.task import RearrangeProblem, RearrangeSetting
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.transforms import inverse, pose_of, rigid
from cluttergen_jax.scene import Scene
from tests.helpers.placing import with_surface
from tests.helpers.worlds import box

TABLE = cuboid_table()
TOP = TABLE.top
HALF = (0.02, 0.03, 0.03)
BOXES = (with_surface(box("red", HALF)), with_surface(box("blue", (0.02, 0.025, 0.04))))
PLACES = np.array([[0.05, -0.08], [0.05, 0.08]])


def standing(xy: Any) -> np.ndarray:
    """f64[2, 7]: the two boxes at f[2, 2]."""
    z = [TOP + asset.half_extents[2] for asset in BOXES]
    return np.array([[*place, height, 1, 0, 0, 0] for place, height in zip(xy, z, strict=True)])


SCENE = Scene(("red", "blue"), BOXES, standing(PLACES), TABLE)


def untested_grasp(name: str, turn: np.ndarray, height: float, width: float) -> Grasps:
    """One grasp of an object: f[3, 3] and metres, the tool in the object's frame."""
    pose = rigid(np.asarray(turn, float), np.array([0.0, 0.0, height]))[None]
    nothing = np.zeros(1)
    return Grasps(
        name,
        "",
        pose_of(pose),
        np.array([width]),
        nothing,
        nothing,
        nothing,
        nothing + 4,
        nothing > -1,
        1,
        pose_of(inverse(pose)),
    )


ALONG_X = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""From above, the fingers closing along the object's x."""


def grasps_of_box(name: str) -> Grasps:
    """From above, by the narrow sides; nothing was tested."""
    return untested_grasp(name, ALONG_X, 0.01, 0.04)


def draws(goals: np.ndarray) -> Callable[..., np.ndarray]:
    """In place of the generator: one layout, and for an object that must wait the far side of the table."""

    def draw(seed, chosen, region, standing=(), poses=None, number=64):
        if len(chosen) == 2:
            return goals[None]
        return np.array([[[-0.1, 0.0, TOP + BOXES[chosen[0]].half_extents[2], 1, 0, 0, 0]]], float)

    return draw


def task_of(goals: np.ndarray, scene: Scene = SCENE, draw: Any = None) -> RearrangeProblem:
    """The two boxes are to go to f64[2, 7]."""
    setting = RearrangeSetting("two", num_objects=2, target=Rectangle((0.0, 0.0), (0.2, 0.2)))
    grasps = tuple(grasps_of_box(name) for name in scene.names)
    return RearrangeProblem(setting, scene, (0, 1), grasps, (2, 2), draw or draws(goals), 3)
