"""Fewer parts: what is nearly its hull gets few, a cavity stays open, and nothing is lost."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.decompose import decompose
from cluttergen_jax.assets.deviation import deviation
from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.merging import Nearness, Pairs, halve_parts, merge_parts
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.solid import solid_of
from cluttergen_jax.errors import ConfigError
from tests.helpers.shapes import slab


def cylinder(radius, height, at=0.0):
    turn = trimesh.transformations.translation_matrix((0, 0, at))
    return trimesh.creation.cylinder(radius, height, sections=16, transform=turn)


def solid_without(whole, *holes):
    left = trimesh.boolean.difference([whole, *holes])
    return solid_of([Mesh(left.vertices, left.faces)])


def can():
    """Its lid and its foot lie 6 mm deep, 5 % of its size."""
    return solid_without(
        cylinder(0.033, 0.1), cylinder(0.03, 0.012, 0.05), cylinder(0.03, 0.012, -0.05)
    )


def test_a_can_with_shallow_ends_has_at_most_four_parts():
    solid = can()
    parts = decompose(solid, DecompositionConfig())
    assert len(parts) <= Nearness(solid).enough == 4
    assert deviation(parts, solid) <= 0.05


def test_a_cup_has_at_most_sixteen_parts_and_stays_open():
    solid = solid_without(cylinder(0.04, 0.09), cylinder(0.036, 0.09, 0.005))
    parts = decompose(solid, DecompositionConfig())
    assert len(parts) <= Nearness(solid).enough == 16
    assert deviation(parts, solid) <= 0.05
    assert find_hollow(solid).fill(parts) <= 0.2


@pytest.mark.parametrize(("gap", "count"), [(0.0, 1), (0.001, 1), (0.03, 2)])
def test_boxes_side_by_side_are_one_where_little_lies_between_them(gap, count):
    boxes = [slab((0.03, 0.03, 0.03), (sign * (0.03 + gap / 2), 0, 0)) for sign in (-1, 1)]
    parts = [box.vertices for box in boxes]
    (fewer,) = merge_parts(parts, Nearness(solid_of(boxes)), (0.05,), enough=1, most=32)
    assert len(fewer) == count


def elbow():
    """Two bars at a right angle: its hull is far from it."""
    left = trimesh.boolean.union(
        [trimesh.creation.box((0.10, 0.02, 0.02)), moved_box((0.02, 0.02, 0.10), (-0.04, 0, 0.04))]
    )
    return solid_of([Mesh(left.vertices, left.faces)])


def moved_box(size, at):
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))


def test_what_is_far_is_halved_until_it_is_near_and_nothing_is_lost():
    solid = elbow()
    nearness = Nearness(solid)
    hull = solid.mesh.vertices
    assert nearness.distance(hull_of(hull)) > 0.1
    parts = halve_parts([hull], solid.mesh, nearness, 0.025, 64)
    assert all(nearness.distance(hull_of(part)) <= 0.025 for part in parts)
    assert sum(hull_of(part).volume for part in parts) >= 0.999 * solid.volume
    assert len(parts) < 16


def test_halving_ends_at_the_most_parts():
    solid = elbow()
    parts = halve_parts([solid.mesh.vertices], solid.mesh, Nearness(solid), 0.0, 12)
    assert 12 <= len(parts) <= 16


def nearest_by_trying_all(parts, nearness):
    """The least distance of any pair of parts, each measured."""
    return min(
        max(float(nearness.bounds(one, [other])[0]), nearness.distance(hull_of(both)))
        for one, other in combinations(parts, 2)
        for both in [np.concatenate([one, other])]
    )


def test_the_pair_that_comes_up_is_the_nearest_of_all():
    solid = elbow()
    nearness = Nearness(solid)
    parts = halve_parts([solid.mesh.vertices], solid.mesh, nearness, 0.0, 10)
    pairs = Pairs(nearness, np.inf, np.zeros((0, 3)))
    for part in parts:
        pairs.add(part)
    while len(pairs.parts) > 2:
        best = pairs.nearest(is_forced=False)
        assert best.distance == pytest.approx(
            nearest_by_trying_all(list(pairs.parts.values()), nearness)
        )
        pairs.join(best)


def test_a_hull_over_a_cavity_is_far_though_it_buries_nothing_deep():
    solid = solid_without(cylinder(0.02, 0.15), cylinder(0.016, 0.15, 0.005))
    lid = cylinder(0.016, 0.07, 0.03).vertices
    assert Nearness(solid).distance(hull_of(lid)) > 0.5


def test_fine_parts_are_nearer():
    ring = trimesh.creation.torus(0.05, 0.012, 24, 12)
    solid = solid_of([Mesh(ring.vertices, ring.faces)])
    config = DecompositionConfig(exact=False)
    standard, fine = (
        deviation(decompose(solid, replace(config, quality=quality)), solid)
        for quality in ("standard", "fine")
    )
    assert fine < 0.9 * standard


def test_an_unknown_quality_is_refused():
    with pytest.raises(ConfigError, match="standard or fine"):
        DecompositionConfig(quality="coarse")
