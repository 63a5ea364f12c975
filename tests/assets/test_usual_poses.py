"""How often people leave things in which pose: measured facts decide, and knowledge comes before them."""

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.usual_poses import usual_weights
from cluttergen_jax.geometry import rotation_matrix
from tests.helpers.worlds import box

POOL = find_pool("all")


def weights(name: str, way=None) -> tuple[np.ndarray, np.ndarray]:
    """The weights of an object's resting poses, and its height in each, metres."""
    asset = POOL[name]
    quaternions = np.array([pose.quaternion for pose in asset.resting])
    likelihood = np.array([pose.likelihood for pose in asset.resting])
    height = [np.ptp(asset.vertices @ rotation_matrix(each)[2]) for each in quaternions]
    return usual_weights(asset, quaternions, likelihood, way), np.array(height)


@pytest.mark.parametrize("name", POOL.names)
def test_each_object_is_mostly_left_as_it_is_used(name):
    found, _ = weights(name)
    assert found.sum() == pytest.approx(1)
    assert found[0] >= 0.9
    assert (found >= 0).all()


@pytest.mark.parametrize("name", ["toaster", "desk_phone", "pot", "teapot"])
def test_what_falls_on_its_side_half_the_time_is_hardly_ever_left_so(name):
    asset = POOL[name]
    assert 1 - asset.resting[0].likelihood > 0.3
    assert weights(name)[0][0] >= 0.97


def test_a_bottle_sometimes_lies_and_a_book_never_stands_by_itself():
    found, height = weights("bottle")
    assert 0.04 < found[height < 0.1].sum() < 0.1
    found, height = weights("hardback_book")
    assert found[height > 0.1].sum() == 0
    assert found[1:].sum() > 0


def test_knowledge_comes_before_the_shape():
    assert weights("bottle", "upright")[0].tolist() == [1.0] + [0.0] * 9
    found, height = weights("bottle", "lying")
    assert found[height < 0.1].sum() > 0.9
    likelihood = np.array([pose.likelihood for pose in POOL["bottle"].resting])
    assert weights("bottle", "any")[0] == pytest.approx(likelihood / likelihood.sum())


def test_what_is_the_same_on_all_sides_lies_as_it_falls():
    die = box("die", (0.01, 0.01, 0.01))
    quaternions = np.array([[1.0, 0, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0, 0]])
    assert usual_weights(die, quaternions, np.array([0.25, 0.75])).tolist() == [0.25, 0.75]
