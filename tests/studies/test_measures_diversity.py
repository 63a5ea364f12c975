"""Diversity: known values, metric axioms, and invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.diversity import embed
from cluttergen_jax.judging.scene_models import by_object
from studies.measures.diversity import (
    edge_share,
    independent_distance,
    nearest_distance,
    plan_box_area,
    plan_clusters,
    plan_entropy,
    scene_kernel,
    vendi_score,
)
from tests.helpers.worlds import box

REGION = Rectangle((0.1, -0.2), (0.3, 0.2), 0.7)
TOP = 0.7
HALVES = ((0.02, 0.1, 0.03), (0.05, 0.05, 0.01), (0.03, 0.04, 0.05))
OBJECTS = [box(f"box-{n}", half) for n, half in enumerate(HALVES)]
K = len(OBJECTS)


def distances_of(vectors):
    return cdist(vectors, vectors)


def scenes_at(positions, turns=None):
    """poses f[N, K, 7] of positions f[N, K, 2] in the region's frame and world orientations (wxyz)."""
    cos = np.cos(REGION.yaw)
    sin = np.sin(REGION.yaw)
    poses = np.tile(np.eye(7)[3], (*positions.shape[:2], 1))
    poses[..., :2] = positions @ np.array([[cos, sin], [-sin, cos]]) + REGION.center
    poses[..., 2] = TOP
    if turns is not None:
        poses[..., 3:] = turns
    return poses


def random_scenes(rng, num, share=0.8):
    positions = rng.uniform(-1, 1, (num, K, 2)) * REGION.half_extents
    turns = Rotation.random(num * K, rng=rng).as_quat().reshape(num, K, 4)[..., [3, 0, 1, 2]]
    return scenes_at(positions, turns), rng.random((num, K)) < share


def vectors_of(poses, is_placed, **kwargs):
    return embed(OBJECTS, poses, is_placed, REGION, TOP, **{"num_slots": K} | kwargs)


def test_by_object_says_where_each_object_is():
    rng = np.random.default_rng(0)
    index = np.array([rng.permutation(6)[:4] for _ in range(20)])
    index[:, 3] = -1
    is_placed = np.arange(4) < rng.integers(0, 5, 20)[:, None]
    slot_poses = rng.normal(size=(20, 4, 7))
    poses, placed, slot = by_object(index, is_placed, slot_poses, 6)
    assert placed.sum() == (is_placed & (index >= 0)).sum()
    for n, k in np.argwhere(placed):
        assert index[n, slot[n, k]] == k
        np.testing.assert_array_equal(poses[n, k], slot_poses[n, slot[n, k]])
    assert (slot[~placed] == -1).all()


def test_entropy_of_one_place_is_zero_and_of_all_cells_that_of_an_even_spread():
    grid = np.stack(np.meshgrid(np.arange(6) + 0.5, np.arange(4) + 0.5, indexing="ij"), -1).reshape(
        -1, 2
    )
    positions = np.zeros((24, K, 2))
    positions[:, 1] = grid * 0.1 - REGION.half_extents
    result = plan_entropy(
        scenes_at(positions), np.ones((24, K), bool) & [True, True, False], REGION, 0.1
    )
    assert result.num_cells == 24
    assert result.entropy[0] == 0
    assert result.evenness[1] == pytest.approx(1.0)
    assert result.area[1] == pytest.approx(0.6 * 0.4)
    assert result.area[0] == pytest.approx(0.01)
    assert np.isnan(result.entropy[2])
    assert result.count.tolist() == [24, 24, 0]


def test_shares_along_the_edges():
    rng = np.random.default_rng(2)
    positions = np.zeros((4000, K, 2))
    positions[:, 0] = rng.uniform(-1, 1, (4000, 2)) * REGION.half_extents
    positions[:, 1] = [0.99 * REGION.half_extents[0], 0.0]
    shares = edge_share(
        scenes_at(positions), np.ones((4000, K), bool) & [True, True, False], REGION
    )
    assert shares[0] == pytest.approx(0.36, abs=0.03)
    assert shares[1] == 1
    assert np.isnan(shares[2])
    with pytest.raises(ConfigError, match="band"):
        edge_share(scenes_at(positions), np.ones((4000, K), bool), REGION, 0.6)


