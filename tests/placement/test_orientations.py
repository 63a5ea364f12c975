"""Objects released in other poses than upright: their arrays against the geometry of the turned parts."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.api.generate import generate
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import Problem, ProblemConfig, compose
from cluttergen_jax.placement.region import pose_of_action
from cluttergen_jax.scene.bank import read_scenes
from cluttergen_jax.spec import SceneSpec

NAMES = ("cereal_box", "mug", "bottle")


def problem(poses: str, names: tuple[str, ...] = NAMES) -> Problem:
    pool = find_pool("dining", names=names)
    placing = PlacementConfig(num_objects=len(names), poses=poses)
    return compose([pool[name] for name in names], cuboid_table(), ProblemConfig(placement=placing))


@pytest.fixture(scope="module")
def resting() -> Problem:
    return problem("resting")


def test_a_box_rests_on_each_of_its_six_sides(resting):
    found = resting.rules.geometry.orientations
    quaternions = np.asarray(found.quaternion[0])[np.asarray(found.is_one[0])]
    ups = np.abs(Rotation.from_quat(quaternions, scalar_first=True).as_matrix()[:, 2])
    sides = ups.argmax(1)
    assert np.all(ups.max(1) > np.cos(np.radians(1)))
    assert sorted(np.bincount(sides)) == [2, 2, 2]
    half = resting.world.objects[0].half_extents
    np.testing.assert_allclose(found.height[0][: len(sides)], half[sides], atol=1e-3)


def test_usual_poses_are_the_resting_ones_drawn_as_people_leave_things(resting):
    found = problem("usual").rules.geometry.orientations
    thrown = resting.rules.geometry.orientations
    np.testing.assert_array_equal(found.is_one, thrown.is_one)
    np.testing.assert_array_equal(found.quaternion, thrown.quaternion)
    drawn = jax.vmap(lambda key: found.draw(key, 2))(jax.random.split(jax.random.key(0), 1000))
    # Of a bottle, which ends on its side nine times of ten.
    assert 0.88 < np.mean(drawn == 0) < 0.96
    assert np.exp(thrown.log_weight[2, 0]) < 0.1 * np.exp(thrown.log_weight[2]).sum()


def test_arrays_are_those_of_the_turned_parts(resting):
    found = resting.rules.geometry.orientations
    for index, asset in enumerate(resting.world.objects):
        vertices = np.concatenate([part.vertices for part in asset.parts])
        for number in np.flatnonzero(found.is_one[index]):
            turn = Rotation.from_quat(
                np.asarray(found.quaternion[index, number]), scalar_first=True
            )
            turned = turn.apply(vertices)
            np.testing.assert_allclose(found.height[index, number], -turned[:, 2].min(), atol=1e-5)
            is_column = np.asarray(found.is_column[index, number])
            xy = np.asarray(found.column_xy[index, number])[is_column]
            bottom = np.asarray(found.column_bottom[index, number])[is_column]
            assert (xy >= turned[:, :2].min(0) - 1e-4).all()
            assert (xy <= turned[:, :2].max(0) + 1e-4).all()
            # Columns reach the outline, and none is below the lowest vertex.
            assert np.abs(xy.max(0) - turned[:, :2].max(0)).max() < 0.004
            assert -1e-5 < bottom.min() - turned[:, 2].min() < 0.002
            own = np.asarray(found.surface_owner) == index
            top = turn.apply(np.asarray(found.surface[own, number]).reshape(-1, 3))[:, 2]
            assert abs(top.max() - turned[:, 2].max()) < 0.002


def test_the_nearest_orientation_is_the_one_in_which_an_object_lies(resting):
    geometry = resting.rules.geometry
    found = geometry.orientations
    for number in range(6):
        about_z = Rotation.from_euler("z", 0.7 * number + 0.3)
        quaternions = [
            (about_z * Rotation.from_quat(np.asarray(row[number]), scalar_first=True)).as_quat(
                scalar_first=True
            )
            for row in found.quaternion
        ]
        poses = np.concatenate([np.zeros((3, 3)), np.array(quaternions)], axis=1).astype(np.float32)
        expected = np.where(np.asarray(found.is_one)[:, number], number, 0)
        assert (np.asarray(geometry.orientations_at(poses)) == expected).all()


def test_an_object_is_released_in_the_orientation_that_was_drawn(resting):
    rules = resting.rules
    drawn = set()
    action = np.array([0.5, 0.5, 0.4, 0.25], np.float32)

    @jax.jit
    def release(key):
        episode = rules.begin(key)
        plain = pose_of_action(action, episode.region, rules.height_range(episode))
        return episode, rules.release(episode, action)[0], plain

    for seed in range(12):
        episode, poses, plain = release(jax.random.key(seed))
        focus = int(rules.focus(episode))
        expected = Rotation.from_quat(
            np.asarray(plain)[3:], scalar_first=True
        ) * Rotation.from_quat(
            np.asarray(rules.geometry.orientations.quaternion[focus, int(episode.orientation)]),
            scalar_first=True,
        )
        got = Rotation.from_quat(np.asarray(poses[focus, 3:]), scalar_first=True)
        assert (got * expected.inv()).magnitude() < 1e-3
        drawn.add((focus, int(episode.orientation)))
    assert len(drawn) > 6


def test_any_orientation_is_drawn_evenly_and_remembers_how_objects_rest():
    found = problem("any", ("cereal_box",)).rules.geometry.orientations
    weight = np.exp(np.asarray(found.log_weight))
    assert ((weight > 0).sum(1) == 24).all()
    assert np.asarray(found.is_one)[weight == 0].any()


def test_methods_that_see_clouds_take_upright_objects_alone():
    spec = SceneSpec(poses="resting")
    spec.check_method("guided")
    with pytest.raises(ConfigError, match="poses = 'resting' with method 'policy'"):
        spec.check_method("policy")
    with pytest.raises(ConfigError, match="Did you mean 'resting'"):
        SceneSpec(poses="restng")


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "least"), [("resting", 60), ("any", 30)])
def test_objects_lie_in_scenes_that_stand(poses, least, tmp_path):
    bank = generate(
        tmp_path / "bank",
        pool="dining",
        poses=poses,
        num_scenes=64,
        seed=3,
        render=False,
        max_files=0,
    )
    scenes = list(read_scenes(bank))
    assert len(scenes) > least
    ups = [
        Rotation.from_quat(s.poses[:, 3:], scalar_first=True).as_matrix()[:, 2, 2] for s in scenes
    ]
    assert 0.2 < np.mean(np.concatenate(ups) < np.cos(np.radians(30))) < 0.9
    assert bank.recipe["placement"]["poses"] == poses
