"""Doors that are closed when all objects are placed, as engines know them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.doors import Doors, carriers_of, moves_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.physics.doors import Carriage, CarryingSurface, DoorLayout
from cluttergen_jax.physics.layout import Layout


def door_layout(
    doors: Doors, closed: Layout, compile_moving: Callable[[], mujoco.MjModel]
) -> DoorLayout:
    """What an engine knows of doors.

    Args:
      closed: the world with the doors closed; compile_moving: see `DoorLayout`.
    """
    support = doors.open
    numbers = list(doors.numbers)
    joints = [support.joints[number] for number in numbers]

    reach = []
    for joint in joints:
        points = [support.boxes[k].mesh.vertices for k in joint.boxes]
        points += [support.parts[k].vertices for k in joint.parts]
        away = np.concatenate(points or [np.array([joint.anchor])]) - joint.anchor
        across = float(np.linalg.norm(np.cross(away, joint.axis), axis=1).max())
        reach.append(1.0 if joint.kind == "slide" else max(across, 0.01))
    return DoorLayout(
        names=doors.names,
        is_turning=np.array([joint.kind == "hinge" for joint in joints]),
        travel=doors.travel,
        reach=np.array(reach),
        carriage=carriage_of(support, numbers),
        closed=closed,
        compile_moving=compile_moving,
        bodies=tuple(f"door.{number}" for number in numbers),
    )


def carriage_of(support: SupportAsset, numbers: Sequence[int]) -> Carriage:
    """How what stands on a support moves with some of its joints, by number."""
    numbers = list(numbers)

    def moves(travel: np.ndarray) -> np.ndarray:
        everyone = np.zeros((*travel.shape[:-1], len(support.joints)))
        everyone[..., numbers] = travel
        return moves_of(support.joints, everyone)[..., numbers, :, :]

    def door_of(number: int) -> int:
        while number >= 0 and number not in numbers:
            number = support.joints[number].parent
        return numbers.index(number) if number >= 0 else -1

    surfaces = [
        CarryingSurface(door_of(by), each.T_world_surface, each.polygon.min(0), each.polygon.max(0))
        for each, by in zip(support.surfaces, carriers_of(support), strict=True)
    ]
    return Carriage(moves, tuple(surfaces))


def poses_on(
    support: SupportAsset, other: SupportAsset, objects: Sequence[ObjectAsset], poses: np.ndarray
) -> np.ndarray:
    """f64[N, 7]: where objects that rest on a support are once its joints stand as those of `other`.

    Args:
      other: the same support with its joints elsewhere; poses: f[N, 7], world frame, metres, wxyz.
    """
    if not support.joints or not len(objects):
        return np.asarray(poses, np.float64)
    carriage = carriage_of(support, range(len(support.joints)))
    pairs = zip(support.joints, other.joints, strict=True)
    travel = np.array([last.value - first.value for first, last in pairs])
    centers = np.array([asset.center_of_mass for asset in objects])
    poses = np.asarray(poses, np.float64)
    return carriage.carried(poses, carriage.carriers(poses, centers), travel)
