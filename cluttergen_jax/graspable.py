"""Which objects a hand can hold: choices of objects ask, and what knows hands answers, which lies above them.

What tests grasps stands on pools, so pools cannot import it. `cluttergen_jax/__init__.py`, which is imported
before any of its modules, says who answers; nothing of that is loaded until it is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol


class Graspable(Protocol):
    """Says which of a pool's objects the hand of a robot can hold."""

    def __call__(self, pool: str, names: Sequence[str], robot: str) -> tuple[str, ...]:
        """Of names of a pool's objects those that it holds, in their order; a ConfigError if none."""
        ...


_answered_by: Callable[[], Graspable] | None = None


def answer_with(find: Callable[[], Graspable]) -> None:
    """Says who answers from now on.

    Args:
      find: returns it, and is called when it is asked.
    """
    global _answered_by
    _answered_by = find


def graspable_names(pool: str, names: Sequence[str], robot: str) -> tuple[str, ...]:
    """Of names of a pool's objects those that the hand of a robot can hold, in their order.

    Args:
      pool: its name or folder. robot: a name, or the file of one.

    Raises:
      ConfigError: it holds none, or there is no such robot.
      MissingExtraError: the extra `robot` is not installed.
    """
    assert _answered_by is not None
    return _answered_by()(pool, names, robot)
