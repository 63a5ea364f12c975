"""How far an episode has come, 0 to 1: what dense rewards are changes of, in NumPy and in JAX.

Distances are metres; `xp` is the namespace of the arrays, `numpy` or `jax.numpy`.
"""

from __future__ import annotations

from typing import Any

LIFT = 0.12
"""Metres that an object is lifted, and lowered from."""
LIFTED = 0.8 * LIFT
"""Metres by which an object that counts as grasped was lifted at least."""
_HALF = 0.2
"""Metres at which nearness is a half: it grows all the way from where an arm begins."""
_STILL = 20.0
"""1 / m."""


def nearness(distance: Any) -> Any:
    """1 at no distance, 0 far away."""
    return _HALF / (_HALF + distance)


def stillness(xp: Any, displaced: Any) -> Any:
    """1 where no other object has moved, 0 where one has moved far."""
    return 1 - xp.tanh(_STILL * displaced)


def grasp_progress(xp: Any, distance: Any, displaced: Any, is_held: Any, height: Any) -> Any:
    """Of grasping: the tool comes near, the hand touches, the object is lifted.

    Args:
      distance: of the tool from the object. displaced: of another object from where it stood, at most.
      is_held: the hand touches the object. height: that it is lifted by.
    """
    lifted = xp.clip(height / LIFTED, 0.0, 1.0)
    share = 0.3 * nearness(distance) + xp.where(is_held, 0.2 + 0.5 * lifted, 0.0)
    return stillness(xp, displaced) * share


def place_progress(
    xp: Any, distance: Any, displaced: Any, is_held: Any, away: Any, is_watching: Any
) -> Any:
    """Of placing: the tool comes near, the hand touches, the object nears the region, and lies there let go.

    Args:
      distance, displaced, is_held: as of `grasp_progress`.
      away: of the object from the region in plan.
      is_watching: it was let go there, and is watched.
    """
    carried = 0.2 * nearness(distance) + xp.where(is_held, 0.2 + 0.4 * nearness(away), 0.0)
    carried = xp.where((away == 0) & ~is_held, 0.8, carried)
    return stillness(xp, displaced) * xp.where(is_watching, 1.0, carried)


def rearrange_progress(xp: Any, distance: Any, is_held: Any, errors: Any) -> Any:
    """Of rearranging: the objects near their goals; a little for the tool near one that is not there.

    Args:
      distance: of the tool from the nearest object that is not right, inf where all are.
      is_held: the hand touches the object that it may touch. errors: f[N], of each object from its goal.
    """
    placed = nearness(errors).mean()
    return 0.8 * placed + 0.1 * nearness(distance) + xp.where(is_held, 0.1, 0.0)
