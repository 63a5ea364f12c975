"""Masks of single objects against shadows worked out by hand."""

import numpy as np
import pytest

from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FIRST_OBJECT, InstanceSensor, RaySensor, sensed_model
from tests.helpers.worlds import box
from tests.sensing.scenes import TABLE, standing

AHEAD = Camera.looking([-1.0, 0.0, 0.8], [0.0, 0.0, 0.8], 160, 120, 160.0)


def test_a_hidden_object_is_masked_and_not_visible():
    objects = [box("before", (0.02, 0.1, 0.1)), box("behind", (0.02, 0.05, 0.05))]
    poses = np.stack([standing(-0.1, 0, 0.1), standing(0.1, 0, 0.05)])
    image, (before, behind) = InstanceSensor(objects, TABLE, surfaces=False).sense(poses, AHEAD)
    assert behind.mask.sum() > 100
    assert behind.visible_share == 0.0
    assert before.visible_share == 1.0
    assert behind.num_pixels == behind.mask.sum()
    assert (image.label == FIRST_OBJECT + 1).sum() == 0
    assert before.mask[behind.mask].all()


def test_half_an_object_is_seen_beside_what_stands_before_it():
    objects = [box("before", (0.01, 0.1, 0.1)), box("behind", (0.01, 0.1, 0.05))]
    # From the eye, the edge of the one hides just half of the other.
    poses = np.stack([standing(-0.2, 0.1, 0.1), standing(0.2, 0, 0.05)])
    _, (_, behind) = InstanceSensor(objects, TABLE, surfaces=False).sense(poses, AHEAD)
    assert behind.visible_share == pytest.approx(0.5, abs=0.02)


def test_a_scene_and_its_objects_are_what_rays_at_all_of_it_and_at_each_alone_meet():
    """Objects that hide each other, that reach beyond the picture's edges, and one behind the camera."""
    objects = [box(name, (0.04, 0.06, 0.05)) for name in "abcdef"]
    rng = np.random.default_rng(0)
    poses = np.stack([standing(*rng.uniform(-0.3, 0.3, 2), 0.05) for _ in objects])
    poses[:, 3:] = rng.normal(size=(len(objects), 4))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    poses[4, :3] = (-0.9, 0.1, 0.9)
    poses[5, :3] = (-3.0, 0.0, 1.0)
    whole = RaySensor(sensed_model(objects, TABLE), surfaces=False)
    alone = RaySensor(sensed_model(objects, None), surfaces=False)
    for camera in (AHEAD, Camera.looking([-0.7, 0.2, 1.1], [0.1, 0.0, 0.75], 96, 128, 150.0)):
        image, instances = InstanceSensor(objects, TABLE, surfaces=False).sense(poses, camera)
        data = whole.make_data()
        whole.pose(data, poses)
        expected = whole.sense(data, camera)
        for name in ("depth", "geom", "label"):
            np.testing.assert_array_equal(getattr(image, name), getattr(expected, name))
        # A picture's size beyond each edge.
        shift = np.array([[0, 0, camera.width], [0, 0, camera.height], [0, 0, 0]])
        wide = Camera(3 * camera.width, 3 * camera.height, camera.K + shift, camera.T_world_camera)
        data = alone.make_data()
        for index, instance in enumerate(instances):
            alone.pose(data, poses, np.arange(len(objects)) == index)
            canvas = alone.sense(data, wide).geom >= 0
            inside = canvas[camera.height : 2 * camera.height, camera.width : 2 * camera.width]
            np.testing.assert_array_equal(instance.mask, inside)
            assert instance.num_pixels == canvas.sum()
