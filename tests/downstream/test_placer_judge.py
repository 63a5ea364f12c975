"""Proposals are judged as attempts are: against the rules themselves, and against what must be."""

import jax
import numpy as np
import pytest

from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.types import Verdict
from tests.helpers.placing import write_bank
from tests.helpers.worlds import trio


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    return PartialScenes(write_bank(tmp_path_factory.mktemp("judge") / "bank"))


@pytest.fixture(scope="module")
def judge(scenes):
    return ProposalJudge(scenes.rules)


@pytest.fixture(scope="module")
def half_heights():
    return np.array([asset.half_extents[2] for asset in trio()])


def random_proposals(scenes, half_heights, number):
    rng = np.random.default_rng(5)
    places = scenes.places()
    row = rng.integers(len(places), size=number)
    focus = scenes.object_index[places[row, 0], places[row, 1]]
    height = half_heights[focus] + rng.choice([0.001, 0.001, 0.01], number)
    xy = rng.uniform(-1, 1, (number, 2)) * np.asarray(scenes.rules.region.half_extents)
    return row, np.column_stack([xy, height, rng.uniform(0, 6.28, number)]).astype(np.float32)


@pytest.mark.slow
def test_verdicts_are_those_of_an_attempt_of_the_decision_process(scenes, judge, half_heights):
    episodes = scenes.episodes(scenes.places())
    row, pose = random_proposals(scenes, half_heights, 40)
    judged = judge.settle(episodes, row, pose)
    rules = scenes.rules

    def attempted(row, pose):
        episode = jax.tree.map(lambda leaf: leaf[row], episodes)
        action = action_of_pose(pose[:3], pose[3], episode.region, rules.height_range(episode))
        return rules.attempt(episode, action)[1].verdict

    expected = np.asarray(jax.jit(jax.vmap(attempted))(row, pose))
    assert np.array_equal(judged.verdict, expected)
    assert {int(Verdict.STABLE), int(Verdict.DISPLACED)} <= set(expected.tolist())


def test_what_meets_another_object_or_nothing_at_all_does_not_stand(scenes, judge, half_heights):
    places = np.array([[0, 1]])
    focus = scenes.object_index[0, 1]
    there = scenes.poses[0, 0, :2]
    inside = [*there, half_heights[focus] + 0.001, 0.0]
    beyond = [0.31, 0.0, half_heights[focus] + 0.001, 0.0]
    judged = judge.settle(
        scenes.episodes(places), np.zeros(2, int), np.array([inside, beyond], np.float32)
    )
    assert int(Verdict.STABLE) not in judged.verdict
    assert judged.verdict[1] in (int(Verdict.OUTSIDE), int(Verdict.FELL), int(Verdict.UNSETTLED))
    assert not judge.stand(judged).any()
    assert not judged.has_margin.any()
