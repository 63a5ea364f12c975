"""What is measured of bodies in fewer steps is what is measured in all of them."""

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import sample_exposed, sample_surface
from cluttergen_jax.assets.deviation import _farthest
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import finish_parts, hull_of
from cluttergen_jax.assets.settle import resting_poses, solo_model
from cluttergen_jax.assets.solid import Voxels
from cluttergen_jax.geometry import rotation_matrix
from tests.helpers.shapes import make_box, slab


def test_poses_at_rest_are_those_of_releases_simulated_to_the_end():
    asset = make_box(half=(0.05, 0.03, 0.01))
    poses = resting_poses(asset, seed=3)
    model = solo_model(asset)
    turns = np.random.default_rng(3).normal(size=(64, 4))[:6]
    for quaternion in turns / np.linalg.norm(turns, axis=1, keepdims=True):
        data = mujoco.MjData(model)
        corners = asset.parts[0].vertices
        lowest = (corners @ rotation_matrix(quaternion)[2]).min()
        data.qpos[:] = [0, 0, 0.002 - lowest, *quaternion]
        for _ in range(720):
            mujoco.mj_step(model, data)
        up = rotation_matrix(data.qpos[3:7])[2]
        ups = [rotation_matrix(np.array(pose.quaternion))[2] for pose in poses]
        assert max(up @ each for each in ups) > np.cos(np.radians(1))
    assert sum(pose.likelihood for pose in poses) > 0.9


@pytest.mark.parametrize("spread", [1e-4, 0.05])
def test_the_farthest_point_is_that_of_all(spread):
    rng = np.random.default_rng(0)
    others = rng.uniform(size=(3000, 3)) * [1, 1, 0]
    points = others[:500] + rng.normal(scale=spread, size=(500, 3))
    assert _farthest(points, others) == pytest.approx(
        cKDTree(others).query(points)[0].max(), abs=1e-12
    )
    assert _farthest(points[:0], others) == 0.0


def test_points_seen_from_outside_do_not_depend_on_how_many_are_looked_at():
    both = join_meshes([slab((0.02, 0.02, 0.02)), slab((0.02, 0.02, 0.02), (0.03, 0, 0))])
    points = sample_surface(both, 3000, 5)
    seen = points[Voxels.of(both).is_exposed(points)]
    np.testing.assert_array_equal(sample_exposed(both, 1000, 5), seen[:1000])
    np.testing.assert_array_equal(
        sample_exposed(slab((1, 1, 1)), 100, 5, is_convex=True),
        sample_surface(slab((1, 1, 1)), 300, 5)[:100],
    )


def test_a_small_foot_keeps_corners_where_it_would_lose_much():
    angle = np.arange(8) * np.pi / 4
    ring = 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])
    post = np.concatenate([np.column_stack([ring, np.full(8, z)]) for z in (0.0, 0.05)])
    parts = [post, Mesh.points(slab((0.06, 0.06, 0.005), (0, 0.1, 0.005)).vertices).vertices]
    plain, kept = (finish_parts(parts, 12, foot_loss=loss)[0] for loss in (np.inf, 0.01))
    feet = [hull_of(each[each[:, 2] < 1e-6][:, :2]) for each in (plain, kept)]
    assert len(feet[0].vertices) == 4
    assert feet[1].volume > 1.2 * feet[0].volume
