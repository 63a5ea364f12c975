"""Beta and truncated normal against scipy, and safe at the edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from cluttergen_jax.learning.networks.distributions import (
    EDGE,
    HEADS,
    Beta,
    Mixture,
)

RAW = jax.random.normal(jax.random.key(0), (40, 4, 2)) * 2.5


def reference(dist):
    if isinstance(dist, Beta):
        return scipy.stats.beta(np.float64(dist.alpha), np.float64(dist.beta))
    loc = np.float64(dist.loc)
    scale = np.float64(dist.scale)
    return scipy.stats.truncnorm(-loc / scale, (1 - loc) / scale, loc, scale)


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
def test_matches_scipy(head):
    dist = head(RAW)
    oracle = reference(dist)
    action = jax.random.uniform(jax.random.key(1), (40, 4), minval=0.02, maxval=0.98)
    np.testing.assert_allclose(
        dist.log_prob(action), oracle.logpdf(np.float64(action)).sum(-1), atol=5e-4, rtol=1e-4
    )
    np.testing.assert_allclose(dist.entropy(), oracle.entropy().sum(-1), atol=5e-4, rtol=1e-4)
    np.testing.assert_allclose(dist.mean(), oracle.mean(), atol=1e-4)


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
def test_samples_follow_the_distribution(head):
    dist = head(RAW[0])
    draws = np.asarray(jax.vmap(dist.sample)(jax.random.split(jax.random.key(2), 5000)))
    for axis in range(4):
        one = reference(jax.tree.map(lambda leaf, axis=axis: leaf[axis], dist))
        # What a U-shape would put beyond the edges lies on them.
        low, high = one.cdf(np.array([2 * EDGE, 1 - 2 * EDGE]))
        inside = draws[(draws[:, axis] > 2 * EDGE) & (draws[:, axis] < 1 - 2 * EDGE), axis]
        assert len(inside) / len(draws) == pytest.approx(high - low, abs=0.015)
        within = scipy.stats.kstest(
            inside, lambda x, one=one, low=low, high=high: (one.cdf(x) - low) / (high - low)
        )
        assert within.pvalue > 1e-4


SCORES = 1.5 * jax.random.normal(jax.random.key(3), (5, 5, 3))
INSIDE = jnp.array([[0.5, 1.0], [-1.0, 0.5], [-1.1, 2.3], [0.0, 2.0]])
BOTTOMS = jax.random.uniform(jax.random.key(5), (5, 5), maxval=0.7)


def mixture_of(scores, symmetry=2):
    """5 x 5 cells, 3 turns; z in windows of 0.2."""
    return Mixture.from_scores(scores, INSIDE, BOTTOMS, jnp.float32(0.2), symmetry)


@pytest.mark.parametrize("symmetry", [1, 2])
@pytest.mark.slow
def test_mixture_integrates_to_one_and_its_entropy_is_exact(symmetry):
    mixture = mixture_of(SCORES, symmetry)
    # Even draws over everything in which there is density: z in the window of the cell.
    actions = np.array(jax.random.uniform(jax.random.key(6), (1_000_000, 4)))
    start = np.asarray(BOTTOMS)[(actions[:, 0] * 5).astype(int), (actions[:, 1] * 5).astype(int)]
    actions[:, 2] = start + 0.2 * actions[:, 2]
    density = 0.2 * np.exp(np.asarray(jax.vmap(mixture.log_prob)(actions), np.float64))
    error = density.std() / 1000
    assert error < 0.01
    assert density.mean() == pytest.approx(1, abs=4 * error)
    draws = jax.vmap(mixture.sample)(jax.random.split(jax.random.key(8), 50_000))
    surprise = -np.asarray(jax.vmap(mixture.log_prob)(draws), np.float64)
    assert float(mixture.entropy()) == pytest.approx(surprise.mean(), abs=0.03)
