"""Bodies: mass against hand arithmetic, parts against the mesh, frames that rest, cavities that stay open."""

import dataclasses

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.body import BodyConfig, make_object
from cluttergen_jax.assets.config import MAX_PART_VERTICES, DecompositionConfig
from cluttergen_jax.assets.deviation import deviation, is_within_parts
from cluttergen_jax.assets.mass import mass_properties
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.object import CLOUD_SIZE
from cluttergen_jax.assets.parts import (
    hull_of,
    reduce_vertices,
)
from cluttergen_jax.assets.settle import settled_turn, tilt_of
from cluttergen_jax.assets.solid import solid_of
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing.readers.primitives import cylinder, ellipsoid
from cluttergen_jax.importing.solo_stability import solo_stability, with_solo
from tests.helpers.shapes import open_box, open_box_slabs, shape_of, slab


def rotation_about(axis, degrees):
    return trimesh.transformations.rotation_matrix(np.radians(degrees), axis)[:3, :3]


# --- solids -----------------------------------------------------------------------------------------


def test_overlapping_pieces_count_once():
    a = slab((0.05, 0.02, 0.02))
    b = slab((0.05, 0.02, 0.02), (0.05, 0, 0))
    assert solid_of([a, b]).volume == pytest.approx(0.15 * 0.04 * 0.04)
    assert solid_of([join_meshes([a, b])]).is_exact


def test_a_hole_is_mended_and_a_void_is_filled():
    ball = ellipsoid(np.full(3, 0.05))
    void = ellipsoid(np.full(3, 0.02))
    holed = Mesh(ball.vertices, ball.faces[1:])
    assert solid_of([holed]).volume == pytest.approx(solid_of([ball]).volume, rel=1e-3)
    hollow = join_meshes([ball, Mesh(void.vertices, void.faces[:, ::-1])])
    assert solid_of([hollow]).volume == pytest.approx(solid_of([ball]).volume, rel=1e-6)


def test_a_soup_is_rebuilt_on_its_own_surface():
    ball = ellipsoid(np.full(3, 0.05))
    corners = ball.vertices[ball.faces]
    # Every triangle for itself, a little apart from its neighbours.
    corners = corners.mean(1, keepdims=True) + 0.97 * (corners - corners.mean(1, keepdims=True))
    soup = Mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
    solid = solid_of([join_meshes([soup, slab((0.02, 0.02, 0.02))])])
    assert not solid.is_exact
    assert solid.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.06)
    radius = np.linalg.norm(solid.mesh.vertices, axis=1)
    assert np.percentile(np.abs(radius - 0.05), 95) < 0.001


