"""Episodes of a trial and their figures."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.evaluation import cells, comparison
from cluttergen_jax.evaluation.episodes import (
    Attempts,
    attempts_of,
    figures_of,
    run_episodes,
    steps_by_attempt,
    within,
)
from cluttergen_jax.evaluation.studies.paper_figures import at_least
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.rollout import BlockSampler, Rollout, sample_blocks
from tests.helpers.problems import HalfTable, made_up_rules


@jax.tree_util.Partial
def uniform(key, episode):
    return jax.random.uniform(key, (4,))


@pytest.fixture(scope="module")
def made_up():
    """A sampler over the made-up physics, and twenty of its episodes."""
    sampler = BlockSampler(made_up_rules(history_stride=0), uniform)
    return sampler, run_episodes(Rollout(attempts_of), sampler, 20, seed=3)


def test_scenes_are_counted_within_some_attempts():
    # By hand: of four scenes of ten objects, one failed; the others took 10, 16 and 50 attempts.
    found = within(np.array([True, True, True, False]), np.array([10, 16, 50, 10]), 10)
    assert [each["times"] for each in found] == [1.0, 1.5, 5.0]
    assert [each["share"] for each in found] == [0.25, 0.25, 0.75]
    assert all(each["low95"] <= each["share"] <= each["high95"] for each in found)


@pytest.mark.slow
def test_logged_episodes_are_the_samplers(made_up):
    sampler, outcome = made_up
    _, _, plain = next(sample_blocks(sampler, [(0, 20)], 3))
    for ours, theirs in zip(jax.tree.leaves(outcome.scenes), jax.tree.leaves(plain), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    attempts, counts = outcome.attempts, outcome.scenes.counts
    assert attempts.is_made.all()
    assert len(attempts.scene) == counts.attempts.sum()
    np.testing.assert_array_equal(
        np.bincount(attempts.scene, attempts.steps, minlength=20), counts.steps.sum(1)
    )
    assert attempts.is_stable.sum() == outcome.scenes.is_placed.sum()


def test_figures_by_hand(made_up):
    outcome = made_up[1]
    figures, scenes = figures_of(outcome), outcome.scenes
    assert figures["success"] == scenes.is_success.mean()
    assert figures["placed"] == pytest.approx(np.dot(figures["placed_histogram"], range(5)) / 20)
    assert figures["attempts"] == sum(figures["verdicts"].values())
    assert figures["rest_steps"]["mean"] == 23
    loose = figures_of(outcome, has_last_check=False)
    assert loose["success"] == scenes.is_filled.mean()
    shares = at_least(figures["placed_histogram"])
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == figures["filled"]
    json.dumps(figures, allow_nan=False)


def test_nothing_is_said_of_a_scene_where_none_is_valid(made_up):
    scenes = made_up[1].scenes
    none = dataclasses.replace(made_up[1], scenes=scenes.replace(is_success=np.zeros_like(scenes.is_success)))
    figures = figures_of(none)
    names = ("attempts_per_valid_scene", "simulated_steps_per_valid_scene")
    assert [figures[name] for name in names] == [None, None]
    row = {"trial": dataclasses.asdict(Trial()), "figures": figures}
    assert [cells.per_valid_scene(row, name, 1) for name in ("attempts", "simulated_steps")] == ["-", "-"]
    flat = comparison._flat(row)
    assert [flat[name] for name in names] == [None, None]
    assert "-" in comparison._table([row]).rows[0]


def test_steps_count_placements_that_took_three_attempts():
    # Scene 0: slot 0 stands at once, slot 1 at its third attempt; scene 1: slot 0 never stands.
    rows = [(0, 0, 1, 20, 1), (0, 1, 1, 240, 0), (0, 1, 2, 100, 0), (0, 1, 3, 30, 1)]
    rows += [(1, 0, ordinal, 240, 0) for ordinal in range(1, 6)]
    scene, slot, ordinal, steps, stable = np.array(rows).T
    blank = np.zeros(len(rows))
    attempts = Attempts(scene, slot, blank, ordinal, steps, stable > 0, blank, blank > -1)
    assert [(each["attempt"], each["count"], each["mean"]) for each in steps_by_attempt(attempts)] == [
        (1, 1, 240.0),
        (2, 1, 100.0),
        (3, 1, 30.0),
    ]


class SlowTable(HalfTable):
    """Attempts that fail take 240 steps."""

    def settle(self, poses, is_placed, focus, is_active):
        result = super().settle(poses, is_placed, focus, is_active)
        return result.replace(num_steps=jnp.where(result.num_steps == 60, 240, result.num_steps))


def test_whole_attempts_count_all_steps_and_the_history_tells_what_decided():
    whole = SlowTable(StabilityConfig(stop_when_decided=False))
    cut = made_up_rules(history_stride=12)
    patient = dataclasses.replace(cut, physics=whole, history_steps=whole.config.decision_step)
    assert patient.history_rows == cut.history_rows
    fails = jnp.array([0.1, 0.5, 0.1, 0.5])
    after, expected = (
        jax.jit(lambda key, rules=rules: rules.attempt(rules.begin(key), fails)[0])(jax.random.key(0))
        for rules in (patient, cut)
    )
    assert int(after.counts.steps[0]) == 240
    assert int(expected.counts.steps[0]) == 60
    for ours, theirs in zip(jax.tree.leaves(after.history), jax.tree.leaves(expected.history), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_finished_episodes_make_no_attempt(made_up):
    sampler, is_wanted = made_up[0], np.array([True, False, True])
    _, attempts = jax.jit(lambda key: sampler.step(sampler.begin(key, np.arange(3), is_wanted)))(
        jax.random.key(0)
    )
    assert attempts.is_made.tolist() == [True, False, True]
