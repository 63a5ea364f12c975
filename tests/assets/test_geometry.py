"""What geometry on the host computes in place of SciPy, which takes long to import, against SciPy."""

import numpy as np
import pytest
from scipy.ndimage import grey_closing
from scipy.spatial import ConvexHull

from cluttergen_jax.geometry import closing, hull_area


@pytest.mark.parametrize("width", range(1, 8))
def test_gaps_are_closed_as_by_scipy(width):
    rng = np.random.default_rng(width)
    for _ in range(10):
        height = rng.normal(size=rng.integers(width, 30, 2))
        height[rng.uniform(size=height.shape) < 0.3] = -1e3
        expected = grey_closing(height, size=(width, width))
        np.testing.assert_array_equal(closing(height, width), expected)


def test_the_area_of_a_hull_is_that_of_qhull():
    rng = np.random.default_rng(0)
    for number in (3, 4, 10, 500):
        points = rng.normal(size=(number, 2)) * [1.0, 0.1] + 100
        assert hull_area(points) == pytest.approx(ConvexHull(points).volume, rel=1e-9)


def test_points_on_a_line_or_a_grid_have_the_area_that_one_expects():
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    assert hull_area(grid) == 12
    assert hull_area(np.array([[0, 0], [1, 1], [2, 2]])) == 0
    assert hull_area(np.zeros((3, 2))) == 0
