"""The observer that looks: pictures of the camera over the table and of the one on the hand, with noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.downstream.perception.finder import FoundScene, SceneFinder
from cluttergen_jax.downstream.perception.pose.estimator import Look
from cluttergen_jax.downstream.perception.views.cameras import above, wrist_camera
from cluttergen_jax.downstream.rearrange.observe import EpisodeView, SceneEstimate
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE, NoiseConfig, noisy

UNSURE = 0.5
"""Certainty below which another look is taken."""
MOST_LOOKS = 2
_MILLISECONDS = 1000


class PerceptionObserver:
    """Tells where objects are by what cameras see alone; an `observe.Observer`.

    Pictures of one moment are fused: each object's pose is that which agrees best with all of them. Where
    of several is not sure, all cameras take a second picture, with noise of its own.

    Args:
      finder: of the objects. support: the table.
      noise: of the depth cameras. seed: of the noise.

    Attributes:
      num_pictures: taken so far.
    """

    name = "perception"

    def __init__(
        self, finder: SceneFinder, support: SupportAsset, noise: NoiseConfig = REALSENSE, seed: int = 0
    ) -> None:
        self._finder, self._support, self._noise, self._seed = finder, support, noise, seed
        self.num_pictures = 0

    def __call__(self, world: EpisodeView, names: Sequence[str]) -> SceneEstimate:
        """See `observe.Observer`."""
        looks: list[Look] = []
        found: FoundScene | None = None
        # One alone may be in the hand, where another look seldom shows more.
        for number in range(MOST_LOOKS if len(names) > 1 else 1):
            looks += self._look(world, number)
            if looks:
                found = self._finder(looks, names)
                if (found.certainty >= UNSURE).all():
                    break
        if found is None:
            nothing = np.zeros(len(names))
            return SceneEstimate(tuple(names), np.zeros((len(names), 7)), nothing.astype(bool), nothing)
        return SceneEstimate(found.names, found.pose, found.seen, found.certainty)

    def _look(self, world: EpisodeView, number: int) -> list[Look]:
        """One picture of each camera; those that measured nothing are left out."""
        looks = []
        for place, camera in enumerate((above(self._support), wrist_camera(world.tool))):
            rgb, depth = world.picture(camera)
            self.num_pictures += 1
            moment = round(world.time * _MILLISECONDS)
            rng = np.random.default_rng((self._seed, moment, number, place))
            if self._noise != NOISE_OFF:
                depth, camera = noisy(depth, camera, self._noise, rng)
            try:
                looks.append(self._finder.look(rgb, depth, camera))
            except ConfigError:
                continue
        return looks