def test_clusters_are_told_from_an_even_spread():
    rng = np.random.default_rng(3)
    positions = np.zeros((500, K, 2))
    positions[:, 0] = rng.uniform(-1, 1, (500, 2)) * REGION.half_extents
    near = np.where(rng.uniform(size=500) < 0.5, -0.2, 0.2)
    positions[:, 1] = np.column_stack([near, np.full(500, 0.1)]) + rng.normal(0, 0.01, (500, 2))
    placed = np.ones((500, K), bool) & [True, True, False]
    numbers, shares = plan_clusters(scenes_at(positions), placed, REGION)
    assert (numbers[0], shares[0]) == (0, 0)
    assert numbers[1] == 2
    assert shares[1] > 0.9
    assert np.isnan([numbers[2], shares[2]]).all()


def test_box_is_the_rectangle_between_extremes():
    positions = np.array([[[-0.1, 0.0]], [[0.2, 0.05]], [[0.0, -0.1]], [[0.29, 0.19]]])
    is_placed = np.array([[True], [True], [True], [False]])
    assert plan_box_area(scenes_at(positions), is_placed, REGION) == pytest.approx(0.3 * 0.15)
    assert np.isnan(plan_box_area(scenes_at(positions), is_placed & False, REGION))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_distance_is_a_metric_whatever_is_absent(seed):
    rng = np.random.default_rng(seed)
    poses, is_placed = random_scenes(rng, 7, share=0.5)
    distances = distances_of(vectors_of(poses, is_placed))
    np.testing.assert_allclose(distances, distances.T)
    np.testing.assert_allclose(np.diag(distances), 0, atol=1e-12)
    assert (distances[:, :, None] <= distances[:, None] + distances.T[None] + 1e-9).all()
    differs = (is_placed[:, None] != is_placed[None]).any(-1)
    assert (distances[differs] >= np.hypot(*REGION.half_extents) / np.sqrt(K) - 1e-12).all()
    # What stands where an absent object would be does not matter.
    elsewhere = np.where(is_placed[..., None], poses, rng.normal(size=poses.shape))
    np.testing.assert_array_equal(distances_of(vectors_of(elsewhere, is_placed)), distances)


def test_independent_distance_is_that_of_even_draws():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (2, 200_000, 2)) * REGION.half_extents
    drawn = np.sqrt(np.square(points[0] - points[1]).sum(1).mean())
    assert independent_distance(REGION) == pytest.approx(drawn, rel=0.01)


def test_nearest_is_the_nearest_and_zero_for_a_repeated_scene():
    rng = np.random.default_rng(4)
    poses, is_placed = random_scenes(rng, 30)
    vectors = vectors_of(poses, is_placed)
    distances = distances_of(vectors) + np.diag(np.full(30, np.inf))
    np.testing.assert_allclose(nearest_distance(vectors), distances.min(1))
    assert nearest_distance(np.concatenate([vectors, vectors[:1]]))[[0, -1]].tolist() == [0, 0]
    with pytest.raises(ConfigError):
        nearest_distance(vectors[:1])


def test_vendi_counts_scenes():
    rng = np.random.default_rng(5)
    poses, is_placed = random_scenes(rng, 12, share=0.6)
    vectors = vectors_of(poses, is_placed)
    kernel = scene_kernel(vectors, REGION)
    score = vendi_score(kernel)
    assert 1 < score < 12
    order = rng.permutation(12)
    assert vendi_score(kernel[order][:, order]) == pytest.approx(score)
    assert vendi_score(scene_kernel(np.repeat(vectors, 3, axis=0), REGION)) == pytest.approx(score)
    assert vendi_score(scene_kernel(vectors, REGION, 1e-4)) == pytest.approx(12)
    assert vendi_score(scene_kernel(vectors, REGION, 1e4)) == pytest.approx(1, abs=1e-4)
