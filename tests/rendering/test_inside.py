"""Cameras that look into open furniture."""

import numpy as np
import pytest

from cluttergen_jax.assets.doors import are_to_be_closed
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.sensing import InstanceSensor
from cluttergen_jax.views.inside import inside_camera, opening_side
from tests.helpers.drawing import RED


@pytest.mark.parametrize("name", ["shelf_1", "drawer"])
def test_the_camera_sees_what_stands_behind_doors_and_in_drawers(name):
    support = find_support("cupboard")
    assert are_to_be_closed(support)
    assert opening_side(support) == pytest.approx(-np.pi / 2, abs=0.1)
    surface = next(each for each in support.named if each.name == name)
    pose = np.array([*surface.region.center, 0.0, 1.0, 0.0, 0.0, 0.0])
    pose[:3] += surface.position
    pose[2] += RED.half_extents[2]
    camera = inside_camera([RED], pose[None], support, PictureConfig(width=160, height=120))
    _, (instance,) = InstanceSensor([RED], support).sense(pose[None], camera)
    assert instance.visible_share > 0.6
    # All of the furniture is in the picture.
    points = np.concatenate([piece.mesh.vertices for piece in support.collision_pieces])
    pixels, depth = camera.project(points)
    assert (depth > 0).all()
    assert ((pixels >= 0) & (pixels <= [160, 120])).all()
