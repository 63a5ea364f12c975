"""The judge of one object that is moved: nothing else was disturbed, it stays, and it lies in the region."""

from __future__ import annotations

from typing import Any

import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome, told_motion
from cluttergen_jax.downstream.episodes.simulation import Phase, Simulation
from cluttergen_jax.downstream.transforms import motion_between
from cluttergen_jax.geometry import product, rotate_in_plane, yaw_quaternion
from cluttergen_jax.physics import has_moved

WATCHED = 2.0
"""Seconds for which everything must stand once the hand has left."""
WATCH_STEP = 0.1
"""Seconds between two looks at it meanwhile."""


def pose_on_stand(center: Any, top: float, resting: Any, yaw: float) -> np.ndarray:
    """f64[7]: an object on a stand, turned by radians.

    Args:
      center: f[2] or f[3], metres, of the stand. top: the height of its top.
      resting: the object's most likely pose, `height` and `quaternion`.
    """
    turn = product(np.array(yaw_quaternion(yaw)), np.asarray(resting.quaternion, np.float64))
    return np.array([*center[:2], top + resting.height, *turn])


class EpisodeReferee:
    """A simulated episode and its judge, who reads where everything truly is.

    Args:
      scene: all objects, where they stand at the start: `names`, `poses` and `support` with its region.
      target: the number of the one that is to be moved.
      execution: the simulation.

    Attributes:
      displaced: metres that another object was seen to have moved at most.
    """

    def __init__(self, scene: Any, target: int, execution: Simulation) -> None:
        self.scene = scene
        self.target = target
        self.execution = execution
        self._others = [k for k in range(len(scene.names)) if k != target]
        self.displaced = 0.0

    def check_others(self) -> None:
        """Compares the other objects with where they stood at the start.

        Raises:
          Failed: one has moved by more than `StabilityConfig` allows of neighbours.
        """
        if moved := self.moved_others():
            raise Failed(Outcome.DISPLACED, self.scene.names[moved[0]])

    def moved_others(self) -> list[int]:
        """The numbers of the other objects that have moved too far; keeps how far one has at most."""
        limits = StabilityConfig()
        now = self.execution.poses()[self._others]
        then = self.scene.poses[self._others]
        shift, turn = motion_between(now, then)
        self.displaced = max(self.displaced, float(shift.max(initial=0.0)))
        is_far = (shift > limits.max_shift) | (turn > limits.max_turn)
        return [number for number, far in zip(self._others, is_far, strict=True) if far]

    def check_placed(self) -> None:
        """The object stays where it was let go, in the region (Failed: it does not)."""
        self.check_stands()
        self.check_region()

    def check_stands(self) -> None:
        """Waits, and looks whether the object stays where it was let go.

        Raises:
          Failed: it moved by more than the last check of scenes allows, or another did.
        """
        limits = StabilityConfig()
        start = self.execution.poses()[self.target]
        for _ in range(round(WATCHED / WATCH_STEP)):
            self.execution.wait(WATCH_STEP, Phase.FREE)
            shift, turn = motion_between(self.execution.poses()[self.target], start)
            if has_moved(shift, turn, limits):
                raise Failed(Outcome.UNSTABLE, told_motion(float(shift), float(turn)))
            self.check_others()

    def check_region(self) -> None:
        """The middle of the object's box lies in the region, as scenes are judged by default.

        Raises:
          Failed: it does not.
        """
        region = self.scene.support.region
        pose = self.execution.pose(self.target)
        place = rotate_in_plane(pose[:2, 3] - np.asarray(region.center), -region.yaw)
        if (np.abs(place) > np.asarray(region.half_extents)).any():
            raise Failed(Outcome.OUTSIDE, self.scene.names[self.target])
