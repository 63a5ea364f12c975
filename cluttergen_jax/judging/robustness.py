"""How firmly a finished scene stands: over time, shaken, with gravity tilted, and under changed physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.judging.scene_models import SceneModels, StandingModel, each_scene, movement
from cluttergen_jax.physics.simulations import SOFT_SOLIMP, SOFT_SOLREF
from cluttergen_jax.physics.standing import STRIDE, has_moved, stepper, watch

_SHAKEN_STRIDE = 4
"""Steps between two looks at what is shaken, and between two accelerations."""


@dataclass(frozen=True)
class ShakeConfig:
    """A sideways acceleration of the support that grows slowly from zero.

    Attributes:
      rate: m/s^2 per second. What is let go by static friction takes a while for `max_shift`, during which
        the acceleration goes on growing: by (6 * max_shift * rate^2)^(1/3), 0.31 m/s^2 at rate 1.
      limit: m/s^2; a scene that nothing moved by then has this score.
      max_shift: metres that an object must move, relative to the support.
      directions: world directions in which the support is accelerated, a score for each.
    """

    rate: float = 1.0
    limit: float = 10.0
    max_shift: float = StabilityConfig.stand_full_shift
    directions: tuple[tuple[float, float], ...] = ((1.0, 0.0), (0.0, 1.0))

    def __post_init__(self) -> None:
        if not (self.rate > 0 and self.limit > 0 and self.max_shift > 0 and self.directions):
            raise ConfigError(
                f"{self}", "rate, limit and max_shift above zero, one direction or more"
            )


def shake(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: ShakeConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The sideways acceleration at which something has moved `max_shift` relative to the support.

    Simulated in the support's own frame, where an acceleration a of the support is a gravity of -a: the table
    stands still and gravity tilts.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      f64[N, D], m/s^2, for D directions; the limit where nothing moved.
    """
    models.check(poses, is_placed)
    config = config or ShakeConfig()
    is_placed = np.asarray(is_placed, bool)

    def run(scene: int) -> list[float]:
        model = models.of(is_placed[scene])
        return [_withstood(model, poses[scene], np.array(way), config) for way in config.directions]

    scores = each_scene(run, len(is_placed), num_threads)
    return np.array(scores, np.float64).reshape(len(is_placed), len(config.directions))


def _withstood(
    scene: StandingModel, poses: np.ndarray, direction: np.ndarray, config: ShakeConfig
) -> float:
    """m/s^2 at which one scene gives way."""
    # Gravity belongs to the model, which other threads use at the same time.
    model = scene.own_model()
    data = scene.start(poses, model)
    step = stepper(model, data)
    direction = direction / np.linalg.norm(direction)
    growth = config.rate * _SHAKEN_STRIDE * model.opt.timestep
    accelerations = growth * np.arange(1, np.ceil(config.limit / growth) + 1)
    grows = iter(accelerations)

    def advance(count: int) -> np.ndarray:
        model.opt.gravity[:2] = -next(grows) * direction
        return step(count)

    marks = _SHAKEN_STRIDE * np.arange(1, len(accelerations) + 1)
    looks = watch(advance, data.qpos.reshape(-1, 7), marks.tolist(), _SHAKEN_STRIDE)
    for acceleration, (shift, _) in zip(accelerations, looks, strict=True):
        if shift.max(initial=0.0) > config.max_shift:
            return min(float(acceleration), config.limit)
    return config.limit


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


@dataclass(frozen=True)
class TiltConfig:
    """Gravity out of the vertical, at once and for good.

    Friction holds up to 26 degrees, so that what moves by so little tips.

    Attributes:
      degrees: by how much, ascending.
      num_directions: evenly over the circle, the first one world x.
      seconds: how long each is simulated.
    """

    degrees: tuple[float, ...] = (1.0, 2.0, 5.0)
    num_directions: int = 8
    seconds: float = 2.0

    def __post_init__(self) -> None:
        ascends = all(
            a < b for a, b in zip((0.0, *self.degrees), (*self.degrees, 90.0), strict=True)
        )
        if not (ascends and self.num_directions > 0 and self.seconds > 0):
            allowed = (
                "degrees that ascend between 0 and 90, one direction or more, seconds above zero"
            )
            raise ConfigError(f"{self}", allowed)


