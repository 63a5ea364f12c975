"""Rays against arithmetic: what they hit lies on the surface that the label names."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cluttergen_jax.sensing.camera import Camera, free, overhead
from cluttergen_jax.sensing.rays import FIRST_OBJECT, FLOOR, SUPPORT, RaySensor, sensed_model
from tests.helpers.drawing import GREEN, RED
from tests.helpers.worlds import box
from tests.sensing.scenes import TABLE, model_of, standing


@pytest.fixture(scope="module")
def model():
    return sensed_model([RED, GREEN], TABLE)


POSES = np.stack([standing(-0.1, 0.0, 0.05), standing(0.12, 0.05, 0.04)])


@pytest.mark.parametrize("surfaces", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_points_lie_on_the_surfaces_that_their_labels_name(model, surfaces, seed):
    sensor = RaySensor(model, surfaces)
    data = sensor.make_data()
    sensor.pose(data, POSES)
    camera = free(TABLE, np.random.default_rng(seed))
    image = sensor.sense(data, camera)
    points = camera.points(image.depth)
    for index, half in enumerate((0.05, 0.04)):
        mine = points[image.label == FIRST_OBJECT + index] - POSES[index, :3]
        assert len(mine) > 30
        np.testing.assert_allclose(np.abs(mine).max(-1), half, atol=1e-5)
    table = points[image.label == SUPPORT]
    on_top = np.abs(table[:, 2] - 0.7) < 1e-5
    on_side = (np.abs(np.abs(table[:, :2]) - [0.3, 0.35]) < 1e-5).any(1)
    assert (on_top | on_side).all()
    assert on_top.sum() > 1000
    floor = points[(image.label == FLOOR) & np.isfinite(image.depth)]
    np.testing.assert_allclose(floor[:, 2], 0.0, atol=1e-5)
    assert (image.depth > 0).all()
    assert ((image.geom < 0) == np.isinf(image.depth)).all()


def test_a_boxs_depth_is_the_distance_along_the_axis():
    sensor = RaySensor(model_of([box("one", (0.1, 0.1, 0.05))]), surfaces=False)
    data = sensor.make_data()
    sensor.pose(data, standing(0, 0, 0.05)[None])
    camera = overhead(TABLE)
    image = sensor.sense(data, camera)
    on_box = image.label == FIRST_OBJECT
    on_table = image.label == SUPPORT
    # Straight from above, off the axis too: only distances along the ray would grow.
    np.testing.assert_allclose(image.depth[on_box], camera.eye[2] - 0.8, atol=1e-6)
    np.testing.assert_allclose(image.depth[on_table], camera.eye[2] - 0.7, atol=1e-6)
    side = 0.2 * camera.K[0, 0] / (camera.eye[2] - 0.8)
    assert on_box.sum() == pytest.approx(side**2, rel=0.05)


def test_what_is_not_placed_is_not_seen(model):
    sensor = RaySensor(model)
    data = sensor.make_data()
    level = Camera.looking([-1.0, 0, 10.0], [1.0, 0, 10.0])
    poses = np.full((2, 7), np.nan)
    poses[1] = POSES[1]
    for is_placed, expected in (([False, False], set()), ([False, True], {FIRST_OBJECT + 1})):
        sensor.pose(data, poses, is_placed)
        assert (
            set(np.unique(sensor.sense(data, overhead(TABLE)).label)) - {FLOOR, SUPPORT} == expected
        )
        # Not even from where the parking places are in sight.
        assert set(np.unique(sensor.sense(data, level).label)) == {FLOOR}


def test_scenes_one_after_another_and_on_threads_are_alike(model):
    sensor = RaySensor(model)
    shifts = [np.array([[0.01 * k, 0, 0, 0, 0, 0, 0]] * 2) for k in range(8)]

    def sensed(shift):
        data = sensor.make_data()
        sensor.pose(data, POSES + shift)
        return sensor.sense(data, overhead(TABLE)).depth

    data = sensor.make_data()
    afresh = [sensed(shift) for shift in shifts]
    for shift, expected in zip(shifts, afresh, strict=True):
        sensor.pose(data, POSES + shift)
        np.testing.assert_array_equal(sensor.sense(data, overhead(TABLE)).depth, expected)
    with ThreadPoolExecutor(4) as threads:
        for found, expected in zip(threads.map(sensed, shifts), afresh, strict=True):
            np.testing.assert_array_equal(found, expected)