def test_nothing_with_a_volume_is_refused():
    line = Mesh([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(AssetError):
        make_object(shape_of(line))


# --- mass -------------------------------------------------------------------------------------------


def test_mass_and_inertia_of_a_box_and_a_cylinder():
    half = np.array([0.05, 0.03, 0.02])
    box = mass_properties(slab(half, (1, 2, 3)), density=500)
    assert box.mass == pytest.approx(500 * 8 * half.prod())
    np.testing.assert_allclose(box.center, [1, 2, 3])
    x, y, z = half**2
    np.testing.assert_allclose(
        box.inertia, box.mass / 3 * np.diag([y + z, x + z, x + y]), atol=1e-9
    )
    rod = mass_properties(cylinder(0.02, 0.1, sections=512), density=1, mass=2.0)
    side = 2.0 * (3 * 0.02**2 + 0.2**2) / 12
    np.testing.assert_allclose(np.diag(rod.inertia), [side, side, 2.0 * 0.02**2 / 2], rtol=1e-3)


# --- parts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_reduced_hulls_lie_inside_and_lose_little(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(300, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    few = reduce_vertices(points * [1, 0.6, 1.5])
    assert len(few) <= MAX_PART_VERTICES
    whole = hull_of(points * [1, 0.6, 1.5])
    small = hull_of(few)
    assert len(small.vertices) == len(few)
    assert is_within_parts(few * 0.999, [whole.points]).all()
    assert small.volume > 0.8 * whole.volume


# --- deviation and clouds ---------------------------------------------------------------------------


def test_deviation_of_known_offsets():
    ball = solid_of([ellipsoid(np.full(3, 0.05))])
    diagonal = 0.1 * np.sqrt(3)
    assert deviation([ball.mesh.vertices], ball) < 0.005
    assert deviation([ball.mesh.vertices * 1.1], ball) == pytest.approx(0.005 / diagonal, rel=0.15)
    spire = np.concatenate([ball.mesh.vertices, [[0, 0, 0.1]]])
    assert deviation([spire], ball) > 0.2


def test_a_filled_cavity_is_a_deviation():
    solid = solid_of(open_box_slabs())
    hull = np.concatenate([each.vertices for each in open_box_slabs()])
    assert deviation([hull], solid) > 0.2
    assert deviation([each.vertices for each in open_box_slabs()], solid) < 0.015


# --- rest -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [3, 10])
def test_a_leaning_object_gets_the_frame_in_which_it_rests(degrees):
    turn = rotation_about([1, 1, 0], degrees)
    mesh = slab((0.03, 0.04, 0.05)).transform(turn, np.array([0.3, 0.1, -0.4]))
    asset = make_object(shape_of(mesh))
    np.testing.assert_allclose(asset.half_extents[2], 0.05, atol=2e-4)
    assert asset.flags == ()
    assert tilt_of(settled_turn(asset)) < np.radians(0.5)


def test_a_toppling_object_is_flagged():
    stick = slab((0.004, 0.004, 0.1)).transform(rotation_about([0, 1, 0], 40), np.zeros(3))
    asset = make_object(shape_of(stick))
    assert any("does not stand as authored" in flag for flag in asset.flags)


def test_a_box_rests_on_its_sides_the_wide_ones_more_often():
    asset = make_object(shape_of(slab((0.05, 0.03, 0.01))))
    heights = {round(pose.height, 3): pose.likelihood for pose in asset.resting}
    assert asset.resting[0].quaternion == (1.0, 0.0, 0.0, 0.0)
    assert set(heights) <= {0.01, 0.03, 0.05}
    assert heights[0.01] + asset.resting[1].likelihood > 0.6
    rest = [pose.likelihood for pose in asset.resting[1:]]
    assert rest == sorted(rest, reverse=True)


# --- whole bodies -----------------------------------------------------------------------------------


def test_own_parts_are_kept_where_they_are_sound():
    asset = make_object(open_box())
    assert len(asset.parts) == 5
    assert asset.quality.cavity_fill < 0.05
    assert asset.quality.holds_ball
    assert asset.flags == ()
    np.testing.assert_allclose(asset.half_extents, [0.05, 0.04, 0.03], atol=1e-6)
    vertices = np.concatenate([part.vertices for part in asset.parts])
    np.testing.assert_allclose(vertices.min(0) + vertices.max(0), 0, atol=1e-6)
    assert asset.cloud.shape == (CLOUD_SIZE, 3)
    assert asset.cloud.dtype == np.float32


def test_own_parts_that_fill_the_cavity_are_replaced_by_coacd():
    slabs = open_box_slabs()
    lid = Mesh.points(np.concatenate([each.vertices for each in slabs]))
    asset = make_object(dataclasses.replace(open_box(), parts=(lid,)))
    assert len(asset.parts) > 1
    assert asset.quality.cavity_fill <= 0.2
    assert asset.quality.holds_ball
    assert asset.flags == ()


def test_settings_out_of_range_are_refused():
    with pytest.raises(ConfigError):
        DecompositionConfig(max_parts=64)
    with pytest.raises(ConfigError):
        DecompositionConfig(threshold=2)
    with pytest.raises(ConfigError):
        BodyConfig(tier="heavy")


# --- solo -------------------------------------------------------------------------------------------


def test_a_box_stands_alone_and_a_stick_on_end_does_not():
    box = with_solo(make_object(shape_of(slab((0.04, 0.03, 0.02)))), trials=64)
    assert box.quality.solo_rate == 1.0
    assert box.quality.solo_trials == 64
    assert 20 <= box.quality.solo_steps <= 60
    assert box.flags == ()
    # Tipped onto a corner, it has to fall.
    tip = rotation_about([1, 1, 0], 50)
    parts = tuple(Mesh.points(part.vertices @ tip.T) for part in box.parts)
    assert solo_stability(dataclasses.replace(box, parts=parts), 32)[0] == 0.0
