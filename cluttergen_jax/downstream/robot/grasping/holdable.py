"""Which objects a hand can hold at all: those that it can lift while they stand alone on a plane."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

from cluttergen_jax.assets import ObjectAsset, find_pool
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.grasping.grasps import MIN_GRASPS, grasp_file, grasps_of
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.errors import BankError, ConfigError

_SECONDS = 5
"""Of a core, about, that the grasps of one object take."""
_MOST_NAMED = 12
_SAID: set[tuple[str, str, tuple[str, ...]]] = set()
"""What was said of pools in this process: a request is decided more than once."""


def graspable_names(pool: str, names: Sequence[str], robot: str) -> tuple[str, ...]:
    """Of a pool's objects those that the hand of a robot can hold, in their order.

    An object is one if any of `MIN_GRASPS` grasps of it that are looked for holds it (as those of `robot
    grasps`: closed, lifted, shaken, turned) and can be reached while it stands on a plane. They are kept for
    each object and gripper; those that are not known yet are tested first, and it is said.

    Args:
      pool: its name or folder. names: of its objects. robot: a name, or the file of one.

    Raises:
      ConfigError: the hand holds none of them, or there is no such robot.
      MissingExtraError: the extra `robot` is not installed.
    """
    described = find_robot(robot)
    found = find_pool(pool, names=names)
    objects = [found[name] for name in names]
    kept = [each.name for each in _holdable(objects, described)]
    if not kept:
        raise ConfigError(
            f"pool {pool!r}: the hand of {described.name} holds none of the {len(objects)} objects that are "
            "asked for",
            f"one that it holds: it opens by {_widest(described):.0f} mm",
            "another robot, or other objects: `cluttergen robot grasps POOL` shows them",
        )
    missing = [name for name in names if name not in kept]
    said = (pool, described.gripper.hash, tuple(missing))
    if missing and said not in _SAID:
        _SAID.add(said)
        print(
            f"grasps     the hand of {described.name} holds {len(kept)} of {len(names)} objects; not "
            f"{', '.join(missing[:_MOST_NAMED])}{' and others' if missing[_MOST_NAMED:] else ''}",
            file=sys.stderr,
        )
    return tuple(kept)


def check_holdable(objects: Sequence[ObjectAsset], robot: RobotDescription, bank: str) -> None:
    """Refuses a bank of whose objects a hand can hold none; ends at the first that it can.

    Raises:
      BankError: so it is.
    """
    different = list({id(each): each for each in objects}.values())
    # What is known is looked at first.
    different.sort(key=_unknown(different, robot).__contains__)
    if next(_holdable(different, robot, says=False), None) is None:
        raise BankError(
            f"{bank}: the hand of {robot.name} holds none of its {len(different)} objects",
            f"one that it holds: it opens by {_widest(robot):.0f} mm",
            f"a bank of `cluttergen generate` with --graspable {robot.name}, or another robot",
        )


def _holdable(
    objects: Sequence[ObjectAsset], robot: RobotDescription, says: bool = True
) -> Iterator[ObjectAsset]:
    """Those of the objects that the hand holds; `says` first how many have to be tested."""
    unknown = _unknown(objects, robot)
    if unknown and says:
        print(
            f"grasps     of {len(unknown)} of {len(objects)} objects are not known for the hand of "
            f"{robot.name}: they are tested now, about {_SECONDS} s of a core each, and kept",
            file=sys.stderr,
        )
    made = grasps_of(objects, MIN_GRASPS, num_threads=0, robot=robot)
    for asset, grasps in zip(objects, made, strict=True):
        if grasps.is_low.any():
            yield asset


def _unknown(objects: Sequence[ObjectAsset], robot: RobotDescription) -> list[ObjectAsset]:
    return [each for each in objects if not grasp_file(each, MIN_GRASPS, 0, robot).is_file()]


def _widest(robot: RobotDescription) -> float:
    """Millimetres."""
    return 2e3 * gripper_of(robot).max_opening
