"""Episodes of a trial and their figures."""

import json

import jax
import numpy as np
import pytest

from cluttergen_jax.evaluation.runner import attempts_of, figures_of, run_episodes
from cluttergen_jax.placement.rollout import BlockSampler, Rollout, sample_blocks
from tests.helpers.problems import made_up_rules


@jax.tree_util.Partial
def uniform(key, episode):
    return jax.random.uniform(key, (4,))


@pytest.fixture(scope="module")
def made_up():
    """A sampler over the made-up physics, and twenty of its episodes."""
    sampler = BlockSampler(made_up_rules(history_stride=0), uniform)
    return sampler, run_episodes(Rollout(attempts_of), sampler, 20, seed=3)


@pytest.mark.slow
def test_logged_episodes_are_the_samplers(made_up):
    sampler, outcome = made_up
    _, _, plain = next(sample_blocks(sampler, [(0, 20)], 3))
    for ours, theirs in zip(jax.tree.leaves(outcome.scenes), jax.tree.leaves(plain), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    attempts = outcome.attempts
    counts = outcome.scenes.counts
    assert attempts.is_made.all()
    assert len(attempts.scene) == counts.attempts.sum()
    np.testing.assert_array_equal(
        np.bincount(attempts.scene, attempts.steps, minlength=20), counts.steps.sum(1)
    )
    assert attempts.is_stable.sum() == outcome.scenes.is_placed.sum()


def test_figures_by_hand(made_up):
    outcome = made_up[1]
    figures = figures_of(outcome)
    scenes = outcome.scenes
    assert figures["success"] == scenes.is_success.mean()
    assert figures["placed"] == pytest.approx(np.dot(figures["placed_histogram"], range(5)) / 20)
    assert figures["attempts"] == sum(figures["verdicts"].values())
    assert figures["rest_steps"]["mean"] == 23
    loose = figures_of(outcome, has_last_check=False)
    assert loose["success"] == scenes.is_filled.mean()
    json.dumps(figures, allow_nan=False)
