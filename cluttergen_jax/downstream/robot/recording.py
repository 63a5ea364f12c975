"""Recordings of episodes: at every step of control what was observed, what was done, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.downstream.robot.outcome import Outcome


@dataclass(frozen=True, eq=False)
class EpisodeRecording:
    """One episode of T steps in an environment, whose numbers are its own (docs/contract.md).

    Attributes:
      number: of the episode. task: what it was to do, in words.
      outcome: how it ended, "" if it was not over. start: how it began, as text.
      robot: its name.
      names: of the numbers of `state`, `objects` and `action`.
      state: f32[T, S], `agent_pos` before each step; objects: f32[T, E], `environment_state`.
      action: f32[T, A]; reward: f32[T], after each step.
      simulation: f64[T, D], of the whole simulation before each step (`RobotEnv.simulation_state`).
      pictures: by camera, u8[H, W, 3] before each step.
    """

    number: int
    task: str
    outcome: str
    start: str
    robot: str
    names: Mapping[str, list[str]]
    state: np.ndarray
    objects: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    simulation: np.ndarray
    pictures: Mapping[str, Callable[[], Iterator[np.ndarray]]]

    def __len__(self) -> int:
        return len(self.action)

    @property
    def is_success(self) -> bool:
        """It ended in success."""
        return self.outcome == Outcome.SUCCESS
