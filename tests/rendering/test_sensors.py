"""Depth, segmentation and clouds against geometry: what is measured lies on the surfaces that were drawn."""

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.rendering.assets import close_points, scene_spec
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.sensing.camera import Camera, free, overhead, side
from cluttergen_jax.sensing.rays import FLOOR, SUPPORT, RaySensor
from tests.helpers.drawing import needs_gl


@needs_gl
@pytest.mark.parametrize("name", ["overhead", "side", "free", "off-centre"])
def test_rays_and_opengl_see_the_same(name):
    dining = find_pool("dining")
    objects = [dining[each] for each in ("mug", "dinner_plate", "fork")]
    support = cuboid_table()
    poses = np.array(
        [
            [x, y, 0.7 + each.half_extents[2], 0.8, 0, 0, 0.6]
            for each, (x, y) in zip(objects, ((-0.1, 0.05), (0.12, 0.0), (0.0, -0.2)), strict=True)
        ]
    )
    camera = {"overhead": overhead(support), "side": side(support)}.get(name) or free(
        support, np.random.default_rng(5), 320, 240, 307.5
    )
    if name == "off-centre":
        # No picture of a real camera has its axis exactly in its middle, nor quite square pixels.
        K = np.array([[300.0, 0, 171.3], [0, 310.0, 108.9], [0, 0, 1]])
        camera = Camera(320, 240, K, camera.T_world_camera)
    picture = PictureConfig(width=camera.width, height=camera.height, samples=1)
    points = close_points(objects, poses, support)
    with open_scene_renderer(objects, support, points, picture) as renderer:
        renderer.camera = camera
        drawn = renderer.measure([RenderStyle(pose) for pose in poses])
    spec, _ = scene_spec(objects, poses, support)
    sensor = RaySensor(spec.compile())
    data = sensor.make_data()
    sensor.pose(data, poses)
    cast = sensor.sense(data, camera)
    shifted = np.stack(
        [np.roll(cast.label, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    )
    is_inside = np.zeros_like(cast.label, bool)
    is_inside[1:-1, 1:-1] = True
    assert (shifted == drawn.label).any(0)[is_inside].all()
    assert set(np.unique(cast.label)) == {FLOOR, SUPPORT, 2, 3, 4}
    far = np.where(np.isfinite(cast.depth), cast.depth, 1e3)
    around = np.stack([np.roll(far, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    is_smooth = is_inside & (np.ptp(around, axis=0) < 0.02) & (np.ptp(shifted, axis=0) == 0)
    is_smooth &= far < 20
    assert is_smooth.mean() > 0.5
    np.testing.assert_allclose(drawn.depth[is_smooth], cast.depth[is_smooth], atol=0.001)
    # Nor is the one a fraction of a pixel beside the other.
    assert (drawn.label != cast.label).mean() < 0.003
