"""Recordings: the same scene as the sampler makes, and every attempt as the rules counted it."""

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import ProblemConfig, compose
from cluttergen_jax.placement.region import pose_of_action
from cluttergen_jax.placement.rollout import BlockSampler, EpisodeRecorder
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import trio

WIDTH = 6


@pytest.fixture(scope="module")
def problem():
    # A table so small that much goes wrong.
    placement = PlacementConfig(num_objects=3, max_attempts=3, history_stride=0)
    return compose(trio(), cuboid_table(0.16, 0.2), ProblemConfig(placement=placement))


@pytest.fixture(scope="module")
def sampler(problem):
    return BlockSampler(problem.rules, make_proposer("random", problem.rules))


@pytest.fixture(scope="module")
def scenes(sampler):
    return jax.device_get(
        jax.jit(sampler.sample)(jax.random.key(7), np.arange(WIDTH), np.ones(WIDTH, bool))
    )


@pytest.fixture(scope="module")
def recordings(problem, sampler):
    recorder = EpisodeRecorder(sampler, problem.world, WIDTH)
    return [recorder.record(7, index) for index in range(WIDTH)]


def test_recordings_end_as_the_sampler_does(scenes, recordings):
    assert scenes.is_success.any()
    assert not scenes.is_success.all()
    assert sum(len(each.failures) for each in recordings) > 3
    for place, recording in enumerate(recordings):
        placed = scenes.object_index[place][scenes.is_placed[place]]
        assert set(recording.placed) == set(placed)
        np.testing.assert_array_equal(
            recording.poses[placed], scenes.poses[place][scenes.is_placed[place]]
        )
        assert recording.is_success == scenes.is_success[place]
        assert recording.verdict == Verdict(int(scenes.verdict[place])).label
        assert recording.drift == scenes.drift[place]


def test_attempts_begin_where_proposed_and_hang_together(problem, recordings):
    rules = problem.rules
    for recording in recordings:
        for number, attempt in enumerate(recording.attempts):
            heights = 2 * rules.geometry.half_extents[:, 2]
            reach = heights[attempt.object_index] + np.max(
                np.where(attempt.is_placed, heights, 0.0)
            )
            np.testing.assert_allclose(
                attempt.trajectory[0, :7],
                pose_of_action(attempt.action, rules.region, reach),
                atol=1e-6,
            )
            np.testing.assert_allclose(
                attempt.trajectory[-1, :7], attempt.settled[attempt.object_index], atol=1e-6
            )
            assert not attempt.is_placed[attempt.object_index]
            last = number + 1 == len(recording.attempts)
            after = recording.poses if last else recording.attempts[number + 1].poses
            there = attempt.is_placed | (
                attempt.is_stable & (np.arange(len(after)) == attempt.object_index)
            )
            expected = attempt.settled if attempt.is_stable else attempt.poses
            np.testing.assert_array_equal(after[there], expected[there])


@pytest.mark.parametrize("width", [WIDTH, 32])
def test_proposals_of_the_last_object_alone_are_those_that_all_attempts_have(
    problem, sampler, width
):
    recorder = EpisodeRecorder(sampler, problem.world, width)
    whole = recorder.record(7, 0, num_proposals=40)
    some = recorder.record(7, 0, num_proposals=40, last_only=True)
    assert all(each.proposals.shape == (40, 4) for each in whole.attempts)
    assert all(len(np.unique(each.proposals, axis=0)) == 40 for each in whole.attempts)
    last = some.last_turn(some.attempts[-1].object_index)[0]
    assert [each for each in some.attempts if each.proposals is not None] == [last]
    place = some.attempts.index(last)
    np.testing.assert_array_equal(last.proposals, whole.attempts[place].proposals)
    for one, other in zip(some.attempts, whole.attempts, strict=True):
        np.testing.assert_array_equal(one.trajectory, other.trajectory)
