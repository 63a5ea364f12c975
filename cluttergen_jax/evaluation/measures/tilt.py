"""What tilted gravity topples: how near a finished scene is to tipping over by itself."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.measures.scene_models import SceneModel, SceneModels
from cluttergen_jax.evaluation.measures.simulate import MAX_SHIFT, MAX_TURN, each_scene, shift_and_turn

_LOOK_EVERY = 12


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
        ascends = all(a < b for a, b in zip((0.0, *self.degrees), (*self.degrees, 90.0), strict=True))
        if not (ascends and self.num_directions > 0 and self.seconds > 0):
            allowed = "degrees that ascend between 0 and 90, one direction or more, seconds above zero"
            raise ConfigError(f"{self}", allowed)


def tilt(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    config: TiltConfig | None = None,
    num_threads: int = 0,
) -> np.ndarray:
    """The share of directions in which a scene stands though gravity is tilted.

    It stands if nothing moves over 5 mm or turns over 5 degrees. What stands at one angle is taken to
    stand at every smaller one in the same direction.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].

    Returns:
      f64[N, A], one share for each of the angles.
    """
    models.check(poses, is_placed)
    config, is_placed = config or TiltConfig(), np.asarray(is_placed, bool)
    turns = 2 * np.pi * np.arange(config.num_directions) / config.num_directions

    def run(scene: int) -> np.ndarray:
        model = models.of(is_placed[scene])
        return np.mean([_stands(model, poses[scene], turn, config) for turn in turns], axis=0)

    shares = each_scene(run, len(is_placed), num_threads)
    return np.array(shares, np.float64).reshape(len(is_placed), len(config.degrees))


def _stands(scene: SceneModel, poses: np.ndarray, turn: float, config: TiltConfig) -> np.ndarray:
    """bool[A]: at which angles one scene stands, gravity tilted towards one direction."""
    result = np.ones(len(config.degrees), bool)
    for place in reversed(range(len(config.degrees))):
        angle = np.radians(config.degrees[place])
        sideways = np.sin(angle) * np.array([np.cos(turn), np.sin(turn)])
        if _withstands(scene, poses, np.append(sideways, -np.cos(angle)), config.seconds):
            break
        result[place] = False
    return result


def _withstands(scene: SceneModel, poses: np.ndarray, down: np.ndarray, seconds: float) -> bool:
    # Gravity belongs to the model, which other threads use at the same time.
    model = scene.own_model()
    model.opt.gravity[:] = down * np.linalg.norm(model.opt.gravity)
    data = scene.start(poses, model)
    start = data.qpos.reshape(-1, 7).copy()
    for _ in range(round(seconds / model.opt.timestep / _LOOK_EVERY)):
        mujoco.mj_step(model, data, _LOOK_EVERY)
        shift, turned = shift_and_turn(data.qpos.reshape(-1, 7), start)
        if shift.max(initial=0.0) > MAX_SHIFT or turned.max(initial=0.0) > MAX_TURN:
            return False
    return True
