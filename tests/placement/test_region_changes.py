"""Queried regions changed at random: within their ranges, on their table, with as much area as fits."""

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.placement.region import REGION_CHANGES, ChangedRegion, find_change


def draws(name, base, bounds, number=400):
    keys = jax.random.split(jax.random.key(7), number)
    region = jax.vmap(ChangedRegion(find_change(name), base, bounds, 0.7))(keys)
    pose = np.asarray(region.T_world_region.wxyz_xyz, np.float64)
    return (
        pose[:, 4:6],
        np.asarray(region.half_extents, np.float64),
        2 * np.arctan2(pose[:, 3], pose[:, 0]),
    )


BASE = Rectangle(half_extents=(0.30, 0.35))
LARGE = Rectangle(half_extents=(0.70, 0.70))


@pytest.mark.parametrize("name", REGION_CHANGES)
def test_changed_regions_stay_in_their_ranges(name):
    change = REGION_CHANGES[name]
    far = Rectangle(half_extents=(9.0, 9.0))
    center, half, yaw = draws(name, BASE, far)
    yaw = np.mod(yaw + np.pi, 2 * np.pi) - np.pi
    growth = half - np.array(BASE.half_extents)
    for values, low, high in (
        (center, -change.translation, change.translation),
        (yaw, -change.rotation, change.rotation),
        (growth, -change.shrinkage, change.expansion),
    ):
        assert values.min() >= low - 1e-6
        assert values.max() <= high + 1e-6
        # Four hundred uniform draws come close to both ends of their range.
        assert np.ptp(values) >= 0.95 * (high - low)


def test_turned_regions_keep_the_most_area():
    bounds = Rectangle(half_extents=(0.75, 0.325))
    _, half, yaw = draws("rotation", bounds, bounds)
    cos = np.abs(np.cos(yaw))
    sin = np.abs(np.sin(yaw))
    # Across the table nothing is left of the long side but the table's depth; the short side stays.
    across = cos < 0.02
    assert across.any()
    np.testing.assert_allclose(half[across], [[0.325, 0.325]] * across.sum(), rtol=0.05)
    for k in range(0, len(half), 20):
        a, b = np.meshgrid(np.linspace(0.001, 0.75, 400), np.linspace(0.001, 0.325, 400))
        fits = (cos[k] * a + sin[k] * b <= 0.75) & (sin[k] * a + cos[k] * b <= 0.325)
        assert half[k].prod() >= 0.99 * (a * b)[fits].max()
