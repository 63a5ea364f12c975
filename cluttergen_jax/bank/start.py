"""Starting from a finished scene: its objects stay and count as neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.bank import read_bank
from cluttergen_jax.bank.reference import parse_reference
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.rules import empty_start
from cluttergen_jax.placement.types import Start
from cluttergen_jax.world import World, base_name


def read_start(text: str | None) -> tuple[list[ObjectAsset], np.ndarray]:
    """The objects of one scene of a bank, from the bank's own copies, and their poses f32[N, 7].

    Args:
      text: which one, as `reference.parse_reference` reads it; None for no objects.

    Raises:
      ConfigError: the text names no single scene.
      BankError: there is no such bank or scene, or the scene failed.
    """
    if text is None:
        return [], np.zeros((0, 7), np.float32)
    path, number = parse_reference(text) or (None, None)
    if path is None or number is None:
        raise ConfigError(f"start {text!r}", "BANK:INDEX, such as out:3")
    bank = read_bank(path)
    scene = next((each for each in bank.scenes() if each.index == number), None)
    if scene is None or not scene.is_success:
        state = "no such scene" if scene is None else f"a scene that failed: {scene.verdict}"
        raise BankError(f"start {text}: {state}", "a scene that stands")
    return [bank.object(base_name(name)) for name in scene.objects], scene.poses


def start_of(world: World, standing: Sequence[ObjectAsset], poses: np.ndarray) -> Start:
    """The start of episodes in a world whose last objects are the standing ones, at `poses` f32[N, 7]."""
    index = world.num_objects - len(standing) + jnp.arange(len(standing))
    empty = empty_start(world.num_objects)
    return Start(empty.poses.at[index].set(poses), empty.is_placed.at[index].set(True))
