"""Fewer parts: what is nearly its hull gets few, a cavity stays open, and nothing is lost."""

import pytest
import trimesh

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.decompose import decompose
from cluttergen_jax.assets.deviation import deviation
from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.merging import Nearness, merge_parts
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.solid import solid_of
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
