"""An episode as it happened, on the host: every attempt with its trajectory. What viewers and films show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.types import Verdict


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt at placing one object. K objects in the world; poses are metres and wxyz, world frame.

    Attributes:
      object_index: which object.
      ordinal: the first attempt of the object's turn is 1 (`placement.types.Transition`).
      action: f32[4], what was proposed (docs/contract.md).
      verdict: how it was judged.
      trajectory: f32[T + 1, 13], the object at release and after each of T steps (`types.Settling`).
      poses: f32[K, 7] and is_placed: bool[K], the scene before the attempt.
      settled: f32[K, 7], the scene's poses when the attempt ended, committed or not.
      proposals: f32[N, 4], actions that the method draws here, where they were asked for.
      gathered: f32[K, 7], the scene's poses once physics drew all objects together after this attempt
        (`SceneSpec.crowd`), of which the way there is not recorded; None where it did not.
    """

    object_index: int
    ordinal: int
    action: np.ndarray
    verdict: Verdict
    trajectory: np.ndarray
    poses: np.ndarray
    is_placed: np.ndarray
    settled: np.ndarray
    proposals: np.ndarray | None = None
    gathered: np.ndarray | None = None

    @staticmethod
    def of(
        before: Any, transition: Any, settling: Any, proposals: np.ndarray | None = None
    ) -> Attempt:
        """From the episode before an attempt, what came of it and how it settled (`placement.types`)."""
        return Attempt(
            object_index=int(transition.object_index),
            ordinal=int(transition.ordinal),
            action=np.asarray(transition.action),
            verdict=Verdict(int(transition.verdict)),
            trajectory=np.asarray(settling.trajectory)[: int(settling.num_steps) + 1],
            poses=np.asarray(before.poses),
            is_placed=np.asarray(before.is_placed),
            settled=np.asarray(settling.poses),
            proposals=proposals,
        )

    @property
    def is_stable(self) -> bool:
        """The object stayed where it came to rest."""
        return self.verdict == Verdict.STABLE

    @property
    def num_steps(self) -> int:
        """T."""
        return len(self.trajectory) - 1

    def poses_gathering(self, share: float) -> np.ndarray:
        """f64[K, 7]: `share`, in [0, 1], of the straight way from `settled` to `gathered`, for the eye."""
        assert self.gathered is not None
        start = self.settled.astype(np.float64)
        end = self.gathered.astype(np.float64)
        # A quaternion and its negative are the same orientation.
        end[:, 3:] *= np.where((start[:, 3:] * end[:, 3:]).sum(1, keepdims=True) < 0, -1.0, 1.0)
        poses = (1 - share) * start + share * end
        poses[:, 3:] /= np.maximum(np.linalg.norm(poses[:, 3:], axis=1, keepdims=True), 1e-9)
        return poses


@dataclass(frozen=True, eq=False)
class Replay:
    """A scene with its attempts, where they are known.

    Attributes:
      title: what to call it.
      objects, names: the world's K objects.
      support: what carries them.
      region: the queried region; keep_out: boxes that objects stayed out of.
      poses: f32[K, 7], how the scene ended; is_placed: bool[K].
      is_success: every slot is filled and the scene stands; verdict: the last word on it.
      drift: metres, the largest movement in the last check; 0 if there was none.
      attempts: in the order in which they were made; empty if nobody knows.
      timestep: seconds between two rows of an attempt's trajectory.
      seat: at which side of the region someone sits (`SceneSpec.seat`); "" where nobody does.
    """

    title: str
    objects: tuple[ObjectAsset, ...]
    names: tuple[str, ...]
    support: SupportAsset
    region: Rectangle
    poses: np.ndarray
    is_placed: np.ndarray
    is_success: bool
    verdict: str
    drift: float = 0.0
    attempts: tuple[Attempt, ...] = ()
    keep_out: tuple[Rectangle, ...] = ()
    timestep: float = StabilityConfig().timestep
    seat: str = ""

    @property
    def placed(self) -> np.ndarray:
        """i64[N]: the objects that stand there in the end."""
        return np.flatnonzero(self.is_placed)

    @property
    def failures(self) -> tuple[Attempt, ...]:
        """The attempts that failed."""
        return tuple(attempt for attempt in self.attempts if not attempt.is_stable)

    def attempts_at(self, object_index: int) -> tuple[Attempt, ...]:
        """The attempts at one object, in order."""
        return tuple(each for each in self.attempts if each.object_index == object_index)

    def last_turn(self, object_index: int) -> tuple[Attempt, ...]:
        """The attempts of an object's last turn, during which nothing was taken away, in order."""
        attempts = self.attempts_at(object_index)
        first = max((place for place, each in enumerate(attempts) if each.ordinal == 1), default=0)
        return attempts[first:]

    def taken_away(self, number: int) -> np.ndarray:
        """i64[N]: the objects that stood there until just before attempt `number`, from 0."""
        if number == 0:
            return np.zeros(0, np.int64)
        before = self.attempts[number - 1]
        attempt = self.attempts[number]
        stood = before.is_placed.copy()
        stood[before.object_index] |= before.is_stable
        return np.flatnonzero(stood & ~attempt.is_placed)
