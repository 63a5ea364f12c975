"""What stays put: the rule for finished scenes, and the one loop that watches whether they keep it.

How far an object may ever be from where it began stands in `StabilityConfig` (`stand_full_shift` and
`stand_full_turn`, docs/contract.md). Engines judge by `stability.verdict_of_scene`; whoever simulates a
finished scene in plain MuJoCo, or in another simulator, does so by `watch`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.config import Detector, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import Array, norm, turn_between

STRIDE = 12
"""Steps between two looks at a scene of ours."""

Advance = Callable[[int], np.ndarray]
"""Makes so many steps and returns the poses f64[n, 7] after them."""


def displacement(xp: Any, poses: Array, start: Array) -> tuple[Array, Array]:
    """How far and how much every object is from where it was: shift and turn, f[..., K] each."""
    shift = norm(xp, poses[..., :3] - start[..., :3])
    return shift, turn_between(xp, poses[..., 3:], start[..., 3:])


def has_moved(shift: Array, turn: Array, limits: StabilityConfig) -> Array:
    """Whether each object of a finished scene was farther from its start than it may be, bool[...].

    Args:
      shift, turn: f[...], metres and radians, the farthest.
    """
    return (shift > limits.stand_full_shift) | (turn > limits.stand_full_turn)


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


def shift_and_turn(poses: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[n] each: metres and radians between poses f64[n, 7]; infinite for what is not finite any more."""
    shift, turn = displacement(np, poses, start)
    is_finite = np.isfinite(poses).all(1)
    return np.where(is_finite, shift, np.inf), np.where(is_finite, turn, np.inf)


def watch(
    advance: Advance, start: np.ndarray, marks: Sequence[int], every: int = STRIDE
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The farthest that objects were from their start up to each mark, and the most they had turned.

    A simulation goes on only as far as results are asked for.

    Args:
      start: f64[n, 7], where they begin.
      marks: steps, ascending; every: steps between two looks, fewer before a mark.

    Yields:
      f64[n] metres and f64[n] radians, infinite for what diverged.
    """
    start = start.copy()
    farthest = np.zeros((2, len(start)))
    done = 0
    for mark in marks:
        while done < mark:
            count = min(every, mark - done)
            done += count
            farthest = np.maximum(farthest, shift_and_turn(advance(count), start))
        yield farthest[0], farthest[1]


def disabled_flags(model: mujoco.MjModel, detector: Detector) -> int:
    """A model's flags with which convex collisions are found by this detector."""
    flag = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    return model.opt.disableflags | flag if detector == "libccd" else model.opt.disableflags & ~flag


def keep_awake(model: mujoco.MjModel, detector: Detector) -> None:
    """Changes a model: nothing sleeps, convex collisions are found by this detector."""
    model.opt.disableflags = disabled_flags(model, detector)
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    # A diverging scene must be seen, not put back to where it started.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def stepper(model: mujoco.MjModel, data: mujoco.MjData) -> Advance:
    """Steps a model whose only joints are free ones."""

    def advance(count: int) -> np.ndarray:
        mujoco.mj_step(model, data, count)
        return data.qpos.reshape(-1, 7)

    return advance


@dataclass(frozen=True, eq=False, kw_only=True)
class StandingCheck:
    """Whether the objects of a finished scene stayed put.

    Attributes:
      objects: names of its free bodies.
      shift: f64[N], the farthest each was from its start, metres; infinite for what diverged.
      turn: f64[N], the most each had turned, radians.
      stands: all of them stayed within the limits.
      detector: of convex collisions, the one with which it was simulated.
    """

    objects: tuple[str, ...] = ()
    shift: np.ndarray
    turn: np.ndarray
    stands: bool
    detector: Detector = "native"

    @property
    def worst(self) -> str:
        """The object that moved the most."""
        return self.objects[int(np.argmax(self.shift))]


def check_standing(
    model: mujoco.MjModel,
    key: int,
    seconds: float,
    limits: StabilityConfig,
    detector: Detector = "native",
) -> StandingCheck:
    """Simulates a scene of free bodies from a keyframe, at rest, everything awake.

    Args:
      model: changed (`keep_awake`); key: the number of the keyframe.
    """
    keep_awake(model, detector)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    data.qvel[:] = 0
    last = round(seconds / model.opt.timestep)
    shift, turn = next(watch(stepper(model, data), data.qpos.reshape(-1, 7), (last,)))
    return StandingCheck(
        objects=tuple(model.body(int(body)).name for body in model.jnt_bodyid),
        shift=shift,
        turn=turn,
        stands=not has_moved(shift, turn, limits).any(),
        detector=detector,
    )
