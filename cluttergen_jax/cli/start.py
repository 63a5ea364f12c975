"""Starting from a finished scene: its objects stay and count as neighbours."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.bank import read_bank
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.rules import empty_start
from cluttergen_jax.placement.types import Start
from cluttergen_jax.problem import Problem


def start_of(text: str, problem: Problem) -> Start:
    """Scene BANK:INDEX as the start of episodes in the problem's world.

    Raises:
      ConfigError: the text is no BANK:INDEX, or an object of the scene is not in the world.
      BankError: there is no such bank or scene.
    """
    path, _, number = text.rpartition(":")
    if not path or not number.isdigit():
        raise ConfigError(f"--start {text!r}", "BANK:INDEX, such as out:3")
    scene = next((each for each in read_bank(path).scenes() if each.index == int(number)), None)
    if scene is None:
        raise BankError(f"{path} has no scene {number}")
    names = problem.world.names
    missing = sorted(set(scene.objects) - set(names))
    if missing:
        raise ConfigError(
            f"scene {text} holds {', '.join(missing)}, which this world lacks",
            ", ".join(names),
            "the pool that the scene was made of",
        )
    index = jnp.array([names.index(name) for name in scene.objects], jnp.int32)
    empty = empty_start(problem.world.num_objects)
    return Start(empty.poses.at[index].set(scene.poses), empty.is_placed.at[index].set(True))
