"""Antipodal pairs against arithmetic on boxes, and lines through hulls against MuJoCo's rays."""

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.downstream.robot.grasping.candidates import FRICTION, Union, sample_pairs
from tests.helpers.worlds import box
from tests.sensing.scenes import model_of

MAX_WIDTH = 0.076


@pytest.mark.parametrize("half", [(0.03, 0.02, 0.01), (0.05, 0.02, 0.036)])
def test_pairs_of_a_box_lie_on_opposite_faces_that_the_hand_spans(half):
    pairs = sample_pairs(Union(box("box", half).parts), 2000, np.random.default_rng(0), MAX_WIDTH)
    axis = np.abs(pairs.axis).argmax(1)
    assert np.allclose(np.abs(pairs.axis), np.eye(3)[axis])
    assert np.allclose(pairs.width, 2 * np.asarray(half)[axis])
    assert np.allclose(pairs.middle[np.arange(len(axis)), axis], 0)
    assert set(axis) == {side for side in range(3) if 2 * half[side] <= MAX_WIDTH}


@pytest.mark.parametrize("name", ["mug", "wine_glass"])
def test_lines_enter_where_rays_of_mujoco_hit(name):
    asset = find_pool("dining")[name]
    model = model_of([asset])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    center = data.xpos[model.body(name).id]
    rng = np.random.default_rng(3)
    start = rng.normal(size=(300, 3))
    start *= 0.4 / np.linalg.norm(start, axis=1, keepdims=True)
    aim = rng.uniform(-1, 1, (300, 3)) * asset.half_extents * 1.1 - start
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    entered = Union(asset.parts).cast(start, aim).enter.min(1)
    geom = np.zeros(1, np.int32)
    hits = [
        mujoco.mj_ray(model, data, center + s, a, None, 1, -1, geom)
        for s, a in zip(start, aim, strict=True)
    ]
    hit = np.array(hits)
    assert 30 < (hit >= 0).sum() < 300
    assert np.allclose(np.where(hit < 0, np.inf, hit), entered, atol=2e-5)


def test_far_ends_face_the_line_within_the_friction_cone():
    wedge = Mesh.points(
        np.array(
            [[x, y, z] for x in (-0.03, 0.03) for y, z in ((-0.02, 0), (0.02, 0), (0.0, 0.04))]
        )
    )
    pairs = sample_pairs(Union([wedge]), 4000, np.random.default_rng(4), MAX_WIDTH)
    slanted = np.abs(pairs.axis[:, 0]) < 0.5
    # Its slanted sides lean by 26.6 degrees each; the cone's half angle is 21.8.
    assert np.degrees(np.arctan(FRICTION)) < 26.5
    assert not slanted.any()
    assert (~slanted).any()
