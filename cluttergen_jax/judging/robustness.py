"""How firmly a finished scene stands: shaken, with gravity tilted, and with less friction in soft contact."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.judging.scene_models import SceneModels, StandingModel
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
    asked = config or ShakeConfig()

    def run(_: int, model: StandingModel, at: np.ndarray) -> list[float]:
        return [_withstood(model, at, np.array(way), asked) for way in asked.directions]

    scores = models.each(run, poses, is_placed, num_threads)
    return np.array(scores, np.float64).reshape(len(is_placed), len(asked.directions))


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
    asked = config or TiltConfig()
    turns = 2 * np.pi * np.arange(asked.num_directions) / asked.num_directions

    def run(_: int, model: StandingModel, at: np.ndarray) -> np.ndarray:
        return np.mean([_stands(model, at, turn, asked) for turn in turns], axis=0)

    shares = models.each(run, poses, is_placed, num_threads)
    return np.array(shares, np.float64).reshape(len(is_placed), len(asked.degrees))


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
    asked = config or RobustConfig()
    turns = 2 * np.pi * np.arange(asked.num_directions) / asked.num_directions
    angle = np.radians(asked.degrees)
    sideways = np.sin(angle) * np.stack([np.cos(turns), np.sin(turns)], axis=1)

    def run(_: int, scene: StandingModel, at: np.ndarray) -> bool:
        model = scene.own_model()
        model.geom_friction[:] *= asked.friction
        model.geom_solref[:] = asked.solref
        model.geom_solimp[:] = asked.solimp
        return all(
            _stays(scene, model, at, np.append(to, -np.cos(angle)), asked.seconds, 2)
            for to in sideways
        )

    return np.array(models.each(run, poses, is_placed, num_threads), bool)
