"""The camera that sees most of what stands in furniture whose doors and drawers are open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from cluttergen_jax.assets.doors import moves_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.rendering.camera import fit_camera
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.sensing import Camera, InstanceSensor

_TURNS = (22.0, -22.0)
_ELEVATIONS = (-14.0, -24.0, -35.0, -50.0)
"""Degrees, from straight in front and from level. A drawer hides what is behind doors below it."""
_LOOK = (160, 120)
"""Pixels of the pictures in which it is counted how much is seen."""


def inside_camera(
    objects: Sequence[ObjectAsset],
    poses: np.ndarray,
    support: SupportAsset,
    picture: PictureConfig,
) -> Camera:
    """Of cameras in front of the furniture, which show all of it, the one that sees most of the objects.

    Args:
      objects, poses: N of them, f[N, 7], T_world_object, metres, wxyz.
      support: with its doors open, see `assets.doors.with_doors_open`.
      picture: its size and its field of view are the camera's.
    """
    points = np.concatenate(
        [
            *(piece.mesh.vertices for piece in support.collision_pieces),
            *(
                transform_points(pose, part.vertices)
                for asset, pose in zip(objects, np.asarray(poses, np.float64), strict=True)
                for part in asset.parts
            ),
        ]
    )
    sensor = InstanceSensor(objects, support)
    front = opening_side(support)

    def camera(turn: float, elevation: float, width: int, height: int) -> Camera:
        azimuth = math.degrees(front) + 180.0 + turn
        view = replace(picture.view, azimuth=azimuth, elevation=elevation)
        return fit_camera(points, view, width, height)

    def visible_sum(place: tuple[float, float]) -> float:
        _, instances = sensor.sense(poses, camera(*place, *_LOOK))
        return sum(each.visible_share for each in instances)

    best = max(product(_TURNS, _ELEVATIONS), key=visible_sum)
    return camera(*best, picture.width, picture.height)


def opening_side(support: SupportAsset) -> float:
    """Radians from +x: to which side the doors and drawers of a support open that scenes close."""
    joints = support.joints
    closing = [0.0 if each.closed is None else each.closed - each.value for each in joints]
    moves = moves_of(joints, np.array(closing))
    way = np.zeros(2)
    for joint, T in zip(joints, moves, strict=True):
        solids = [support.boxes[k].mesh for k in joint.boxes]
        solids += [support.parts[k] for k in joint.parts]
        for points in (each.vertices for each in solids):
            way += (points - points @ T[:3, :3].T - T[:3, 3]).mean(0)[:2]
    return math.atan2(way[1], way[0])