def tilt(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: TiltConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The share of directions in which a scene stands though gravity is tilted.

    What stands at one angle is taken to stand at every smaller one in the same direction.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      f64[N, A], one share for each of the angles.
    """
    models.check(poses, is_placed)
    config = config or TiltConfig()
    is_placed = np.asarray(is_placed, bool)
    turns = 2 * np.pi * np.arange(config.num_directions) / config.num_directions

    def run(scene: int) -> np.ndarray:
        model = models.of(is_placed[scene])
        return np.mean([_stands(model, poses[scene], turn, config) for turn in turns], axis=0)

    shares = each_scene(run, len(is_placed), num_threads)
    return np.array(shares, np.float64).reshape(len(is_placed), len(config.degrees))


def _stands(scene: StandingModel, poses: np.ndarray, turn: float, config: TiltConfig) -> np.ndarray:
    """bool[A]: at which angles one scene stands, gravity tilted towards one direction."""
    result = np.ones(len(config.degrees), bool)
    for place in reversed(range(len(config.degrees))):
        angle = np.radians(config.degrees[place])
        sideways = np.sin(angle) * np.array([np.cos(turn), np.sin(turn)])
        # Gravity belongs to the model, which other threads use at the same time.
        down = np.append(sideways, -np.cos(angle))
        if _stays(scene, scene.own_model(), poses, down, config.seconds, 3):
            break
        result[place] = False
    return result


def _stays(
    scene: StandingModel,
    model: mujoco.MjModel,
    poses: np.ndarray,
    down: np.ndarray,
    seconds: float,
    num_axes: int,
) -> bool:
    """Whether nothing moves too far, along the first so many world axes, or turns too much.

    Args:
      model: the scene's own; its gravity is turned towards `down`, a unit vector.
    """
    model.opt.gravity[:] = down * np.linalg.norm(model.opt.gravity)
    data = scene.start(poses, model)
    step = stepper(model, data)
    start = data.qpos.reshape(-1, 7).copy()

    def advance(count: int) -> np.ndarray:
        now = step(count).copy()
        now[:, num_axes:3] = start[:, num_axes:3]
        return now

    num_looks = round(seconds / model.opt.timestep / STRIDE)
    limits = StabilityConfig()
    looks = watch(advance, start, range(STRIDE, STRIDE * num_looks + 1, STRIDE))
    return not any(has_moved(shift, turn, limits).any() for shift, turn in looks)


@dataclass(frozen=True)
class RobustConfig:
    """What a robust scene withstands: tilted gravity, less friction and softer contact, all at once.

    Attributes:
      degrees: by how much gravity is tilted.
      num_directions: evenly over the circle, the first one world x.
      friction: factor of all friction coefficients.
      solref, solimp: of all contacts; by default MuJoCo's own defaults.
      seconds: how long each direction is simulated.
    """

    degrees: float = 3.0
    num_directions: int = 4
    friction: float = 0.7
    solref: tuple[float, float] = SOFT_SOLREF
    solimp: tuple[float, float, float, float, float] = SOFT_SOLIMP
    seconds: float = 2.0


def robust(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: RobustConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """Which scenes stand, everything awake, under tilted gravity with less friction and softer contact.

    A scene is robust if nothing moves too far in plan or turns too much (`physics.standing`), from where it
    was saved, in any direction. In plan, since in soft contact everything sinks by a little, which is no
    fall: what falls also turns or goes sideways.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      bool[N].
    """
    models.check(poses, is_placed)
    config = config or RobustConfig()
    is_placed = np.asarray(is_placed, bool)
    turns = 2 * np.pi * np.arange(config.num_directions) / config.num_directions
    angle = np.radians(config.degrees)

    def run(number: int) -> bool:
        scene = models.of(is_placed[number])
        model = scene.own_model()
        model.geom_friction[:] *= config.friction
        model.geom_solref[:] = config.solref
        model.geom_solimp[:] = config.solimp
        sideways = np.sin(angle) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        return all(
            _stays(scene, model, poses[number], np.append(to, -np.cos(angle)), config.seconds, 2)
            for to in sideways
        )

    return np.array(each_scene(run, len(is_placed), num_threads), bool)
