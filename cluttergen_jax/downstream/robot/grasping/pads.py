"""Friction of the fingers' pads, by where its number comes from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot, mujoco_spec
from cluttergen_jax.downstream.robot.model import pad_geoms
from cluttergen_jax.downstream.words import PadSource
from cluttergen_jax.errors import ConfigError

PAD_FRICTION: dict[str, float] = {"robosuite": 1.0, "maniskill": 2.0}
"""Sliding coefficients of the Panda's fingers: robosuite's `panda_gripper.xml` (its tips have 2.0), and
ManiSkill's `panda.py`."""
_MOST = 5.0


def set_pads(
    robot: str | Path | RobotDescription, pads: float | PadSource | str
) -> RobotDescription:
    """The robot with other friction of its fingers' pads, for every function that takes one.

    It counts wherever a pad touches something, whatever friction that has; grasps and rows of other pads are
    kept apart.

    Args:
      robot: a name of `cluttergen list`, the YAML file of one of your own, or a description.
      pads: a sliding coefficient above 0, up to 5; "robosuite", 1.0; "maniskill", 2.0; "model", what the
        gripper's own model says (Menagerie's: 1.0 of Franka's hand, 0.6 of a 2F-85's tips); or "scene", none
        of their own: that of the scene's contacts (0.5), or of the object that is held.

    Raises:
      ConfigError: it is none of these, or the robot is none.
    """
    described = find_robot(robot)
    if pads == "scene":
        return _with_friction(described, None)
    if pads == "model":
        gripper = described.gripper
        geoms = pad_geoms(mujoco_spec(gripper.path), gripper)
        return _with_friction(described, min(float(each.friction[0]) for each in geoms))
    value: Any = PAD_FRICTION.get(str(pads), pads)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= _MOST:
        raise ConfigError(
            f"pads = {pads!r}",
            f"scene, model, {', '.join(PAD_FRICTION)}, or a number above 0 and up to {_MOST:g}",
            "pads='robosuite'",
        )
    return _with_friction(described, float(value))


def _with_friction(robot: RobotDescription, value: float | None) -> RobotDescription:
    return replace(robot, gripper=replace(robot.gripper, friction=value))
