"""The arrow that shows where the seat of a natural scene is."""

import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.rendering.seat_mark import seat_mark, seat_points

SIDES = {"-y": (0, -1), "+y": (0, 1), "-x": (-1, 0), "+x": (1, 0)}


@pytest.mark.parametrize("seat", SIDES)
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_the_arrow_points_from_its_side_to_the_middle(seat, yaw):
    region = Rectangle(half_extents=(0.2, 0.3), center=(0.1, -0.05), yaw=yaw)
    support = cuboid_table()
    points = seat_points(region, support, seat)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    local = (points[:, :2] - region.center) @ turn
    out = local @ SIDES[seat]
    side = np.abs(SIDES[seat]) @ region.half_extents
    # The ends are at the side, the tip is nearer to the middle, all on the top.
    assert np.all((out > 0) & (out < side))
    assert out[0] == pytest.approx(out[2])
    assert out[1] < out[0]
    assert np.all((points[:, 2] > support.top) & (points[:, 2] < support.top + 0.01))


def test_without_a_seat_there_is_none():
    assert seat_mark(Rectangle(half_extents=(0.2, 0.3)), cuboid_table(), "") == ()
