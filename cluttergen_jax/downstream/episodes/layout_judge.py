"""The judge of rearrangements: it alone, besides `TrueObserver`, reads where objects truly are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cluttergen_jax.config import StabilityConfig, VerifyConfig
from cluttergen_jax.downstream.episodes.outcome import Cause, Failed, Outcome, told_motion
from cluttergen_jax.downstream.episodes.referee import WATCHED
from cluttergen_jax.downstream.episodes.simulation import Phase, Simulation
from cluttergen_jax.downstream.transforms import matrix_of, offset
from cluttergen_jax.physics import check_standing, displacement, has_moved, watch

# Metres and radians, up to its symmetry, that each object may be from its place in the chosen layout.
MAX_ERROR = 0.015
MAX_TURN_ERROR = float(np.radians(10))
_LIMITS = StabilityConfig()
_LOOK = 0.1
"""Seconds between two looks at what stands."""


@dataclass(eq=False)
class RearrangementJudge:
    """Watches an episode and says at its end whether the objects are where they should be.

    Args:
      execution: the simulation. scene: as it was at the start (`SimulatedWorld.scene`); the first `num_moved`
        objects are to be moved.
      symmetry: of each object (`assets.symmetry.turn_symmetry`).
    """

    execution: Simulation
    scene: Any
    num_moved: int
    symmetry: Sequence[int]

    def __post_init__(self) -> None:
        self._before = self.execution.poses()

    def begin_move(self) -> None:
        """Remembers where everything is before an object is moved."""
        self._before = self.execution.poses()

    def check_others(self, moved: int) -> None:
        """Compares the objects but the one that was moved with where they were.

        Raises:
          Failed: one was disturbed: it is farther from there than the last check of scenes allows.
        """
        far = _has_moved(self.execution.poses(), self._before)
        far[moved] = False
        if far.any():
            raise Failed(Outcome.DISPLACED, self.scene.names[int(far.argmax())])

    def errors(self, goals: np.ndarray) -> np.ndarray:
        """f64[num_moved, 2]: metres and radians of each object from its goal f64[N, 7], up to symmetry."""
        now = matrix_of(self.execution.poses())
        goal = matrix_of(goals)
        return np.array([offset(now[k], goal[k], self.symmetry[k]) for k in range(self.num_moved)])

    def is_right(self, goals: np.ndarray) -> np.ndarray:
        """bool[num_moved]: the objects that are where they should be."""
        return np.all(self.errors(goals) <= [MAX_ERROR, MAX_TURN_ERROR], axis=1)

    def check_end(self, goals: np.ndarray) -> None:
        """All stands for `episode.WATCHED` seconds, where it should be, and for ten without the arm.

        Raises:
          Failed: it does not.
        """
        start = self.execution.poses()
        names = self.scene.names
        self.execution.wake()
        looks = range(1, round(WATCHED / _LOOK) + 1)
        for shift, turn in watch(self._wait, start, looks):
            far = has_moved(shift, turn, _LIMITS)
            if far.any():
                raise Failed(Outcome.UNSTABLE, names[int(far.argmax())])
        right = self.is_right(goals)
        if not right.all():
            worst = int(right.argmin())
            shift, turn = self.errors(goals)[worst]
            raise Failed(Cause.MISPLACED, f"{names[worst]}: {told_motion(shift, turn)}")
        others = slice(self.num_moved, None)
        far = _has_moved(self.execution.poses()[others], self.scene.poses[others])
        if far.any():
            raise Failed(Outcome.DISPLACED, names[self.num_moved + int(far.argmax())])
        self._check_alone()

    def _wait(self, number: int) -> np.ndarray:
        """So many times a tenth of a second, and the poses after it."""
        self.execution.wait(number * _LOOK, Phase.FREE)
        return self.execution.poses()

    def _check_alone(self) -> None:
        """The scene without the arm, at rest, in its own time step."""
        poses = self.execution.poses()
        spec = self.scene.to_mjspec()
        spec.keys[0].qpos = poses.ravel()
        for name, pose in zip(self.scene.names, poses, strict=True):
            body = spec.body(name)
            body.pos = pose[:3]
            body.quat = pose[3:]
        found = check_standing(spec.compile(), 0, VerifyConfig.seconds, _LIMITS)
        if not found.stands:
            raise Failed(Outcome.UNSTABLE, f"{found.worst}, alone")


def _has_moved(now: np.ndarray, then: np.ndarray) -> np.ndarray:
    """bool[N]: poses f64[N, 7] farther apart than the last check of scenes allows."""
    return has_moved(*displacement(np, now, then), _LIMITS)
