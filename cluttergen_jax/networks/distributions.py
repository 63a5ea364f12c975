"""Distributions over actions in (0, 1)^A, independent in every coordinate (paper, section 3.2).

A head turns raw network outputs, f32[..., A, 2], into a distribution. Log-probabilities and entropies are
exact and summed over coordinates; actions are kept off the edges, where densities may vanish or diverge.
"""

from __future__ import annotations

from typing import Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jax.scipy.special import betaln, digamma, log_ndtr
from jax.scipy.stats import norm

from cluttergen_jax.types import Array

EDGE = 1e-5
"""How far an action stays from 0 and 1."""


class ActionDistribution(Protocol):
    """What the learner asks of a distribution; leading axes are the batch's, the last one is A."""

    def sample(self, key: Array) -> Array: ...

    def mean(self) -> Array: ...

    def log_prob(self, action: Array) -> Array: ...

    def entropy(self) -> Array: ...


def off_edges(action: Array) -> Array:
    """The action, at least EDGE away from 0 and 1."""
    return jnp.clip(action, EDGE, 1 - EDGE)


class Beta(struct.PyTreeNode):
    """Beta(alpha, beta) with alpha, beta > 1: one mode inside the interval, density zero at its edges.

    Attributes:
      alpha, beta: f32[..., A], 1 + softplus of the raw outputs. Raw zeros give alpha = beta = 1.69, nearly
        uniform, where learning begins.
    """

    alpha: Array
    beta: Array

    @staticmethod
    def from_raw(raw: Array) -> Beta:
        """The distribution of raw outputs f32[..., A, 2]."""
        positive = 1 + jax.nn.softplus(raw)
        return Beta(positive[..., 0], positive[..., 1])

    def sample(self, key: Array) -> Array:
        """One draw, f32[..., A]."""
        return off_edges(jax.random.beta(key, self.alpha, self.beta))

    def mean(self) -> Array:
        """f32[..., A]."""
        return self.alpha / (self.alpha + self.beta)

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        action = off_edges(action)
        density = (self.alpha - 1) * jnp.log(action) + (self.beta - 1) * jnp.log1p(-action)
        return jnp.sum(density - betaln(self.alpha, self.beta), axis=-1)

    def entropy(self) -> Array:
        """f32[...], differential entropy in nats."""
        total = self.alpha + self.beta
        entropy = (
            betaln(self.alpha, self.beta)
            - (self.alpha - 1) * digamma(self.alpha)
            - (self.beta - 1) * digamma(self.beta)
            + (total - 2) * digamma(total)
        )
        return jnp.sum(entropy, axis=-1)


class TruncatedNormal(struct.PyTreeNode):
    """A normal distribution cut off at 0 and 1.

    Attributes:
      loc: f32[..., A], in (0, 1): the mode.
      scale: f32[..., A], at least 0.02.
    """

    loc: Array
    scale: Array

    @staticmethod
    def from_raw(raw: Array) -> TruncatedNormal:
        """The distribution of raw outputs f32[..., A, 2]; raw zeros give loc 0.5 and scale 0.52."""
        return TruncatedNormal(jax.nn.sigmoid(raw[..., 0]), 0.02 + 0.72 * jax.nn.softplus(raw[..., 1]))

    def _limits(self) -> tuple[Array, Array]:
        return -self.loc / self.scale, (1 - self.loc) / self.scale

    def _log_mass(self) -> Array:
        """log of the untruncated mass inside [0, 1], without cancellation: loc lies inside."""
        lower, upper = self._limits()
        return jnp.log1p(-jnp.exp(log_ndtr(lower)) - jnp.exp(log_ndtr(-upper)))

    def sample(self, key: Array) -> Array:
        """One draw, f32[..., A]."""
        lower, upper = self._limits()
        return off_edges(self.loc + self.scale * jax.random.truncated_normal(key, lower, upper))

    def mean(self) -> Array:
        """f32[..., A]."""
        lower, upper = self._limits()
        return self.loc + self.scale * (norm.pdf(lower) - norm.pdf(upper)) / jnp.exp(self._log_mass())

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        standard = (off_edges(action) - self.loc) / self.scale
        return jnp.sum(norm.logpdf(standard) - jnp.log(self.scale) - self._log_mass(), axis=-1)

    def entropy(self) -> Array:
        """f32[...], differential entropy in nats."""
        lower, upper = self._limits()
        log_mass = self._log_mass()
        pull = (lower * norm.pdf(lower) - upper * norm.pdf(upper)) / (2 * jnp.exp(log_mass))
        return jnp.sum(0.5 * jnp.log(2 * jnp.pi * jnp.e) + jnp.log(self.scale) + log_mass + pull, axis=-1)


HEADS: dict[str, type[Beta] | type[TruncatedNormal]] = {"beta": Beta, "normal": TruncatedNormal}
