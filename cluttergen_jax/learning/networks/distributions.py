"""Distributions over actions in (0, 1)^A, independent in every coordinate (paper, section 3.2).

A head turns raw network outputs, f32[..., A, 2], a location and a log-precision, into a distribution.
Log-probabilities and entropies are exact and summed over coordinates; actions are kept off the edges, where
densities may vanish or diverge.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import jax
import jax.numpy as jnp
from flax import struct
from jax.scipy.special import betaln, digamma, log_ndtr
from jax.scipy.stats import norm

from cluttergen_jax.types import Array

EDGE = 1e-5
"""How far an action stays from 0 and 1."""


_LOG_SHAPE = (-1.2, 10.0)
"""Bounds of the logarithms of alpha and beta where these are free: a U of which a fiftieth lies within EDGE
of each end, and modes as narrow as a four-hundredth of the interval."""
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
    """Beta(alpha, beta).

    Attributes:
      alpha, beta: f32[..., A].
    """

    alpha: Array
    beta: Array

    @staticmethod
    def from_raw(raw: Array) -> Beta:
        """With one mode inside the interval and density zero at its edges, of raw outputs f32[..., A, 2].

        alpha and beta are 1 + m c and 1 + (1 - m) c, where m, the mode, is the sigmoid of the first raw
        output and c, the concentration, the exponential of the second. Raw zeros give 1.5 and 1.5.
        """
        mode = jax.nn.sigmoid(raw[..., 0])
        concentration = jnp.exp(jnp.clip(raw[..., 1], *_LOG_PRECISION))
        return Beta(1 + mode * concentration, 1 + (1 - mode) * concentration)

    @staticmethod
    def free(raw: Array) -> Beta:
        """Of any shape, of raw outputs f32[..., A, 2]: the exponentials of the two (the paper's code).

        Below 1 the density grows without bound towards an edge; both below 1 make a U. Raw zeros are uniform.
        """
        shape = jnp.exp(jnp.clip(raw, *_LOG_SHAPE))
        return Beta(shape[..., 0], shape[..., 1])

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
            jax.nn.sigmoid(raw[..., 0]),
            0.5 * jnp.exp(-0.5 * jnp.clip(raw[..., 1], *_LOG_PRECISION)),
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
        return self.loc + self.scale * (norm.pdf(lower) - norm.pdf(upper)) / jnp.exp(
            self._log_mass()
        )

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        standard = (off_edges(action) - self.loc) / self.scale
        return jnp.sum(norm.logpdf(standard) - jnp.log(self.scale) - self._log_mass(), axis=-1)

    def entropy(self) -> Array:
        """f32[...], differential entropy in nats."""
        lower, upper = self._limits()
        log_mass = self._log_mass()
        pull = (lower * norm.pdf(lower) - upper * norm.pdf(upper)) / (2 * jnp.exp(log_mass))
        return jnp.sum(
            0.5 * jnp.log(2 * jnp.pi * jnp.e) + jnp.log(self.scale) + log_mass + pull, axis=-1
        )


class Mixture(struct.PyTreeNode):
    """A mixture of Betas that can say "here or there", and there turned otherwise and higher up.

    A component is one cell of the unit square with one range of turns: x, y and turn are Betas inside it
    (where symmetry is 2, turn is as often in the opposite range); z is a Beta on a window about the cell's
    own height. A = 4.

    Attributes:
      log_weight: f32[..., G * G * T], normalised; axis 0 of the cells is x, turns come last.
      bottom: f32[..., G * G], where the window of z begins; width: f32[...], of the window.
      inside: Beta[..., 4], where in its cell, window and range a draw lies; all components share it.
      side, num_turns: G, T.
      symmetry: 1 if the ranges divide a whole turn, 2 if half of one.
    """

    log_weight: Array
    bottom: Array
    width: Array
    inside: Beta
    side: int = struct.field(pytree_node=False)
    num_turns: int = struct.field(pytree_node=False)
    symmetry: int = struct.field(pytree_node=False, default=2)

    @staticmethod
    def from_scores(
        scores: Array, raw: Array, bottom: Array, width: Array, symmetry: int = 2
    ) -> Mixture:
        """The distribution of the components' scores f32[..., G, G, T] and raw outputs f32[..., 4, 2].

        Args:
          bottom: f32[..., G, G], as actions; width: f32[...].
        """
        side, num_turns = scores.shape[-2:]
        batch = scores.shape[:-3]
        return Mixture(
            jax.nn.log_softmax(scores.reshape(*batch, -1)),
            bottom.reshape(*batch, -1),
            width,
            Beta.from_raw(raw),
            side,
            num_turns,
            symmetry,
        )

    def _bottom(self, cell: Array) -> Array:
        return jnp.take_along_axis(self.bottom, cell[..., None], axis=-1)[..., 0]

    def _action(self, component: Array, inside: Array, half: Array) -> Array:
        cell = component // self.num_turns
        turn = component % self.num_turns
        xy = (
            jnp.stack([cell // self.side, cell % self.side], axis=-1) + inside[..., :2]
        ) / self.side
        z = self._bottom(cell) + self.width * inside[..., 2]
        yaw = (half + (turn + inside[..., 3]) / self.num_turns) / self.symmetry
        return off_edges(jnp.concatenate([xy, z[..., None], yaw[..., None]], axis=-1))

    def sample(self, key: Array) -> Array:
        """One draw, f32[..., 4]."""
        key_component, key_inside, key_half = jax.random.split(key, 3)
        component = jax.random.categorical(key_component, self.log_weight)
        half = jax.random.bernoulli(key_half, shape=component.shape).astype(self.width.dtype)
        return self._action(component, self.inside.sample(key_inside), half * (self.symmetry - 1))

    def mean(self) -> Array:
        """f32[..., 4]: the mean of the likeliest component, where a mean of all may lie between two."""
        component = jnp.argmax(self.log_weight, axis=-1)
        return self._action(component, self.inside.mean(), jnp.zeros(component.shape))

    def log_prob(self, action: Array) -> Array:
        """f32[...]."""
        x, y = (jnp.clip(action[..., axis] * self.side, 0, self.side - EDGE) for axis in (0, 1))
        turn = jnp.clip(
            jnp.mod(self.symmetry * action[..., 3], 1.0) * self.num_turns, 0, self.num_turns - EDGE
        )
        cell = x.astype(jnp.int32) * self.side + y.astype(jnp.int32)
        component = cell * self.num_turns + turn.astype(jnp.int32)
        weight = jnp.take_along_axis(self.log_weight, component[..., None], axis=-1)[..., 0]
        z = (action[..., 2] - self._bottom(cell)) / self.width
        inside = jnp.stack([x % 1.0, y % 1.0, z, turn % 1.0], axis=-1)
        return weight + self.inside.log_prob(inside) + self._log_density()

    def entropy(self) -> Array:
        """f32[...], differential entropy in nats."""
        weights = -jnp.sum(jnp.exp(self.log_weight) * self.log_weight, axis=-1)
        return weights + self.inside.entropy() - self._log_density()

    def _log_density(self) -> Array:
        """f32[...]: of draws that are even inside a component, but for its weight."""
        return jnp.log(self.side**2 * self.num_turns) - jnp.log(self.width)


HEADS: dict[str, Callable[[Array], ActionDistribution]] = {
    "beta": Beta.from_raw,
    "beta_free": Beta.free,
    "normal": TruncatedNormal.from_raw,
}
"""What turns raw outputs f32[..., A, 2] into a distribution."""
