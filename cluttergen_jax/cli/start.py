"""Starting from a finished scene: its objects stay and count as neighbours."""

from __future__ import annotations

import jax.numpy as jnp

from cluttergen_jax.bank import read_bank
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.problem import Problem
from cluttergen_jax.types import Array


def start_of(text: str, problem: Problem) -> tuple[Array, Array]:
    """The objects and poses of scene BANK:INDEX, as object indices of the problem's world.

    Returns:
      i32[N] and f32[N, 7].

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
    return jnp.array([names.index(name) for name in scene.objects], jnp.int32), jnp.asarray(scene.poses)
