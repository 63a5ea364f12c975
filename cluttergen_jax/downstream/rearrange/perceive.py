"""The observer that looks: pictures of the camera over the table and of the one on the hand, with noise."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.digests import constants_hash, json_digest
from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE, NoiseConfig, noisy
from cluttergen_jax.downstream.perception.finder import FoundScene, SceneFinder, finder_hash
from cluttergen_jax.downstream.rearrange.observe import EpisodeView, SceneEstimate
from cluttergen_jax.downstream.robot import (
    ArmSilhouette,
    RobotDescription,
    above,
    base_pose,
    find_robot,
    wrist_camera,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing import Camera, CameraPlan, View

UNSURE = 0.5
"""Certainty below which another look is taken."""
MOST_LOOKS = 2
_MILLISECONDS = 1000


def registration_hash(noise: NoiseConfig) -> str:
    """Hex digest of how often is looked, with which noise, and how poses are found in what was seen."""
    return constants_hash(sys.modules[__name__], finder=finder_hash(), noise=noise)


@dataclass(eq=False)
class PerceptionObserver:
    """Tells where objects are by what cameras see alone; an `observe.Observer`.

    The camera on the hand looks over the table, then the one above it, when the arm is out of its way. Each
    object's pose is that which agrees best with both pictures. Where one of several is not sure, the camera
    above takes a second picture, with noise of its own. Where cameras stand is known to millimetres and
    tenths of a degree only: each moment's looks are brought to agree with what is known
    (`finder.SceneFinder`), and count as much as those of any moment before. What is in the hand the
    fingers mostly hide: nothing is said of it.

    Args:
      finder: of the objects. support: the table.
      noise: of the depth cameras. seed: of the noise, with that of the episode.
      cameras: that look when the arm has drawn back; the one over the table if empty. Those that do not stand
        at a fixed place are drawn for each episode.
      has_wrist: the camera on the hand looks, too.
      weights: which network and rule of certainty the finder has; rows of others are not taken up.
      robot: whose arm is left out of the pictures; the Panda if not given.
    """

    name = "perception"
    sees_held = False
    finder: SceneFinder
    support: SupportAsset
    noise: NoiseConfig = REALSENSE
    seed: int = 0
    weights: str = ""
    cameras: Sequence[CameraPlan] = ()
    has_wrist: bool = True
    robot: RobotDescription | None = None

    def __post_init__(self) -> None:
        robot = find_robot(self.robot)
        self._silhouette = ArmSilhouette(base_pose(self.support, robot), robot)
        self._glances: list[View] = []
        self._num_before = 0
        self.registration = registration_hash(self.noise)
        if self.cameras or not self.has_wrist:
            self.registration = json_digest(
                [self.registration, repr(tuple(self.cameras)), self.has_wrist]
            )

    def glance(self, world: EpisodeView) -> None:
        self._glances = self._look(world, wrist_camera(world.tool), 0) if self.has_wrist else []

    def __call__(
        self, world: EpisodeView, names: Sequence[str], known: np.ndarray
    ) -> SceneEstimate:
        looks, self._glances = self._glances, []
        before = 0 if np.isnan(known).all() else self._num_before
        self._num_before = before + 1
        found: FoundScene | None = None
        for number in range(MOST_LOOKS):
            for place, camera in enumerate(self._around(world)):
                looks += self._look(world, camera, number + place * MOST_LOOKS)
            if looks:
                found = self.finder(looks, names, known, before / (before + 1))
                if (found.certainty >= UNSURE).all():
                    break
        if found is None:
            nothing = np.zeros(len(names))
            return SceneEstimate(
                tuple(names), np.zeros((len(names), 7)), nothing.astype(bool), nothing
            )
        # What was never seen and is half hidden may be anywhere under what hides it.
        least = np.where(np.isnan(known).any(1), found.visible, 1.0)
        return SceneEstimate(
            found.names, found.pose, found.seen, np.minimum(found.certainty, least)
        )

    def _around(self, world: EpisodeView) -> list[Camera]:
        """The cameras that stand around the table."""
        if not self.cameras:
            return [above(self.support)]
        rng = np.random.default_rng((self.seed, world.seed))
        return [plan.draw(self.support, rng) for plan in self.cameras]

    def _look(self, world: EpisodeView, camera: Camera, number: int) -> list[View]:
        """The picture of that number from here; none where nothing was measured."""
        rgb, depth = world.picture(camera)
        moment = round(world.time * _MILLISECONDS)
        rng = np.random.default_rng((self.seed, world.seed, moment, number))
        if self.noise != NOISE_OFF:
            depth, camera = noisy(depth, camera, self.noise, rng)
        is_own = self._silhouette(camera, world.joints, world.opening)
        try:
            return [self.finder.look(rgb, depth, camera, is_own, world.names)]
        except ConfigError:
            return []
