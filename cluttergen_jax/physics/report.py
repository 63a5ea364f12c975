"""What engines report before anything has happened, and the small sums that both need for a report."""

from __future__ import annotations

from typing import Any

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.geometry import rotate
from cluttergen_jax.types import Array, Settling, Standing, Verdict


def empty_settling(xp: Any, batch: tuple[int, ...], num_objects: int, config: StabilityConfig) -> Settling:
    """The report of scenes that were not judged: verdict NONE, everything else zero."""
    return Settling(
        verdict=xp.full(batch, int(Verdict.NONE), dtype=xp.int32),
        num_steps=xp.zeros(batch, dtype=xp.int32),
        check_steps=xp.zeros(batch, dtype=xp.int32),
        poses=xp.zeros((*batch, num_objects, 7), dtype=xp.float32),
        trajectory=xp.zeros((*batch, config.last_step + 1, 13), dtype=xp.float32),
        motion_sum=xp.zeros(batch, dtype=xp.float32),
        speed_sum=xp.zeros(batch, dtype=xp.float32),
        shift=xp.zeros((*batch, num_objects), dtype=xp.float32),
        turn=xp.zeros((*batch, num_objects), dtype=xp.float32),
        penetration=xp.zeros(batch, dtype=xp.float32),
        is_quiet=xp.zeros(batch, dtype=xp.bool),
        margin=xp.zeros((*batch, num_objects), dtype=xp.float32),
        touches=xp.zeros((*batch, num_objects), dtype=xp.bool),
        bears=xp.zeros((*batch, num_objects), dtype=xp.bool),
    )


def empty_standing(xp: Any, batch: tuple[int, ...], num_objects: int) -> Standing:
    """The report of scenes whose last check was not run: verdict NONE, everything else zero."""
    return Standing(
        verdict=xp.full(batch, int(Verdict.NONE), dtype=xp.int32),
        num_steps=xp.zeros(batch, dtype=xp.int32),
        shift=xp.zeros((*batch, num_objects), dtype=xp.float32),
        turn=xp.zeros((*batch, num_objects), dtype=xp.float32),
    )


def below_top(xp: Any, poses: Array, center_of_mass: Array, top: float) -> Array:
    """Whether each object's centre of mass is below the support's top.

    Args:
      poses: f[..., K, 7]; center_of_mass: f[K, 3], object frames, metres; top: metres.

    Returns:
      bool[..., K].
    """
    center = rotate(xp, poses[..., 3:], xp.broadcast_to(center_of_mass, (*poses.shape[:-1], 3)))
    return poses[..., 2] + center[..., 2] < top


def where(xp: Any, condition: Array, yes: Array, no: Array) -> Array:
    """`xp.where` scene by scene: a condition bool[N], arrays f[N, ...]."""
    return xp.where(condition.reshape(condition.shape + (1,) * (yes.ndim - 1)), yes, no)


def kept(xp: Any, array: Array, is_kept: Array) -> Array:
    """`array`, f[N, ...], with zeros for scenes that are not kept: a diverged scene reports no motion."""
    return where(xp, is_kept, array, xp.zeros_like(array))
