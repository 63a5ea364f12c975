"""The few rotation formulas that the stability rule needs on both NumPy and JAX arrays.

Pose algebra elsewhere is jaxlie's; it has no NumPy face, and host callbacks may not call JAX.
"""

from __future__ import annotations

from typing import Any

from cluttergen_jax.types import Array


def norm(xp: Any, vector: Array) -> Array:
    """Euclidean length over the last axis."""
    return xp.sqrt(xp.sum(vector * vector, axis=-1))


def cross(xp: Any, a: Array, b: Array) -> Array:
    """Cross product of f[..., 3] with f[..., 3]."""
    return xp.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def rotate(xp: Any, quaternion: Array, vector: Array) -> Array:
    """`vector`, f[..., 3], turned by the unit `quaternion`, f[..., 4] wxyz."""
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    twice = 2 * cross(xp, xyz, vector)
    return vector + w * twice + cross(xp, xyz, twice)


def turn_between(xp: Any, quaternion: Array, reference: Array) -> Array:
    """The angle in [0, pi] between two orientations, f[..., 4] wxyz each, exact for small angles."""
    w, xyz = quaternion[..., :1], quaternion[..., 1:]
    w0, xyz0 = reference[..., :1], -reference[..., 1:]
    vector = w * xyz0 + w0 * xyz + cross(xp, xyz, xyz0)
    scalar = w[..., 0] * w0[..., 0] - xp.sum(xyz * xyz0, axis=-1)
    return 2 * xp.atan2(norm(xp, vector), xp.abs(scalar))
