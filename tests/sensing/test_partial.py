"""Partial maps against heights known by arithmetic: what is seen is true, what is hidden is said to be."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.assets.support_map import VOID
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.heightmap import HeightMapper
from cluttergen_jax.placement.problem import ProblemConfig, compose, region_of
from cluttergen_jax.sensing.camera import Camera, free, overhead, side
from cluttergen_jax.sensing.partial import (
    Grid,
    PartialMap,
    _height_of_rank,
    level_camera,
    merge_maps,
)
from cluttergen_jax.sensing.rays import RaySensor
from tests.helpers.worlds import box, trio
from tests.sensing.scenes import TABLE, model_of, random_boxes, standing, true_heights

GRID = Grid.of(TABLE, 0.1)
INNER = (slice(1, -1), slice(1, -1))


def seen(objects, poses, camera, support=TABLE):
    sensor = RaySensor(model_of(objects, support), surfaces=False)
    data = sensor.make_data()
    sensor.pose(data, poses)
    return sensor.sense(data, camera).depth


@pytest.mark.parametrize("seed", range(3))
def test_from_above_the_map_is_the_true_one_to_a_cell(seed):
    objects, poses, boxes = random_boxes(np.random.default_rng(seed), 6)
    # Far away, so that rays are vertical to half a cell and nothing hides anything.
    camera = Camera.looking([0, 0, 15.7], [0, 0, 0.7], 320, 320, 6000.0, up=(0, 1, 0))
    found = PartialMap.of(seen(objects, poses, camera), camera, GRID)
    true = true_heights(GRID, boxes)
    low = minimum_filter(true, 3)[INNER]
    high = maximum_filter(true, 3)[INNER]
    is_flat = high == low
    assert is_flat.mean() > 0.3
    for heights in (found.height[INNER], found.ceiling[INNER]):
        assert (heights >= low - 1e-4).all()
        np.testing.assert_allclose(heights[is_flat], true[INNER][is_flat], atol=1e-3)
    assert (found.height[INNER] <= high + 1e-4).all()
    assert (found.is_seen[INNER] | ~is_flat).all()


@pytest.mark.parametrize("seed", range(12))
def test_no_view_calls_empty_what_is_not(seed):
    rng = np.random.default_rng(seed)
    objects, poses, boxes = random_boxes(rng, 7)
    camera = free(TABLE, rng)
    found = PartialMap.of(seen(objects, poses, camera), camera, GRID)
    true = true_heights(GRID, boxes)[INNER]
    # A cell, and a pixel's height on what is steep.
    assert (found.ceiling[INNER] >= minimum_filter(true, 3) - 0.004).all()
    assert (found.ceiling >= found.height).all()
    assert (found.height[INNER] <= maximum_filter(true, 3) + 1e-4).all()
    is_seen = found.is_seen[INNER]
    assert 0.05 < is_seen.mean() < 0.95
    assert (found.height[INNER][is_seen] >= minimum_filter(true, 3)[is_seen] - 0.011).all()


def test_a_tall_box_hides_what_is_behind_it():
    camera = side(TABLE)
    found = PartialMap.of(
        seen([box("tall", (0.02, 0.06, 0.1))], standing(0, 0, 0.1)[None], camera), camera, GRID
    )
    xy = GRID.columns[..., :2]
    # By similar triangles from the eye at (-0.6, 0, 0.4 above), over the edge at x = 0.02 and 0.2 up.
    behind = (xy[..., 0] > 0.05) & (xy[..., 0] < 0.28) & (np.abs(xy[..., 1]) < 0.04)
    expected = 0.4 - (xy[..., 0] + 0.6) * (0.4 - 0.2) / 0.62
    assert behind.sum() > 100
    assert not found.is_seen[behind].any()
    # To a pixel below, and to a step and a pixel above.
    assert (found.ceiling[behind] >= expected[behind] - 0.003).all()
    assert (found.ceiling[behind] <= expected[behind] + 0.014).all()
    np.testing.assert_allclose(found.height[behind], 0.0, atol=1e-6)
    before = (xy[..., 0] < -0.05) & (np.abs(xy[..., 1]) < 0.04)
    before[[0, -1]] = False
    assert found.is_seen[before].all()
    np.testing.assert_allclose(found.ceiling[before], 0.0, atol=0.004)


def test_what_was_not_measured_hides_everything_unless_it_is_a_speck():
    camera = overhead(TABLE)
    depth = seen([box("one", (0.02, 0.02, 0.02))], standing(0.2, 0.2, 0.02)[None], camera)
    whole = PartialMap.of(depth, camera, GRID)
    specks = depth.copy()
    specks[10::20, 10::20] = np.nan
    np.testing.assert_allclose(
        PartialMap.of(specks, camera, GRID).ceiling, whole.ceiling, atol=0.03
    )
    patched = depth.copy()
    patched[40:80, 60:100] = np.nan
    found = PartialMap.of(patched, camera, GRID)
    pixels, _ = camera.project(GRID.columns)
    within = ((pixels > [64, 44]) & (pixels < [96, 76])).all(-1)
    assert within.sum() > 50
    assert not found.is_seen[within].any()
    assert (found.count[within] == 0).all()


def test_two_cameras_see_what_either_sees():
    """A wall hides its far side from each of two cameras that face each other; together they see it all."""
    wall = [box("wall", (0.02, 0.3, 0.08))], standing(0, 0, 0.08)[None]
    cameras = [Camera.looking([x, 0, 1.35], [0.0, 0.0, 0.7], 320, 240, 300.0) for x in (-0.7, 0.7)]
    maps = [PartialMap.of(seen(*wall, camera), camera, GRID) for camera in cameras]
    both = merge_maps(maps)
    x = GRID.columns[..., 0]
    y = GRID.columns[..., 1]
    within = (np.abs(y) < 0.2) & (np.abs(x) < 0.25)
    sides = within & (x > 0.05), within & (x < -0.05)
    for one, hidden, shown in zip(maps, sides, sides[::-1], strict=True):
        assert one.is_seen[shown].all()
        assert not one.is_seen[hidden & (np.abs(x) < 0.1)].any()
        assert both.is_seen[one.is_seen & within].all()
    for side_of_wall in sides:
        assert both.is_seen[side_of_wall].all()
        np.testing.assert_allclose(both.height[side_of_wall], 0.0, atol=1e-6)
        np.testing.assert_allclose(both.ceiling[side_of_wall], 0.0, atol=0.004)
    on_top = within & (np.abs(x) < 0.01)
    np.testing.assert_allclose(both.height[on_top], 0.16, atol=1e-3)
    assert (both.ceiling[on_top] >= 0.16 - 1e-3).all()


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_the_height_of_a_cell_is_that_which_so_many_points_reach(rank):
    rng = np.random.default_rng(rank)
    # Few heights, so that some are equal.
    cells = rng.integers(0, 40, 150)
    z = rng.integers(0, 6, 150).astype(np.float32)
    count = np.bincount(cells, minlength=50)
    found = _height_of_rank(cells, z, count, rank)
    for cell in range(50):
        here = sorted(z[cells == cell], reverse=True)
        assert found[cell] == (here[min(rank, len(here)) - 1] if here else VOID)


def test_the_known_top_mends_the_stated_pose():
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        objects, poses, boxes = random_boxes(rng, 5)
        camera = free(TABLE, rng)
        depth, stated = noisy(seen(objects, poses, camera), camera, REALSENSE, rng)
        is_bare = maximum_filter(true_heights(GRID, boxes), 5) == 0
        is_bare[[0, -1]] = False
        is_bare[:, [0, -1]] = False
        errors.append([])
        for used in (stated, level_camera(depth, stated, GRID)):
            # Without the bare top as a lower bound, so that what is too low is seen too.
            grid = replace(GRID, bare=np.where(GRID.bare > VOID, -0.02, VOID).astype(np.float32))
            found = PartialMap.of(depth, used, grid, median=3)
            shown = is_bare & (found.count > 0)
            assert shown.sum() > 50
            errors[-1].append(np.abs(found.height[shown]).mean())
    stated, mended = np.array(errors).T
    assert mended.mean() < 0.6 * stated.mean()
    assert mended.max() < 0.003


@pytest.mark.parametrize("rectangle", [None, Rectangle((0.05, -0.02), (0.15, 0.2), 0.4)])
def test_the_grid_is_laid_out_as_the_true_map_is(rectangle):
    support = cuboid_table(0.8, 0.7, 0.5)
    region = rectangle or support.region
    problem = compose(
        trio(), support, ProblemConfig(placement=PlacementConfig(num_objects=3), region=region)
    )
    mapper = HeightMapper.of(problem.rules.geometry, region_of(region, support))
    radius = float(
        np.linalg.norm(np.asarray(problem.rules.geometry.half_extents)[:, :2], axis=1).max()
    )
    grid = Grid.of(support, radius, region, cell=0.0072)
    assert grid.bare.shape == mapper.shape
    np.testing.assert_allclose(grid.cell, mapper.cell, rtol=1e-6)
    nothing = jnp.zeros((3, 7)), jnp.zeros(3, bool)
    true = mapper(region_of(region, support), *nothing)
    np.testing.assert_allclose(grid.corner, true.corner, atol=1e-6)
    assert ((grid.bare <= VOID) == (np.asarray(true.height) <= VOID)).mean() > 0.99
    np.testing.assert_allclose(grid.bare[grid.bare > VOID], 0.0, atol=1e-6)
