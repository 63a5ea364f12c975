"""Where numbers stopped being finite within one update."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.types import Array

SOUND = -1
_SUMS = ("loss", "gradient_norm")
"""Figures that merely add up others."""


class GradientSteps(struct.PyTreeNode):
    """Figures of gradient steps, one each or many along leading axes.

    Attributes:
      losses: by name, f32.
      gradients, weights: the weights' tree, f32: sums of squares, of the gradient and of what it led to.
    """

    losses: dict[str, Array]
    gradients: Any
    weights: Any


class Health(struct.PyTreeNode):
    """For every part of an update, where it was first not finite, i32; -1 where it was finite throughout.

    Attributes:
      rollout: the transitions' tree: the step.
      learning: the gradient step.
    """

    rollout: Any
    learning: GradientSteps

    @property
    def is_sound(self) -> Array:
        """bool: everything was finite."""
        return jnp.all(jnp.stack([leaf == SOUND for leaf in jax.tree.leaves(self)]))


def squares(tree: Any) -> Any:
    """The sum of squares of each leaf: finite only if the leaf is."""
    return jax.tree.map(lambda leaf: jnp.sum(leaf**2), tree)


def first_unsound(values: Array) -> Array:
    """i32: the first index along the leading axis at which `values` are not all finite, or -1."""
    if not jnp.issubdtype(values.dtype, jnp.inexact):
        return jnp.int32(SOUND)
    is_wrong = ~jnp.all(jnp.isfinite(values).reshape(values.shape[0], -1), axis=1)
    return jnp.where(jnp.any(is_wrong), jnp.argmax(is_wrong), SOUND).astype(jnp.int32)


def health_of(batch: Any, last: tuple[Any, Array], steps: GradientSteps) -> Health:
    """The health of one update.

    Args:
      batch: transitions, leading axis T; last: the observation after them, and its value.
      steps: with leading axis G, in order.
    """

    def either(index: Array, leaf: Array, after: Array) -> Array:
        is_wrong_after = first_unsound(after[None]) != SOUND
        return jnp.where((index == SOUND) & is_wrong_after, leaf.shape[0], index)

    found = jax.tree.map(first_unsound, batch)
    observation = jax.tree.map(either, found.observation, batch.observation, last[0])
    value = either(found.value, batch.value, last[1])
    rollout = found.replace(observation=observation, value=value)
    return Health(rollout, jax.tree.map(first_unsound, steps))


def explain(health: Health) -> str:
    """Where numbers first stopped being finite, as a clause for people; "" if nowhere.

    What happened first is the cause; at the same step, what the environment showed comes before what the
    network made of it and what that was paid, a loss before its gradient, and that before the weights.
    """
    health = jax.tree.map(lambda leaf: int(np.asarray(leaf)), health)
    seen, learning = health.rollout, health.learning
    made = {"action": seen.action, "log_prob": seen.log_prob, "value": seen.value}
    rollout = [
        ("the environment's", {"observation": seen.observation}),
        ("the network's", made),
        ("the environment's", {"reward": seen.reward, "done": seen.done}),
    ]
    steps = [
        ("", {name: step for name, step in learning.losses.items() if name not in _SUMS}),
        ("the gradient of", learning.gradients),
        ("", {name: step for name, step in learning.losses.items() if name in _SUMS}),
        ("the weights", learning.weights),
    ]
    return _first(rollout, "step {} of the rollout") or _first(steps, "gradient step {}")


def _first(parts: list[tuple[str, Any]], when: str) -> str:
    """The part of which something was wrong first, the earlier one in the list if two were at once."""
    found = [(*earliest, whose) for whose, tree in parts if (earliest := _earliest(tree))]
    if not found:
        return ""
    step, names, whose = min(found, key=lambda each: each[0])
    return f"{whose} {_listed(names)} at {when.format(step)}".strip()


def _earliest(tree: Any) -> tuple[int, list[str]] | None:
    """The first index at which anything was wrong, and the names of what was."""
    wrong = [(index, _name(path)) for path, index in jax.tree.leaves_with_path(tree) if index != SOUND]
    if not wrong:
        return None
    first = min(index for index, _ in wrong)
    return first, [name for index, name in wrong if index == first]


def _name(path: Any) -> str:
    keys = [str(getattr(key, "key", getattr(key, "name", getattr(key, "idx", key)))) for key in path]
    return "/".join(key for key in keys if key != "params")


def _listed(names: list[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
