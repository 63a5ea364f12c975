"""Asks which objects a robot's hand can hold; the code that tests grasps answers.

That code imports pools, so pools cannot import it: `cluttergen_jax/__init__.py` registers it here with
`answer_with`, and it is loaded when it is first asked.
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
    """Registers the function that `graspable_names` calls.

    Args:
      find: returns that function; called at the first question, so that nothing is imported before.
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
