"""Cameras: projecting and back-projecting are inverse, and the presets look where they say."""

import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.sensing.camera import PRESETS, Camera, find_preset, free, overhead, side


@pytest.fixture(params=range(5))
def camera(request):
    rng = np.random.default_rng(request.param)
    looking = Camera.looking(rng.normal(size=3), rng.normal(size=3), 37, 23, rng.uniform(10, 50))
    K = looking.K * rng.uniform(0.8, 1.2, (3, 3))
    return Camera(37, 23, np.where(K == 0, 0, K / K[2, 2]), looking.T_world_camera)


def test_projection_and_back_projection_are_inverse(camera):
    depth = np.random.default_rng(1).uniform(0.2, 3.0, (23, 37))
    pixels, seen = camera.project(camera.points(depth))
    x, y = np.meshgrid(np.arange(37) + 0.5, np.arange(23) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([x, y], -1), atol=1e-9)
    np.testing.assert_allclose(seen, depth, atol=1e-12)


def test_depth_is_along_the_optical_axis_and_y_points_down(camera):
    ahead = camera.rotation[:, 2]
    points = camera.points(np.full((23, 37), 2.0))
    np.testing.assert_allclose((points - camera.eye) @ ahead, 2.0)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    assert (np.diff(points[..., 2], axis=0) < 0).all()


SUPPORTS = [cuboid_table(), cuboid_table(1.2, 0.5, 0.4)]


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("size", [(160, 120), (120, 160), (640, 480)])
def test_overhead_sees_the_whole_region_from_at_least_its_height(support, size):
    camera = overhead(support, *size, 615 / 640 * max(size))
    corners = np.column_stack([support.region.corners, np.full(4, support.top)])
    pixels, depth = camera.project(corners)
    assert (pixels >= 0).all()
    assert (pixels <= size).all()
    assert depth == pytest.approx(np.full(4, depth[0]))
    assert depth[0] >= 0.75 - 1e-9
    np.testing.assert_allclose(camera.rotation[:, 2], [0, 0, -1], atol=1e-12)


def test_the_papers_camera_is_two_half_widths_to_the_side():
    camera = side(cuboid_table())
    np.testing.assert_allclose(camera.eye, [-0.6, 0.0, 0.7 + 0.4], atol=1e-12)
    assert (camera.width, camera.height) == (224, 224)
    assert 2 * np.degrees(np.arctan(112 / camera.K[1, 1])) == pytest.approx(60)
    np.testing.assert_allclose(camera.project([0, 0, 0.7])[0], [112, 112], atol=1e-9)


def test_free_cameras_are_where_they_may_be_and_all_around():
    support = cuboid_table()
    rng = np.random.default_rng(0)
    middle = np.array([*support.region.center, support.top])
    cameras = [free(support, rng) for _ in range(400)]
    away = np.stack([camera.eye - middle for camera in cameras])
    distance = np.linalg.norm(away, axis=1)
    elevation = np.degrees(np.arcsin(away[:, 2] / distance))
    assert 0.6 <= distance.min() < 0.63 < 1.07 < distance.max() <= 1.1
    assert 25 <= elevation.min() < 27 < 63 < elevation.max() <= 65
    counts = np.histogram(np.arctan2(away[:, 1], away[:, 0]), 8, (-np.pi, np.pi))[0]
    assert counts.min() > 25
    pixels = np.stack([camera.project(middle)[0] for camera in cameras])
    assert np.abs(pixels - [80, 60]).max() < 0.03 * 3**0.5 / 0.6 * 615 / 4 * 1.1


def test_presets_follow_the_region():
    support = cuboid_table()
    moved = Rectangle((0.1, -0.05), (0.1, 0.2), 0.5)
    turned = type(support)(
        support.name, support.label, support.boxes, support.top, moved, support.provenance
    )
    for name in PRESETS:
        camera = find_preset(name)(turned, np.random.default_rng(0))
        pixel = camera.project([0.1, -0.05, support.top])[0]
        assert np.abs(pixel - [camera.width / 2, camera.height / 2]).max() < 10
