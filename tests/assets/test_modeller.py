"""The modeller's families: what every shape must promise before the importer measures it."""

from __future__ import annotations

import functools

import manifold3d
import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.config import MAX_PART_VERTICES
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller import parts, solids
from cluttergen_jax.assets.modeller.catalog import FAMILIES, POOLS, make_shape
from cluttergen_jax.assets.modeller.vessel import Vessel
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import AssetError, PoolError

SEEDS = (None, 1, 2)
HOLLOW = (
    "mug",
    "bowl",
    "dinner_plate",
    "water_glass",
    "wine_glass",
    "pot",
    "frying_pan",
    "colander",
    "toaster",
    "pencil_cup",
    "pen_holder",
    "letter_tray",
    "flower_pot",
    "basket",
)
cached_shape = functools.cache(make_shape)


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def hull_solid(part: Mesh) -> Manifold:
    return Manifold.hull_points(part.vertices)


def as_solid(mesh: Mesh) -> Manifold:
    faces = np.ascontiguousarray(mesh.faces, np.uint64)
    solid = Manifold(manifold3d.Mesh64(vert_properties=mesh.vertices, tri_verts=faces))
    assert not solid.is_empty()
    return solid


def bounds(meshes: list[Mesh]) -> np.ndarray:
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return np.stack([vertices.min(0), vertices.max(0)])


@pytest.fixture(
    params=[(family, seed) for family in FAMILIES for seed in SEEDS], ids=lambda p: f"{p[0]}-{p[1]}"
)
def shape(request: pytest.FixtureRequest) -> Shape:
    return cached_shape(*request.param)


def test_pieces_are_watertight_and_have_volume(shape: Shape) -> None:
    for piece in shape.pieces:
        mesh = as_trimesh(piece.mesh)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        assert all(0.0 <= channel <= 1.0 for channel in piece.rgba)


def test_parts_are_convex_and_small(shape: Shape) -> None:
    assert shape.parts
    assert len(shape.parts) <= 20
    for part in shape.parts:
        assert 4 <= len(part.vertices) <= MAX_PART_VERTICES
        hull = ConvexHull(part.vertices)
        assert len(hull.vertices) == len(part.vertices)
        assert hull.volume > 0


def test_parts_and_pieces_fill_the_same_box(shape: Shape) -> None:
    seen = bounds([piece.mesh for piece in shape.pieces])
    felt = bounds(list(shape.parts))
    assert np.abs(seen - felt).max() <= 0.05 * (seen[1] - seen[0]).max()


def test_stands_on_the_plane_with_a_base_below_its_middle(shape: Shape) -> None:
    felt = np.concatenate([part.vertices for part in shape.parts])
    low = felt[:, 2].min()
    assert low == pytest.approx(min(piece.mesh.vertices[:, 2].min() for piece in shape.pieces), abs=2e-4)
    base = ConvexHull(felt[felt[:, 2] < low + 1e-6, :2])
    volumes = np.array([as_trimesh(piece.mesh).volume for piece in shape.pieces])
    middles = np.array([as_trimesh(piece.mesh).center_mass for piece in shape.pieces])
    middle = volumes @ middles / volumes.sum()
    inside = -(base.equations[:, :2] @ middle[:2] + base.equations[:, 2])
    assert inside.min() > 0.004


def test_size_and_mass_are_those_of_household_things(shape: Shape) -> None:
    sides = np.ptp(bounds([piece.mesh for piece in shape.pieces]), axis=0)
    assert 0.02 <= sides.max() <= 0.50
    assert sides.min() >= 0.002
    assert shape.mass is not None
    assert 0.003 <= shape.mass <= 6.0
    assert shape.mass / np.prod(sides) < 8000


def test_hollow_families_say_so() -> None:
    assert {family for family in FAMILIES if cached_shape(family, None).cavity is not None} == set(HOLLOW)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("family", HOLLOW)
def test_parts_leave_the_cavity_free(family: str, seed: int | None) -> None:
    shape = cached_shape(family, seed)
    assert shape.cavity is not None
    assert shape.parts is not None
    hollow = as_solid(shape.cavity.solid)
    body = Manifold.batch_boolean([hull_solid(part) for part in shape.parts], OpType.Add)
    assert (hollow ^ body).volume() <= 0.20 * hollow.volume()
    low, high = shape.cavity.solid.bounds
    assert np.all(low[:2] < shape.cavity.mouth[:2])
    assert np.all(shape.cavity.mouth[:2] < high[:2])
    assert shape.cavity.mouth[2] >= high[2] - 1e-6


@pytest.mark.parametrize("family", FAMILIES)
def test_seeds_vary_and_repeat(family: str) -> None:
    def fingerprint(shape: Shape) -> np.ndarray:
        return np.concatenate([piece.mesh.vertices.ravel() for piece in shape.pieces])

    first, again, other = make_shape(family, 1), cached_shape(family, 1), cached_shape(family, 2)
    assert first.name == f"{family}-1"
    np.testing.assert_array_equal(fingerprint(first), fingerprint(again))
    sizes = [np.ptp(bounds([piece.mesh for piece in shape.pieces]), axis=0) for shape in (first, other)]
    assert np.abs(sizes[0] - sizes[1]).max() > 1e-4


def test_every_pool_has_ten_distinct_families() -> None:
    assert {"dining", "kitchen"} <= set(POOLS)
    for pool, families in POOLS.items():
        assert len(families) == len(set(families)) == 10, pool
    assert sum(len(families) for families in POOLS.values()) == len(FAMILIES)


def test_canonical_names_are_the_families() -> None:
    assert [cached_shape(family, None).name for family in FAMILIES] == list(FAMILIES)


def test_unknown_family_is_named() -> None:
    with pytest.raises(PoolError, match=r"no family named 'spork'.*fork"):
        make_shape("spork")


def test_ring_sectors_fill_the_regular_polygon_ring() -> None:
    wall = [(0.03, 0.0), (0.04, 0.0), (0.04, 0.1), (0.03, 0.1)]
    cells = parts.ring_sectors(wall, num=8)
    area = 0.5 * 8 * np.sin(2 * np.pi / 8) * (0.04**2 - 0.03**2)
    assert sum(ConvexHull(cell.vertices).volume for cell in cells) == pytest.approx(area * 0.1)


def test_vessel_layers_add_up_to_the_solid() -> None:
    cup = Vessel([(0.03, 0.0), (0.04, 0.09)], [(0.026, 0.006), (0.036, 0.09)])
    outside, lining = cup.layers(0.001)
    assert outside.volume() + lining.volume() == pytest.approx(cup.solid().volume(), rel=1e-6)
    room = as_trimesh(cup.cavity().solid).volume
    assert room == pytest.approx(np.pi * (0.09 - 0.006) * (0.026**2 + 0.026 * 0.036 + 0.036**2) / 3, rel=0.01)


def test_swept_bar_has_the_volume_of_a_cylinder() -> None:
    bar = solids.tube([(0, 0, 0), (0.05, 0, 0), (0.1, 0, 0)], 0.01, segments=64)
    assert bar.volume() == pytest.approx(np.pi * 0.01**2 * 0.1, rel=0.01)


def test_flat_and_crowded_parts_are_refused() -> None:
    with pytest.raises(AssetError, match="without volume"):
        parts.hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)])
    with pytest.raises(AssetError, match="at most 32"):
        parts.disc([(0.1, 0.0), (0.1, 0.1)], num=20)


def test_empty_solid_is_refused() -> None:
    with pytest.raises(AssetError, match="closed solid"):
        solids.to_mesh(Manifold())
