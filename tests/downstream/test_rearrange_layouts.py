"""Layouts: gaps against shapely, unlike ones against their definition, symmetry of known shapes."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from shapely.geometry import MultiPoint

pytest.importorskip("mink", reason="needs the extra robot")

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.symmetry import ROUND, turn_symmetry
from cluttergen_jax.downstream.rearrange.layouts import (
    choose_unlike,
    clearance_of,
)
from cluttergen_jax.downstream.transforms import equal_places, offset, turn_matrix
from cluttergen_jax.evaluation.diversity import embed
from cluttergen_jax.geometry import transform_points, yaw_quaternion
from tests.helpers.worlds import box, prism

OBJECTS = (
    box("box", (0.03, 0.04, 0.05)),
    prism("prism", 0.04, 0.03, sides=7),
    box("tall", (0.01, 0.01, 0.1)),
)


def drawn_poses(rng, number=3, reach=0.15):
    xy = rng.uniform(-reach, reach, (number, 2))
    return np.array(
        [
            [*place, 0.05, *yaw_quaternion(yaw)]
            for place, yaw in zip(xy, rng.uniform(0, 6, number), strict=True)
        ]
    )


def test_gaps_are_those_of_the_shadows_of_what_is_moved():
    rng = np.random.default_rng(1)
    apart = 0
    for _ in range(60):
        poses = drawn_poses(rng)
        hulls = [
            MultiPoint(transform_points(pose, asset.parts[0].vertices)[:, :2]).convex_hull
            for asset, pose in zip(OBJECTS, poses, strict=True)
        ]
        num_moved = int(rng.integers(1, 4))
        wanted = min(
            hulls[i].distance(hulls[j]) for i in range(3) for j in range(min(i, num_moved))
        )
        found = clearance_of(OBJECTS, poses, num_moved)
        apart += wanted > 0
        assert (found == 0) == (wanted == 0)
        # Edges are looked at every 5 mm.
        assert wanted - 1e-9 <= found <= np.hypot(wanted, 0.0025) + 1e-9 + 0.0025 * (wanted > 0)
    assert 10 < apart < 60


def test_unlike_layouts_are_far_from_each_other():
    rng = np.random.default_rng(2)
    poses = np.array([drawn_poses(rng) for _ in range(40)])
    region = Rectangle((0, 0), (0.15, 0.15))
    chosen = choose_unlike(OBJECTS, poses, region, 6)
    assert len(set(chosen.tolist())) == 6
    vectors = embed(OBJECTS, poses, np.ones((40, 3), bool), region, 0.0)
    distances = cdist(vectors, vectors)
    for place in range(1, 6):
        nearest = distances[chosen[:place]].min(0)
        assert nearest[chosen[place]] == pytest.approx(nearest.max())
    assert choose_unlike(OBJECTS, poses[:4], region, 6).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("asset", "order"),
    [
        (box("oblong", (0.03, 0.05, 0.04)), 2),
        (box("square", (0.04, 0.04, 0.02)), 4),
        (prism("six", 0.05, 0.03, sides=6), 6),
        (prism("round", 0.05, 0.03, sides=48), ROUND),
        (prism("seven", 0.06, 0.03, sides=7), 1),
    ],
)
def test_symmetry_of_known_shapes(asset, order):
    assert turn_symmetry(asset) == order


@pytest.mark.parametrize("order", [1, 2, 4, 5, ROUND])
def test_equal_places_are_no_error_and_others_are(order):
    place = np.eye(4)
    place[:3, 3] = 0.1, 0.2, 0.3
    equal = equal_places(place, order)
    assert np.allclose(equal[0], place)
    assert len(equal) == min(order, 8)
    for each in equal:
        assert np.allclose(offset(each, place, order), 0, atol=1e-6)
    off = place @ turn_matrix(np.radians(15))
    off[0, 3] += 0.01
    shift, turn = offset(off, place, order)
    assert shift == pytest.approx(0.01)
    assert turn == pytest.approx(0 if order == ROUND else np.radians(15), abs=1e-6)
