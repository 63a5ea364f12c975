"""Actions, poses and regions: round trips, frames, containment."""

import hypothesis.strategies as st
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

from cluttergen_jax.placement.region import (
    KeepOut,
    action_of_pose,
    from_pose,
    is_inside,
    is_kept_out,
    make_region,
    pose_of_action,
)

UNIT = st.floats(0.01, 0.99)


@settings(max_examples=30, deadline=None)
@given(action=st.tuples(UNIT, UNIT, UNIT, UNIT), yaw=st.floats(-3, 3), x=st.floats(-1, 1))
def test_action_and_pose_are_inverse(action, yaw, x):
    region = make_region(jnp.array([x, 0.2]), jnp.array([0.3, 0.1]), yaw, 0.7)
    pose = from_pose(pose_of_action(jnp.array(action), region, 0.25))
    local = region.T_world_region.inverse() @ pose
    turn = local.rotation().compute_yaw_radians()
    again = action_of_pose(local.translation(), turn, region, 0.25)
    np.testing.assert_allclose(again, action, atol=2e-5)


@pytest.mark.parametrize(
    ("x", "center", "footprint"), [(0.0, True, True), (0.29, True, False), (0.31, False, False)]
)
def test_containment(x, center, footprint):
    region = make_region(jnp.zeros(2), jnp.array([0.3, 0.2]), 0.0, 0.7)
    pose = jnp.array([x, 0.0, 0.75, 1.0, 0.0, 0.0, 0.0])
    half = jnp.array([0.05, 0.02, 0.05])
    assert bool(is_inside(pose, half, region, "center")) is center
    assert bool(is_inside(pose, half, region, "footprint")) is footprint


def test_keep_out_never_misses_an_overlap():
    rng = np.random.default_rng(0)
    keep = KeepOut(jnp.array([[0.1, 0.0]]), jnp.array([[0.05, 0.1]]), jnp.array([0.4]))
    half = jnp.array([0.06, 0.02, 0.05])
    side = np.array([np.cos(0.4), np.sin(0.4)])
    met = 0
    for _ in range(200):
        yaw = rng.uniform(0, 6.28)
        xy = rng.uniform(-0.3, 0.3, 2)
        pose = jnp.array([*xy, 0.75, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
        grid = np.stack(np.meshgrid(np.linspace(-0.06, 0.06, 25), np.linspace(-0.02, 0.02, 9)), -1)
        c = np.cos(yaw)
        s = np.sin(yaw)
        points = grid.reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + xy - np.array([0.1, 0.0])
        local = np.stack([points @ side, points @ np.array([-side[1], side[0]])], -1)
        overlaps = (np.abs(local) < [0.05, 0.1]).all(1).any()
        if overlaps:
            met += 1
            assert bool(is_kept_out(pose, half, keep))
    assert met > 20
    far = jnp.array([-0.2, 0.0, 0.75, 1.0, 0.0, 0.0, 0.0])
    assert not bool(is_kept_out(far, half, keep))
