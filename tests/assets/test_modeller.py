"""The modeller's families: what every shape must promise before the importer measures it."""

import functools
import hashlib
import json

import manifold3d
import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.config import MAX_PART_VERTICES
from cluttergen_jax.assets.deviation import size_alarm
from cluttergen_jax.assets.modeller import parts, solids
from cluttergen_jax.assets.modeller.catalog import FAMILIES, POOLS, make_shape
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.errors import AssetError, PoolError

SHAPES = "996a4206620cde78"
"""Digest of all families' own shapes; a change of it is a change of the embedded pools."""
NUM_CAVITIES = 14
cached_shape = functools.cache(make_shape)


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def as_solid(mesh):
    faces = np.ascontiguousarray(mesh.faces, np.uint64)
    return Manifold(manifold3d.Mesh64(vert_properties=mesh.vertices, tri_verts=faces))


def bounds(meshes):
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return np.stack([vertices.min(0), vertices.max(0)])


def summary(shape):
    """Millimetres, grams and cubic centimetres; no length that a designer would choose is near a cut."""
    solids = [piece.mesh for piece in shape.pieces] + ([shape.cavity.solid] if shape.cavity else [])
    volumes = np.array([as_trimesh(mesh).volume for mesh in solids]) * 1e6
    lengths = bounds([piece.mesh for piece in shape.pieces]) * 1000
    numbers = np.concatenate([lengths.ravel(), volumes, [shape.mass * 1000]])
    sizes = [len(part.vertices) for part in shape.parts]
    colours = [piece.rgba for piece in shape.pieces]
    return [
        shape.name,
        sizes,
        np.floor(numbers + 0.37).astype(int).tolist(),
        np.round(colours, 3).tolist(),
    ]


def test_the_shapes_of_all_families_are_those_of_this_version():
    shapes = [cached_shape(family, None) for family in FAMILIES]
    assert [shape.name for shape in shapes] == list(FAMILIES)
    assert sum(shape.cavity is not None for shape in shapes) == NUM_CAVITIES
    assert hashlib.sha256(json.dumps([*map(summary, shapes)]).encode()).hexdigest()[:16] == SHAPES


def check_surfaces(shape):
    for piece in shape.pieces:
        mesh = as_trimesh(piece.mesh)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        assert all(0.0 <= channel <= 1.0 for channel in piece.rgba)


def check_parts(shape):
    assert 1 <= len(shape.parts) <= 20
    for part in shape.parts:
        assert 4 <= len(part.vertices) <= MAX_PART_VERTICES
        hull = ConvexHull(part.vertices)
        assert len(hull.vertices) == len(part.vertices)
        assert hull.volume > 0
    seen = bounds([piece.mesh for piece in shape.pieces])
    felt = bounds(shape.parts)
    assert np.abs(seen - felt).max() <= 0.05 * (seen[1] - seen[0]).max()
    points = np.concatenate([piece.mesh.vertices for piece in shape.pieces])
    assert size_alarm(points, np.concatenate([part.vertices for part in shape.parts])) == ""


def check_stands(shape):
    felt = np.concatenate([part.vertices for part in shape.parts])
    low = felt[:, 2].min()
    assert low == pytest.approx(
        min(piece.mesh.vertices[:, 2].min() for piece in shape.pieces), abs=2e-4
    )
    base = ConvexHull(felt[felt[:, 2] < low + 1e-6, :2])
    volumes = np.array([as_trimesh(piece.mesh).volume for piece in shape.pieces])
    middles = np.array([as_trimesh(piece.mesh).center_mass for piece in shape.pieces])
    middle = volumes @ middles / volumes.sum()
    inside = -(base.equations[:, :2] @ middle[:2] + base.equations[:, 2])
    assert inside.min() > 0.004


def check_size_and_mass(shape):
    sides = np.ptp(bounds([piece.mesh for piece in shape.pieces]), axis=0)
    assert 0.02 <= sides.max() <= 0.50
    assert sides.min() >= 0.002
    assert 0.003 <= shape.mass <= 6.0
    assert shape.mass / np.prod(sides) < 8000


def check_cavity(shape):
    hollow = as_solid(shape.cavity.solid)
    body = Manifold.batch_boolean(
        [Manifold.hull_points(part.vertices) for part in shape.parts], OpType.Add
    )
    assert (hollow ^ body).volume() <= 0.20 * hollow.volume()
    low, high = shape.cavity.solid.bounds
    assert np.all(low[:2] < shape.cavity.mouth[:2])
    assert np.all(shape.cavity.mouth[:2] < high[:2])
    assert shape.cavity.mouth[2] >= high[2] - 1e-6


@pytest.mark.parametrize("draw", range(10))
def test_families_keep_their_promises_whatever_the_seed(draw):
    seeds = np.random.default_rng(draw).integers(1, 2**31, 5).tolist()
    for family, seed in zip(tuple(FAMILIES)[draw::10], seeds, strict=True):
        shape = make_shape(family, seed)
        again = make_shape(family, seed)
        own = cached_shape(family, None)
        assert shape.name == f"{family}-{seed}"
        for check in (check_surfaces, check_parts, check_stands, check_size_and_mass):
            check(shape)
            check(own)
        if shape.cavity is not None:
            check_cavity(shape)
        for a, b in zip(shape.pieces, again.pieces, strict=True):
            np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        sizes = [
            np.ptp(bounds([piece.mesh for piece in each.pieces]), axis=0) for each in (shape, own)
        ]
        assert np.abs(sizes[0] - sizes[1]).max() > 1e-4


def test_every_pool_has_ten_distinct_families():
    assert {"dining", "kitchen"} <= set(POOLS)
    for pool, families in POOLS.items():
        assert len(families) == len(set(families)) == 10, pool
    assert sum(len(families) for families in POOLS.values()) == len(FAMILIES)


def test_ring_sectors_fill_the_regular_polygon_ring():
    wall = [(0.03, 0.0), (0.04, 0.0), (0.04, 0.1), (0.03, 0.1)]
    cells = parts.ring_sectors(wall, num=8)
    area = 0.5 * 8 * np.sin(2 * np.pi / 8) * (0.04**2 - 0.03**2)
    assert sum(ConvexHull(cell.vertices).volume for cell in cells) == pytest.approx(area * 0.1)


def test_vessel_layers_add_up_to_the_solid():
    cup = Vessel([(0.03, 0.0), (0.04, 0.09)], [(0.026, 0.006), (0.036, 0.09)])
    outside, lining = cup.layers(0.001)
    assert outside.volume() + lining.volume() == pytest.approx(cup.solid().volume(), rel=1e-6)
    room = as_trimesh(cup.cavity().solid).volume
    assert room == pytest.approx(
        np.pi * (0.09 - 0.006) * (0.026**2 + 0.026 * 0.036 + 0.036**2) / 3, rel=0.01
    )


def test_what_cannot_be_modelled_is_refused():
    with pytest.raises(PoolError, match=r"no family named 'spork'.*fork"):
        make_shape("spork")
    with pytest.raises(AssetError, match="without volume"):
        parts.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    with pytest.raises(AssetError, match="at most 32"):
        parts.disc([(0.1, 0.0), (0.1, 0.1)], num=20)
    with pytest.raises(AssetError, match="closed solid"):
        solids.to_mesh(Manifold())
