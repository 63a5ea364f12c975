"""Doors that are closed when all objects are placed, as engines know them."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from cluttergen_jax.assets.doors import Doors, carriers_of, moves_of
from cluttergen_jax.physics.doors import CarryingSurface, DoorLayout
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

    def moves(travel: np.ndarray) -> np.ndarray:
        everyone = np.zeros((*travel.shape[:-1], len(support.joints)))
        everyone[..., numbers] = travel
        return moves_of(support.joints, everyone)[..., numbers, :, :]

    def door_of(number: int) -> int:
        while number >= 0 and number not in numbers:
            number = support.joints[number].parent
        return numbers.index(number) if number >= 0 else -1

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
        moves=moves,
        surfaces=tuple(
            CarryingSurface(
                door_of(by), each.T_world_surface, each.polygon.min(0), each.polygon.max(0)
            )
            for each, by in zip(support.surfaces, carriers_of(support), strict=True)
        ),
        closed=closed,
        compile_moving=compile_moving,
        bodies=tuple(f"door.{number}" for number in numbers),
    )
