"""Asks for the environment of a robot that travels with an export; the code that knows robots answers.

Exports know scenes alone: `cluttergen_jax/__init__.py` registers that code here with `answer_with`, and it is
loaded when it is first asked.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class EnvironmentWriter(Protocol):
    """Writes the environment of a robot in a bank beside that, to be run without this package."""

    def __call__(self, folder: Path, robot: Any) -> str:
        """Into a folder that has the bank in `bank`; returns the terms of the robot's files, in words."""
        ...


_answered_by: Callable[[], EnvironmentWriter] | None = None


def answer_with(find: Callable[[], EnvironmentWriter]) -> None:
    """Registers the function that `write_environment` calls.

    Args:
      find: returns that function; called at the first question, so that nothing is imported before.
    """
    global _answered_by
    _answered_by = find


def write_environment(folder: Path, robot: Any) -> str:
    """Writes the environment of a robot beside the bank in `folder/bank`.

    Args:
      robot: a name, the file of one, or a `RobotDescription`.

    Returns:
      The terms of the robot's files, in words.

    Raises:
      ConfigError: there is no such robot.
      MissingExtraError: the extra `robot` or `gym` is not installed.
    """
    assert _answered_by is not None
    return _answered_by()(folder, robot)
