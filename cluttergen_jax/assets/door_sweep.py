"""Doors that cannot close though nothing is behind them: they hit the furniture itself."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from cluttergen_jax.assets.doors import Doors
from cluttergen_jax.assets.mjcf import add_door_bodies, add_support
from cluttergen_jax.errors import ConfigError

_SWEEP = 24
"""Places at which it is looked whether an empty door hits something."""
_HITS = 0.005
"""Metres that a door may overlap another part more on its way than at both ends."""
_CLOSED_HITS = 0.015
"""Metres that it may overlap more where it is closed than where it is open."""


def check_empty(doors: Doors) -> None:
    """Refuses doors that hit the furniture itself on their way, or where they are closed.

    Furniture of files touches itself at hinges and rails: a door is refused if it overlaps another part by
    5 mm more on its way than at both ends, or by 1.5 cm more where it is closed than where it is open.

    Raises:
      ConfigError: one does; the message names it, and what it hits.
    """
    spec = mujoco.MjSpec()
    bodies = add_door_bodies(spec, doors.open, doors.numbers)
    add_support(spec, doors.open, moving=bodies)
    model = spec.compile()
    data = mujoco.MjData(model)
    num_doors = len(doors.numbers)
    own = {model.body(f"door.{number}").id: k for k, number in enumerate(doors.numbers)}
    door_of_geom = np.array([own.get(int(body), num_doors) for body in model.geom_bodyid])
    address = [model.joint(f"door.{number}").qposadr[0] for number in doors.numbers]
    is_turning = np.array([doors.open.joints[each].kind == "hinge" for each in doors.numbers])
    place = np.zeros(num_doors)
    for is_stage in (~is_turning, is_turning):
        depths = []
        for share in np.linspace(0, 1, _SWEEP + 1):
            data.qpos[address] = place + share * np.where(is_stage, doors.travel, 0.0)
            mujoco.mj_fwdPosition(model, data)
            depth = np.zeros((num_doors + 1, num_doors + 1))
            pair = door_of_geom[data.contact.geom]
            np.maximum.at(depth, (pair[:, 0], pair[:, 1]), np.maximum(-data.contact.dist, 0.0))
            depths.append(np.maximum(depth, depth.T)[:num_doors])
        place = place + np.where(is_stage, doors.travel, 0.0)
        found = np.array(depths)
        for door in np.flatnonzero(is_stage).tolist():
            on_way = found[1:-1, door] - np.maximum(found[0, door], found[-1, door])
            at, other = np.unravel_index(int(np.argmax(on_way)), on_way.shape)
            if on_way[at, other] > _HITS:
                raise _closing_error(doors, door, int(other), float((at + 1) / _SWEEP))
            closed = found[-1, door] - found[0, door]
            if closed.max() > _CLOSED_HITS:
                raise _closing_error(doors, door, int(np.argmax(closed)), 1.0)


def _closing_error(doors: Doors, door: int, other: int, share: float) -> ConfigError:
    """What is said of a door that hits something when it has made this share of its way."""
    joint = doors.open.joints[doors.numbers[door]]
    value = joint.value + share * float(doors.travel[door])
    place = f"{value:.2f} m" if joint.kind == "slide" else f"{math.degrees(value):.0f} degrees"
    others = [*(f"door {name!r}" for name in doors.names), "the furniture itself"]
    return ConfigError(
        f"door {joint.name!r} of support {doors.open.name!r}, which cannot close: empty as it is, it hits "
        f"{others[other]} at {place}",
        "doors with a free way",
        "doors='open'",
    )
