"""Distributions over actions in (0, 1)^A, independent in every coordinate (paper, section 3.2).

A head turns raw network outputs, f32[..., A, 2], a location and a log-precision, into a distribution.
Log-probabilities and entropies are exact and summed over coordinates; actions are kept off the edges, where
densities may vanish or diverge.
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


_LOG_PRECISION = (-3.0, 12.0)
"""Bounds of the second raw output: no narrower than about a thousandth of the interval."""


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
      alpha, beta: f32[..., A], 1 + m c and 1 + (1 - m) c, where m, the mode, is the sigmoid of the first raw
        output and c, the concentration, the exponential of the second. Raw zeros give 1.5 and 1.5.
    """

    alpha: Array
    beta: Array

    @staticmethod
    def from_raw(raw: Array) -> Beta:
        """The distribution of raw outputs f32[..., A, 2]."""
        mode, concentration = jax.nn.sigmoid(raw[..., 0]), jnp.exp(jnp.clip(raw[..., 1], *_LOG_PRECISION))
        return Beta(1 + mode * concentration, 1 + (1 - mode) * concentration)

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
      loc: f32[..., A], in (0, 1), the mode: the sigmoid of the first raw output.
      scale: f32[..., A]: half the exponential of minus half the second, so that a raw output means about the
        same width as it does for `Beta`. Raw zeros give 0.5 and 0.5.
    """

    loc: Array
    scale: Array

    @staticmethod
    def from_raw(raw: Array) -> TruncatedNormal:
        """The distribution of raw outputs f32[..., A, 2]."""
        return TruncatedNormal(
            jax.nn.sigmoid(raw[..., 0]), 0.5 * jnp.exp(-0.5 * jnp.clip(raw[..., 1], *_LOG_PRECISION))
        )

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


class Mixture(struct.PyTreeNode):
    """A mixture of Betas that can say "here or there".

    x and y together come from G x G components, each Beta(1, 1) by Beta(1, 1) on one cell of the unit square;
    z and turn from a Beta each. A = 4.

    Attributes:
      log_weight: f32[..., G * G], normalised; axis 0 of the cells is x.
      rest: of z and turn.
      side: G.
    """

    log_weight: Array
    rest: Beta
    side: int = struct.field(pytree_node=False)

    @staticmethod
    def from_scores(scores: Array, raw: Array) -> Mixture:
        """The distribution of the cells' scores f32[..., G, G] and raw outputs f32[..., 2, 2]."""
        flat = scores.reshape(*scores.shape[:-2], -1)
        return Mixture(jax.nn.log_softmax(flat), Beta.from_raw(raw), scores.shape[-1])

    def _at(self, cell: Array, inside: Array | float) -> Array:
        corner = jnp.stack([cell // self.side, cell % self.side], axis=-1)
        return (corner + inside) / self.side

    def sample(self, key: Array) -> Array:
        """One draw, f32[..., 4]."""
        key_cell, key_inside, key_rest = jax.random.split(key, 3)
        cell = jax.random.categorical(key_cell, self.log_weight)
        inside = off_edges(jax.random.uniform(key_inside, (*cell.shape, 2)))
        return off_edges(jnp.concatenate([self._at(cell, inside), self.rest.sample(key_rest)], axis=-1))

    def mean(self) -> Array:
        """f32[..., 4]: the middle of the likeliest cell, where a mean may lie between two."""
        cell = jnp.argmax(self.log_weight, axis=-1)
        return jnp.concatenate([self._at(cell, 0.5), self.rest.mean()], axis=-1)

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        i, j = (jnp.clip(action[..., a] * self.side, 0, self.side - 1).astype(jnp.int32) for a in (0, 1))
        weight = jnp.take_along_axis(self.log_weight, (i * self.side + j)[..., None], axis=-1)[..., 0]
        return weight + 2 * jnp.log(self.side) + self.rest.log_prob(action[..., 2:])

    def entropy(self) -> Array:
        """f32[...], differential entropy in nats."""
        cells = -jnp.sum(jnp.exp(self.log_weight) * self.log_weight, axis=-1)
        return cells - 2 * jnp.log(self.side) + self.rest.entropy()


class Categorical(struct.PyTreeNode):
    """A choice among M.

    Attributes:
      logits: f32[..., M], normalised.
    """

    logits: Array

    def sample(self, key: Array) -> Array:
        """One draw, i32[...]."""
        return jax.random.categorical(key, self.logits)

    def mean(self) -> Array:
        """i32[...]: the likeliest, the deterministic action."""
        return jnp.argmax(self.logits, axis=-1)

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        return jnp.take_along_axis(self.logits, action[..., None], axis=-1)[..., 0]

    def entropy(self) -> Array:
        """f32[...], nats."""
        return -jnp.sum(jnp.exp(self.logits) * self.logits, axis=-1)


HEADS: dict[str, type[Beta] | type[TruncatedNormal]] = {"beta": Beta, "normal": TruncatedNormal}
