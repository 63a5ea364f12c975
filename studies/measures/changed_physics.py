"""Which finished scenes stand under physics that differ from those in which they were made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.judging.scene_models import SceneModels, movement


@dataclass(frozen=True)
class PhysicsChange:
    """Physics that differ from those in which a scene was made.

    Attributes:
      name: for tables.
      friction: factor of all friction coefficients.
      mass: factor of every object's mass and inertia. All alike is a check of the engine rather than of the
        scene: weights and forces scale together.
      mixed_mass: factor by which every other object becomes heavier and the ones between lighter.
      timestep: factor of the time step; contacts stay as stiff as the longer step allows.
    """

    name: str
    friction: float = 1.0
    mass: float = 1.0
    mixed_mass: float = 1.0
    timestep: float = 1.0


PHYSICS_CHANGES = (
    PhysicsChange("unchanged"),
    PhysicsChange("friction x0.5", friction=0.5),
    PhysicsChange("friction x2", friction=2.0),
    PhysicsChange("mass x0.5", mass=0.5),
    PhysicsChange("mass x2", mass=2.0),
    PhysicsChange("mass x2 and x0.5 by turns", mixed_mass=2.0),
    PhysicsChange("time step x0.5", timestep=0.5),
    PhysicsChange("time step x2", timestep=2.0),
)


def change_physics(models: SceneModels, change: PhysicsChange) -> SceneModels:
    """The same objects under other physics."""
    stability = models.stability
    contact = models.contact
    sliding, torsional, rolling = (change.friction * each for each in contact.friction)
    alternate = np.where(
        np.arange(models.world.num_objects) % 2 == 0, change.mixed_mass, 1 / change.mixed_mass
    )
    return SceneModels(
        models.world,
        replace(stability, timestep=change.timestep * stability.timestep),
        replace(contact, friction=(sliding, torsional, rolling)),
        change.mass * alternate * models.mass_scale,
        models.detector,
    )


def survives(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    changes: Sequence[PhysicsChange] = PHYSICS_CHANGES,
    seconds: float = 10.0,
    num_threads: int = 0,
) -> dict[str, np.ndarray]:
    """Which scenes stand under changed physics (`physics.standing`).

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: how long each is simulated.

    Returns:
      bool[N] for each change's name; its mean is the share that survives.
    """
    found = {
        change.name: movement(
            change_physics(models, change), poses, is_placed, (seconds,), num_threads
        )
        for change in changes
    }
    return {name: each.survives()[:, 0] for name, each in found.items()}
