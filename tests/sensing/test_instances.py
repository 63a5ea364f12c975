"""Masks of single objects against shadows worked out by hand."""

import numpy as np
import pytest

from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FIRST_OBJECT, InstanceSensor
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
