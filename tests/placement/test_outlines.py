"""Outlines of packed objects against polygons of shapely's."""

from __future__ import annotations

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from shapely import MultiPoint, Polygon, affinity
from shapely.geometry import box as rectangle

from cluttergen_jax.placement.outlines import Obstacles, Outlines

RECTANGLE = rectangle(-0.05, -0.03, 0.05, 0.03)
DISC = MultiPoint([(0, 0)]).buffer(0.04, quad_segs=24)
PAN = DISC.union(rectangle(0.03, -0.01, 0.16, 0.01))
TRIANGLE = Polygon([(-0.04, -0.03), (0.05, -0.02), (0.0, 0.05)])
SHAPES = [RECTANGLE, DISC, PAN, TRIANGLE]


def columns(shape: Polygon) -> np.ndarray:
    """f64[C, 2]: points on a grid of the shape and along its outline."""
    x, y = np.meshgrid(*[np.arange(-0.2, 0.2, 0.004)] * 2)
    grid = [p for p in np.c_[x.ravel(), y.ravel()] if shape.contains(MultiPoint([p]))]
    length = shape.exterior.length
    edge = [shape.exterior.interpolate(d).coords[0] for d in np.arange(0, length, 0.002)]
    return np.array([*grid, *edge, *shape.exterior.coords])


@pytest.fixture(scope="module")
def outlines() -> Outlines:
    points = [columns(shape) for shape in SHAPES]
    most = max(map(len, points))
    geometry = SimpleNamespace(
        column_xy=np.stack([np.pad(each, ((0, most - len(each)), (0, 0))) for each in points]),
        is_column=np.arange(most) < np.array([len(each) for each in points])[:, None],
        half_extents=np.array([[*np.abs(each).max(0), 0.01] for each in points]),
    )
    return Outlines.of(geometry)


def turned(yaw: float) -> np.ndarray:
    """f64[2, 2]: what turns rows of points."""
    return np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])


def test_outlines_are_those_of_the_shapes_and_a_handle_is_a_piece(outlines):
    for shape, corners in zip(SHAPES, np.asarray(outlines.corners), strict=True):
        pieces = [MultiPoint(piece).convex_hull for piece in corners]
        covered = pieces[0].union(pieces[1])
        assert covered.symmetric_difference(shape).area < 0.08 * shape.area
        is_one = pieces[0].symmetric_difference(pieces[1]).area < 1e-9
        assert is_one == (shape is not PAN)


def test_gaps_are_distances_and_ways_end_a_clearance_away(outlines):
    rng = np.random.default_rng(0)
    clearance = 0.003
    meetings = 0
    for _ in range(40):
        own, other = rng.integers(0, len(SHAPES), 2)
        yaw, its_yaw = rng.uniform(0, 2 * np.pi, 2)
        corners = outlines.corners[own] @ turned(yaw)
        placed = outlines.corners[other] @ turned(its_yaw)
        obstacles = Obstacles.of(
            jnp.asarray(corners, jnp.float32)[None],
            jnp.asarray(placed, jnp.float32)[None],
            jnp.array([True]),
        )
        shape = affinity.rotate(SHAPES[own], yaw, (0, 0), use_radians=True)
        still = affinity.rotate(SHAPES[other], its_yaw, (0, 0), use_radians=True)
        xy = rng.uniform(0.12, 0.3) * turned(rng.uniform(0, 2 * np.pi))[0]
        zero = jnp.zeros(1, jnp.int32)

        def distance(at, shape=shape, still=still):
            return affinity.translate(shape, *at).distance(still)

        gap = float(obstacles.least_gap(zero, jnp.asarray(xy, jnp.float32)[None])[0])
        # Never more than there is; corner to corner, and between two directions, somewhat less.
        assert gap <= distance(xy) + 0.001
        if gap < clearance:
            continue
        way = -xy / np.linalg.norm(xy)
        free = float(
            obstacles.way_free(
                zero,
                jnp.asarray(xy, jnp.float32)[None],
                jnp.asarray(way, jnp.float32),
                clearance,
            )[0]
        )
        if np.isfinite(free):
            meetings += 1
            # Sides are known along the directions alone: those of a box at an odd angle end early.
            is_round = own == other == SHAPES.index(DISC)
            most = clearance + (0.001 if is_round else 0.012)
            assert clearance - 0.001 < distance(xy + free * way) < most
    assert meetings > 20


def test_flat_sides_touch_along_their_length(outlines):
    corners = outlines.corners[:1]
    shift = jnp.array([0.0, 0.063])
    obstacles = Obstacles.of(corners, corners + shift, jnp.array([True]))
    zero = jnp.zeros(2, jnp.int32)
    # One side by side with the other, and one that is moved along it by 4 cm of its 10.
    xy = jnp.array([[0.0, 0.0], [0.04, 0.0]])
    touched = np.asarray(obstacles.contact_at(zero, xy, 0.005))
    # Each piece of what is convex is there twice: so are the pairs.
    assert touched / 4 == pytest.approx([0.1, 0.06], abs=0.002)
    far = np.asarray(obstacles.contact_at(zero, xy - 0.01, 0.005))
    assert far[0] == 0
