"""Parts of machined and modelled shapes: they fill them, holes stay holes, other shapes are left alone."""

import manifold3d
import numpy as np
import pytest

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.decompose import (
    convex_pieces,
    decompose,
    exact_parts,
    outlines_around,
    signed_area,
)
from cluttergen_jax.assets.deviation import deviation, is_within_parts
from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import finish_parts, hull_of
from cluttergen_jax.assets.solid import solid_of
from tests.helpers.shapes import slab

TURN = (20, 30, 40)


def block(*size):
    return manifold3d.Manifold.cube(size, True)


def rod(radius, height, sides=64):
    return manifold3d.Manifold.cylinder(height, radius, radius, sides, True)


def solid(manifold):
    raw = manifold.to_mesh64()
    return solid_of([Mesh(raw.vert_properties[:, :3], raw.tri_verts)])


def volume_of(parts):
    return sum(hull_of(part).volume for part in parts)


def peg(radius, height):
    """Points of a round peg, on and inside of its wall."""
    angle, z = (
        each.ravel() for each in np.meshgrid(np.linspace(0, 2 * np.pi, 90), np.linspace(-1, 1, 9))
    )
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z * height / 2])
    return np.concatenate([ring, ring * [0.5, 0.5, 1]])


SHAPES = {
    "L": (block(0.10, 0.03, 0.02) + block(0.02, 0.03, 0.08).translate((-0.04, 0, 0.03)), 2),
    "U": (block(0.10, 0.06, 0.04) - block(0.12, 0.04, 0.04).translate((0, 0, 0.01)), 3),
    "bolt": (rod(0.006, 0.04) + rod(0.012, 0.008, 6).translate((0, 0, -0.024)), 2),
    "step": (rod(0.03, 0.02) + rod(0.01, 0.06), 3),
}


@pytest.mark.parametrize("name", SHAPES)
def test_layers_of_prisms_are_filled_whichever_way_they_lie(name):
    shape, count = SHAPES[name]
    found = exact_parts(solid(shape.rotate(TURN)), 32)
    assert not found.rest
    assert len(found.parts) <= count
    assert volume_of(found.parts) == pytest.approx(shape.volume(), rel=0.01)


@pytest.mark.parametrize("depth", [0.05, 0.02])
def test_a_peg_goes_into_its_hole_and_parts_are_few(depth):
    """Through the block, or 2 cm deep into it."""
    hole = rod(0.00805, depth).translate((0, 0, 0.015 - depth / 2 if depth < 0.03 else 0))
    whole = solid(block(0.05, 0.05, 0.03) - hole)
    raw = decompose(whole, DecompositionConfig())
    parts = finish_parts(raw, 12)
    assert len(parts) <= 12
    assert deviation(parts, whole) <= 0.03
    lift = 0 if depth > 0.03 else 0.005
    inside = peg(0.98 * 0.00805, 0.9 * min(depth, 0.03)) + np.array([0, 0, lift])
    assert not is_within_parts(inside, parts).any()


def test_a_shallow_recess_does_not_cost_parts():
    whole = solid(rod(0.033, 0.1) - rod(0.03, 0.006).translate((0, 0, 0.05)))
    assert not len(exact_parts(whole, 64).free)


def test_a_hole_across_is_not_lost():
    """Both holes of a plate cannot be along one axis."""
    plate = block(0.08, 0.04, 0.03) - rod(0.005, 0.1).translate((0.02, 0, 0))
    crossed = solid(plate - rod(0.005, 0.1).rotate((90, 0, 0)).translate((-0.02, 0, 0)))
    found = exact_parts(crossed, 64)
    assert len(found.rest) == 1
    assert not found.parts


def test_components_are_taken_one_by_one():
    ball = manifold3d.Manifold.sphere(0.02, 24)
    dent = ball - ball.translate((0.03, 0, 0)) - ball.translate((0, 0.03, 0.01))
    meshes = [each.to_mesh64() for each in (dent, block(0.02, 0.02, 0.02).translate((-0.02, 0, 0)))]
    found = exact_parts(
        solid_of([Mesh(each.vert_properties[:, :3], each.tri_verts) for each in meshes]), 32
    )
    assert len(found.parts) == len(found.rest) == 1
    assert volume_of(found.parts) == pytest.approx(0.02**3)


def test_a_bowl_stays_near_and_open():
    profile = [(0, 0), (0.03, 0), (0.06, 0.05), (0.057, 0.05), (0.028, 0.004), (0, 0.004)]
    whole = solid(manifold3d.CrossSection([profile]).revolve(48))
    found = exact_parts(whole, 32)
    assert not found.rest
    assert deviation(found.parts, whole) <= 0.04
    assert find_hollow(whole).fill(found.parts) <= 0.1


@pytest.mark.parametrize("seed", range(4))
def test_pieces_of_an_area_are_convex_and_fill_it(seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 24))
    radius = rng.uniform(0.05, 0.1, 24)
    star = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    hole = manifold3d.CrossSection.circle(0.02, 40)
    area = manifold3d.CrossSection([star]) - hole
    rings = outlines_around(area, 0.002, 0.05)
    pieces = convex_pieces(rings)
    assert sum(map(signed_area, pieces)) == pytest.approx(sum(map(signed_area, rings)), rel=1e-6)
    assert all(
        hull_of(each).volume == pytest.approx(signed_area(each), rel=1e-6) for each in pieces
    )
    # Around a hole, never into it.
    around = manifold3d.CrossSection(rings)
    assert (around - area).area() < 1e-9
    assert sum(len(ring) for ring in rings) < len(star) + 20


def test_a_solid_knows_whether_it_is_convex():
    assert solid_of([slab((0.01, 0.02, 0.03))]).is_convex
    assert not solid(SHAPES["L"][0]).is_convex
    thin = block(0.05, 0.05, 0.05) - rod(0.0005, 0.1)
    assert not solid(thin).is_convex
