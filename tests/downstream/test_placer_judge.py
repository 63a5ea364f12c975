"""Proposals are judged as attempts are: against the rules themselves, and against what must be."""

import jax
import numpy as np
import pytest

from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge, world_pose
from cluttergen_jax.physics.paper_count import PaperCount
from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.types import Verdict
from tests.helpers.placing import write_bank
from tests.helpers.worlds import TOP, trio


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    return PartialScenes(write_bank(tmp_path_factory.mktemp("judge") / "bank"))


@pytest.fixture(scope="module")
def judge(scenes):
    return ProposalJudge(scenes.rules)


@pytest.fixture(scope="module")
def half_heights():
    return np.array([asset.half_extents[2] for asset in trio()])


def test_of_a_partial_scene_the_first_objects_stand_and_the_next_is_the_current_one(scenes):
    places = scenes.places()
    episodes = scenes.episodes(places)
    focus = np.asarray(jax.vmap(scenes.rules.focus)(episodes))
    for row, (scene, slot) in enumerate(places):
        order = scenes.object_index[scene]
        assert set(np.flatnonzero(episodes.is_placed[row])) == set(order[:slot])
        assert focus[row] == order[slot]
        assert np.array_equal(episodes.poses[row][order[:slot]], scenes.poses[scene, :slot])
    assert scenes.num_queries == len(places) == 12


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


def test_what_becomes_of_a_proposal_does_not_depend_on_the_others(scenes, judge, half_heights):
    episodes = scenes.episodes(scenes.places())
    row, pose = random_proposals(scenes, half_heights, 20)
    together = judge.settle(episodes, row, pose)
    apart = [judge.settle(episodes, row[k : k + 1], pose[k : k + 1]) for k in (0, 7, 19)]
    for k, one in zip((0, 7, 19), apart, strict=True):
        assert together.verdict[k] == one.verdict[0]
        assert np.array_equal(together.poses[k], one.poses[0])


def test_where_the_scenes_own_object_rests_it_stands_with_a_margin(scenes, judge):
    places = scenes.places()
    own = scenes.poses[places[:, 0], places[:, 1]]
    yaw = 2 * np.arctan2(own[:, 6], own[:, 3])
    pose = np.column_stack([own[:, :2], own[:, 2] - TOP + 0.001, yaw]).astype(np.float32)
    judged = judge.settle(scenes.episodes(places), np.arange(len(places)), pose)
    assert (judged.verdict == int(Verdict.STABLE)).all()
    assert judged.has_margin.all()
    assert judge.stand(judged).all()


def test_what_meets_another_object_or_nothing_at_all_does_not_stand(scenes, judge, half_heights):
    places = np.array([[0, 1]])
    focus = scenes.object_index[0, 1]
    there = scenes.poses[0, 0, :2]
    inside = [*there, half_heights[focus] + 0.001, 0.0]
    beyond = [0.31, 0.0, half_heights[focus] + 0.001, 0.0]
    judged = judge.settle(scenes.episodes(places), np.zeros(2, int), np.array([inside, beyond], np.float32))
    assert int(Verdict.STABLE) not in judged.verdict
    assert judged.verdict[1] in (int(Verdict.OUTSIDE), int(Verdict.FELL), int(Verdict.UNSETTLED))
    assert not judge.stand(judged).any()
    assert not judged.has_margin.any()


def test_a_pose_in_the_region_is_that_pose_in_the_world(scenes):
    pose = np.asarray(world_pose(scenes.rules.region, np.array([0.1, -0.2, 0.05, np.pi / 2], np.float32)))
    assert pose == pytest.approx([0.1, -0.2, TOP + 0.05, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], abs=1e-6)


def test_the_papers_count_lets_neighbours_be_pushed_but_not_things_fall(scenes, judge, half_heights):
    layout = scenes.problem.world.layout
    count = PaperCount(layout, scenes.rules.physics.config)
    # The box beside the prism at rest; pushed apart by 5 mm of overlap; and let go 10 cm too high.
    apart, overlapping, high = (
        [[x, 0.0, TOP + half_heights[0] + z, 1, 0, 0, 0], [0.0, 0.0, TOP + half_heights[1], 1, 0, 0, 0]]
        for x, z in ((0.12, 0.0), (0.062, 0.0), (0.12, 0.1))
    )
    poses = np.tile(np.eye(7, dtype=np.float32)[3], (3, 3, 1))
    poses[:, :2] = [apart, overlapping, high]
    is_placed = np.tile([True, True, False], (3, 1))
    assert count(poses, is_placed).tolist() == [True, True, False]
    settling = scenes.rules.physics.settle_batch(poses, is_placed, np.zeros(3, np.int32), np.ones(3, bool))
    assert settling.verdict.tolist()[:2] == [int(Verdict.STABLE), int(Verdict.DISPLACED)]
