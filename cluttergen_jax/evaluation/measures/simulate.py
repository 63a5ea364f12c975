"""Scenes simulated one by one in plain MuJoCo, everything awake, several at a time on threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import mujoco
import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.judging.scene_models import SceneModels
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.stability import displacement

MAX_SHIFT = 0.005
MAX_TURN = float(np.radians(5.0))
_STRIDE_SECONDS = 0.05

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Movement:
    """How far objects were from where they began, at most. N scenes, H horizons, K objects.

    Attributes:
      seconds: f64[H], ascending.
      shift: f64[N, H, K], metres, up to each horizon; zero where not placed, infinite where it diverged.
      turn: f64[N, H, K], radians.
    """

    seconds: np.ndarray
    shift: np.ndarray
    turn: np.ndarray

    @property
    def largest_shift(self) -> np.ndarray:
        """f64[N, H]: metres, of the object that moved the most."""
        return self.shift.max(-1, initial=0.0)

    @property
    def largest_turn(self) -> np.ndarray:
        """f64[N, H]: radians, of the object that turned the most."""
        return self.turn.max(-1, initial=0.0)

    def survives(self, max_shift: float = MAX_SHIFT, max_turn: float = MAX_TURN) -> np.ndarray:
        """bool[N, H]: nothing went farther than metres and radians allow (docs/contract.md: 5 mm, 5 deg)."""
        return (self.largest_shift <= max_shift) & (self.largest_turn <= max_turn)


def each_scene(
    function: Callable[[int], Result], num_scenes: int, num_threads: int = 0
) -> list[Result]:
    """`function` of 0 to num_scenes - 1, on threads (0: one for each core); MuJoCo's log is silent."""
    threads = num_threads or os.cpu_count() or 1
    with silent_log():
        if threads == 1:
            return [function(scene) for scene in range(num_scenes)]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(function, range(num_scenes)))


def horizons_of(seconds: Sequence[float]) -> np.ndarray:
    """Horizons in seconds as f64[H].

    Raises:
      ConfigError: they are not finite, or do not ascend from above zero.
    """
    horizons = np.asarray(seconds, np.float64)
    is_good = horizons.ndim == 1 and len(horizons) > 0 and bool(np.isfinite(horizons).all())
    if not (is_good and (np.diff(horizons, prepend=0.0) > 0).all()):
        raise ConfigError(
            f"horizons of {seconds} s", "finite, ascending times above zero", "(1.0, 10.0, 60.0)"
        )
    return horizons


def no_movement(is_placed: np.ndarray, seconds: Sequence[float]) -> Movement:
    """A movement of zeros, for bool[N, K] and horizons in seconds; see `horizons_of`."""
    horizons = horizons_of(seconds)
    shape = (len(is_placed), len(horizons), is_placed.shape[1])
    return Movement(horizons, np.zeros(shape), np.zeros(shape))


def movement(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    seconds: Sequence[float],
    num_threads: int = 0,
) -> Movement:
    """Simulates scenes from rest and reports the farthest that each object was from its start.

    Objects are looked at every 0.05 s and at each horizon.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: horizons, ascending.

    Raises:
      ConfigError: the arrays are not scenes of the world, or `horizons_of` refuses the horizons.
    """
    models.check(poses, is_placed)
    poses = np.asarray(poses, np.float64)
    is_placed = np.asarray(is_placed, bool)
    result = no_movement(is_placed, seconds)
    horizons = result.seconds

    def run(scene: int) -> None:
        model = models.of(is_placed[scene])
        data = model.start(poses[scene])

        def step(count: int) -> np.ndarray:
            mujoco.mj_step(model.model, data, count)
            return data.qpos.reshape(-1, 7)

        shift, turn = watch(step, data.qpos.reshape(-1, 7), horizons, models.stability.timestep)
        result.shift[scene][:, model.objects] = shift
        result.turn[scene][:, model.objects] = turn

    each_scene(run, len(poses), num_threads)
    return result


def watch(
    step: Callable[[int], np.ndarray],
    start: np.ndarray,
    horizons: np.ndarray,
    timestep: float,
    most_sinking: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """The farthest that objects were from their start up to each horizon, and the most they had turned.

    Args:
      step: makes so many steps and returns the poses f64[n, 7] after them.
      start: f64[n, 7]; horizons: f64[H], ascending, and timestep, seconds.
      most_sinking: metres by which all objects may sink together without that being counted.

    Returns:
      f64[H, n] metres and f64[H, n] radians.
    """
    start = start.copy()
    shift, turn = np.zeros((2, len(horizons), len(start)))
    far = np.zeros(len(start))
    most = np.zeros(len(start))
    done = 0
    stride = max(round(_STRIDE_SECONDS / timestep), 1)
    for place, until in enumerate(np.rint(horizons / timestep).astype(int).tolist()):
        while done < until:
            count = min(stride, until - done)
            done += count
            now = shift_and_turn(without_sinking(step(count), start, most_sinking), start)
            far = np.maximum(far, now[0])
            most = np.maximum(most, now[1])
        shift[place] = far
        turn[place] = most
    return shift, turn


def without_sinking(poses: np.ndarray, start: np.ndarray, most: float) -> np.ndarray:
    """The poses f64[n, 7], lifted by what most objects have sunk since f64[n, 7], `most` metres at most.

    Engines with soft contacts let every layer of a heap sink by as much, which is no fall.
    """
    sinking = np.median(poses[:, 2] - start[:, 2]) if most and len(poses) else 0.0
    if not np.isfinite(sinking):
        return poses
    lifted = poses.copy()
    lifted[:, 2] += min(max(-sinking, 0.0), most)
    return lifted


def shift_and_turn(poses: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[n] each: metres and radians between poses f64[n, 7]; infinite for what is not finite any more."""
    shift, turn = displacement(np, poses, start)
    is_finite = np.isfinite(poses).all(1)
    return np.where(is_finite, shift, np.inf), np.where(is_finite, turn, np.inf)
