"""Exponential tilting: the weights nearest to given ones whose means are as asked (maximum entropy)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from cluttergen_jax.types import Array

_STEPS = 12
_RIDGE = 1e-3
_STEEPEST = 12.0
_DAMPING = (1.0, 0.5, 0.25, 0.06)


def tilt_logits(logits: Array, values: Array, asked: Array, is_allowed: Array) -> Array:
    """f32[N]: logits of weights w of those allowed, nearest to softmax(logits), with w . values = asked.

    w is proportional to exp(logits + values . lambda), lambda the minimum of the convex
    logsumexp(logits + values . lambda) - asked . lambda + 0.0005 |lambda|^2 by damped Newton steps, values in
    units of their standard deviation. What is out of reach is met as nearly as |lambda| <= 12 can.

    Args:
      logits: f32[N], of the weights to stay near to; 0 for equal ones.
      values: f32[N, F]; asked: f32[F].
      is_allowed: bool[N]; if none is, the logits come back as they are.
    """
    any_allowed = jnp.any(is_allowed)
    counts = is_allowed | ~any_allowed
    base = jnp.where(counts, logits, -jnp.inf)
    number = counts.sum()
    mean = jnp.sum(jnp.where(counts[:, None], values, 0.0), axis=0) / number
    offset = jnp.where(counts[:, None], values - mean, 0.0)
    scale = jnp.sqrt(jnp.sum(offset**2, axis=0) / number)
    unit = jnp.where(scale > 1e-6, scale, 1.0)
    # A feature in which all are alike decides nothing, whatever is asked.
    features = jnp.where(scale > 1e-6, offset / unit, 0.0)
    target = jnp.where(scale > 1e-6, (asked - mean) / unit, 0.0)
    target = jnp.clip(target, features.min(0), features.max(0))

    def objective(slope: Array) -> Array:
        fit = jax.nn.logsumexp(base + features @ slope) - target @ slope
        return fit + _RIDGE / 2 * slope @ slope

    def step(_: int, slope: Array) -> Array:
        weight = jax.nn.softmax(base + features @ slope)
        expected = weight @ features
        gradient = expected - target + _RIDGE * slope
        spread = features - expected
        curvature = (spread * weight[:, None]).T @ spread + _RIDGE * jnp.eye(len(slope))
        newton = jnp.linalg.solve(curvature, gradient)
        tries = jnp.clip(
            slope - jnp.array([*_DAMPING, 0.0])[:, None] * newton, -_STEEPEST, _STEEPEST
        )
        return tries[jnp.argmin(jax.vmap(objective)(tries))]

    slope = jax.lax.fori_loop(0, _STEPS, step, jnp.zeros(values.shape[1]))
    return jnp.where(any_allowed, logits + features @ slope, logits)


def shortfall(asked: Array, values: Array, is_allowed: Array) -> Array:
    """f32[F]: how far each of f32[F] is from the range of f32[N, F] among those allowed; inf if none is."""
    low = jnp.min(jnp.where(is_allowed[:, None], values, jnp.inf), axis=0)
    high = jnp.max(jnp.where(is_allowed[:, None], values, -jnp.inf), axis=0)
    return jnp.maximum(jnp.maximum(low - asked, asked - high), 0.0)
