"""What the arm's settings are, as one digest: rows of episodes that were planned otherwise are others."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache

from cluttergen_jax.downstream.constants import constants_hash
from cluttergen_jax.downstream.robot import cameras, episode, model, sensed
from cluttergen_jax.downstream.robot.grasping import grips
from cluttergen_jax.downstream.robot.motion import collision, columns, execute, ik, mover, plan, timing

_MODULES = (cameras, episode, model, sensed, grips, collision, columns, execute, ik, mover, plan, timing)


@cache
def planner_hash() -> str:
    """Hex digest of how the arm moves, plans, looks and is judged."""
    return constants_hash(*_MODULES, panda=list(asdict(model.PandaConfig()).values()))
