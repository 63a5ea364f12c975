"""A trial's stored scenes as measures and pictures want them: by object, successes only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation.measures.arrangement import by_object
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.world import World


@dataclass(frozen=True, eq=False)
class Successes:
    """The scenes of a trial that stand. N scenes, K objects in the world.

    Attributes:
      world: the trial's; region: its queried region before any change.
      index: i64[N], which of the trial's scenes they are.
      poses: f64[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      arrays: everything that was stored (`row.arrays_of`), failures included.
    """

    world: World
    region: Rectangle
    index: np.ndarray
    poses: np.ndarray
    is_placed: np.ndarray
    arrays: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.index)


def successes_of(runner: Runner, trial: Trial) -> Successes:
    """The trial's successful scenes; it is run if need be.

    Raises:
      MissingCheckpointError: its policy has not been trained.
    """
    arrays, resolved = runner.arrays(trial), runner.resolve(trial)
    world = runner.world(resolved)
    poses, is_placed, _ = by_object(
        arrays["object_index"], arrays["is_placed"], arrays["poses"], world.num_objects
    )
    good = arrays["is_success"]
    return Successes(
        world=world,
        region=resolved.region,
        index=np.flatnonzero(good),
        poses=poses[good],
        is_placed=is_placed[good],
        arrays=arrays,
    )
