"""Noise: nothing without it, what each term says with it, and the same again with the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE, noisy
from cluttergen_jax.sensing.camera import Camera

CAMERA = Camera.looking([0, 0, 1], [0, 0, 0], up=(0, 1, 0))
FLAT = np.full((120, 160), 0.9, np.float32)
STEP = FLAT.copy()
STEP[:, 80:] = 0.5


def drawn(depth, config, seed=0, camera=CAMERA):
    return noisy(depth, camera, config, np.random.default_rng(seed))


def test_without_noise_nothing_changes():
    depth = STEP.copy()
    depth[:5] = np.inf
    measured, camera = drawn(depth, NOISE_OFF)
    np.testing.assert_array_equal(measured, depth)
    np.testing.assert_array_equal(camera.T_world_camera, CAMERA.T_world_camera)


@pytest.mark.parametrize("distance", [0.5, 0.9, 1.5])
def test_axial_noise_has_the_spread_that_is_said(distance):
    measured, _ = drawn(
        np.full((120, 160), distance), replace(NOISE_OFF, axial=0.0012, axial_growth=0.0019)
    )
    error = measured - distance
    assert error.std() == pytest.approx(0.0012 + 0.0019 * (distance - 0.4) ** 2, rel=0.05)
    assert abs(error.mean()) < 5e-5


def test_depths_are_whole_millimetres():
    measured, _ = drawn(FLAT + 0.0003, replace(REALSENSE, patch=0.0))
    millimetres = measured[np.isfinite(measured)] * 1000
    np.testing.assert_allclose(millimetres, np.round(millimetres), atol=1e-3)
    assert len(np.unique(millimetres)) > 3


def test_lateral_noise_mixes_what_lies_beside_a_jump_and_nothing_else():
    measured, _ = drawn(STEP, replace(NOISE_OFF, lateral=2.0))
    assert (measured[:, 78:82] != STEP[:, 78:82]).mean() > 0.05
    np.testing.assert_array_equal(measured[:, :74], STEP[:, :74])
    np.testing.assert_array_equal(measured[:, 86:], STEP[:, 86:])


def test_what_is_in_front_bleeds_by_one_pixel():
    measured, _ = drawn(STEP, replace(NOISE_OFF, bleeding=0.5))
    assert (measured[:, 79] == 0.5).mean() == pytest.approx(0.5, abs=0.15)
    np.testing.assert_array_equal(np.delete(measured, 79, 1), np.delete(STEP, 79, 1))


def test_edges_drop_out():
    measured, _ = drawn(STEP, replace(NOISE_OFF, edge_dropout=0.3))
    assert np.isnan(measured[:, 79:81]).mean() == pytest.approx(0.3, abs=0.1)
    assert np.isfinite(np.delete(measured, [79, 80], 1)).all()


@pytest.mark.parametrize(("incidence", "share"), [(60.0, 0.0), (80.0, 0.5), (88.0, 0.9)])
def test_grazing_surfaces_drop_out(incidence, share):
    # A plane 1 m ahead, its normal so far from the axis; a long lens sees it at one angle.
    camera = Camera(160, 120, np.array([[1e4, 0, 80], [0, 1e4, 60], [0, 0, 1.0]]), np.eye(4))
    tilt = np.radians(incidence)
    normal = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    depth = 1 / ((camera.directions @ normal) / normal[2])
    config = replace(NOISE_OFF, grazing=70.0, jump=1.0)
    assert np.isnan(drawn(depth, config, camera=camera)[0]).mean() == pytest.approx(share, abs=0.03)


def test_a_share_of_pictures_misses_a_patch():
    config = replace(NOISE_OFF, patch=0.3)
    missing = np.array([np.isnan(drawn(FLAT, config, seed)[0]).mean() for seed in range(200)])
    assert (missing > 0).mean() == pytest.approx(0.3, abs=0.1)
    assert missing.max() <= 0.095
    assert missing[missing > 0].min() >= 0.005


def test_the_stated_pose_is_off_by_as_much_as_is_said():
    config = replace(NOISE_OFF, position=0.002, orientation=0.3)
    cameras = [drawn(FLAT, config, seed)[1] for seed in range(300)]
    shift = np.stack([camera.eye - CAMERA.eye for camera in cameras])
    np.testing.assert_allclose(shift.std(0), 0.002, rtol=0.2)
    turn = [
        np.degrees(np.arccos((np.trace(c.rotation @ CAMERA.rotation.T) - 1) / 2)) for c in cameras
    ]
    assert np.sqrt(np.mean(np.square(turn)) / 3) == pytest.approx(0.3, rel=0.1)
    np.testing.assert_array_equal(drawn(FLAT, config)[0], FLAT)


def test_a_ladder_of_noise_ends_at_none():
    assert REALSENSE.scale(1.0) == REALSENSE
    assert REALSENSE.scale(2.0).axial == pytest.approx(2 * REALSENSE.axial)
    assert REALSENSE.scale(9.0).bleeding == 1.0
    assert NOISE_OFF.grazing == 90.0
