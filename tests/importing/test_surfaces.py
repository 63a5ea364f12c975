"""Surfaces of furniture are found again in bare meshes: our own furniture is the oracle."""

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.assets.support import ring_area
from cluttergen_jax.assets.support_map import free_height, surface_heights
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.importing.supports import collision_of, support_with_notes
from scenes.furniture import SUPPORTS, make_support

SOURCE = Provenance("test", "Apache-2.0")
SEVERAL = [name for name in SUPPORTS if make_support(name).named and name != "dish_rack"]


def shape_of(pieces, angle=0.0):
    cos = np.cos(angle)
    sin = np.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return Shape(
        "it",
        "it",
        tuple(Piece(p.mesh.transform(turn, (1.0, -2.0, 0.3)), p.rgba) for p in pieces),
        SOURCE,
    )


def found_of(pieces, angle=0.0):
    return support_with_notes(shape_of(pieces, angle))[0]


def is_alike(own, found):
    """Whether one surface is another: height, slope, area; a found region is good all over."""
    return (
        abs(own.position[2] - found.position[2]) < 1e-3
        and abs(own.tilt - found.tilt) < 2e-3
        and abs(own.area / found.area - 1) < 0.1
    )


def check_regions(support):
    for surface in support.surfaces:
        heights = surface_heights(support, surface)
        x, y = (
            heights.origin[k] + heights.cell * (np.arange(heights.ground.shape[k]) + 0.5)
            for k in (0, 1)
        )
        xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1) - surface.region.center
        inner = np.array(surface.region.half_extents) - 0.012
        is_in = (np.abs(rotate_in_plane(xy, -surface.region.yaw)) <= inner).all(-1)
        assert np.abs(heights.ground[is_in]).max() < 1.5e-3
        assert free_height(heights, surface.region) == pytest.approx(surface.free_height, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SEVERAL)
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_our_furniture_is_found_again(name, angle):
    own = make_support(name)
    if angle and own.surfaces[0].tilt:
        angle = np.pi / 2
    found = found_of(own.pieces, angle)
    assert len(found.surfaces) == len(own.surfaces)
    for surface in own.surfaces:
        assert any(is_alike(surface, each) for each in found.surfaces), surface.name
    names = [each.name for each in found.surfaces]
    assert names == ["top", *(f"shelf_{k}" for k in range(1, len(names)))]
    check_regions(found)


def box(lower, upper):
    mesh = trimesh.creation.box(bounds=(lower, upper))
    return Piece(Mesh(mesh.vertices, mesh.faces))


def crate(is_closed):
    """A cabinet of boards of 4 cm with a shelf inside, its front open or closed."""
    boards = [
        box((-0.4, -0.3, 0.7), (0.4, 0.3, 0.74)),
        box((-0.4, -0.3, 0.0), (0.4, 0.3, 0.04)),
        box((-0.4, -0.3, 0.04), (-0.36, 0.3, 0.7)),
        box((0.36, -0.3, 0.04), (0.4, 0.3, 0.7)),
        box((-0.36, 0.26, 0.04), (0.36, 0.3, 0.7)),
        box((-0.36, -0.26, 0.34), (0.36, 0.26, 0.38)),
    ]
    return [*boards, box((-0.36, -0.3, 0.045), (0.36, -0.27, 0.695))] if is_closed else boards


@pytest.mark.slow
def test_the_inside_of_an_open_cabinet_has_surfaces_and_that_of_a_closed_one_has_none():
    assert [each.name for each in found_of(crate(True)).surfaces] == ["top"]
    found = found_of(crate(False))
    assert [round(each.position[2], 3) for each in found.surfaces] == [0.74, 0.38, 0.04]
    assert found.surfaces[1].free_height == pytest.approx(0.32, abs=1e-6)
    assert not found.parts
    check_regions(found)


def test_one_mesh_at_right_angles_becomes_boxes_of_the_same_volume():
    tool = trimesh.boolean.difference(
        [
            trimesh.creation.box(bounds=((0, 0, 0), (1, 1, 1))),
            trimesh.creation.box(bounds=((0.1, -1, 0.2), (0.8, 0.9, 0.5))),
        ],
        engine="manifold",
    )
    boxes, parts, notes = collision_of([Mesh(tool.vertices, tool.faces)], 0.0, [])
    assert not parts
    assert not notes
    volume = sum(8 * np.prod(each.half_extents) for each in boxes)
    assert volume == pytest.approx(tool.volume, rel=1e-6)
    inside = np.array([0.45, 0.4, 0.35])
    assert not any((np.abs(inside - each.center) < each.half_extents).all() for each in boxes)


def test_a_table_with_one_top_is_what_it_was_and_says_what_is_no_surface():
    table, notes = support_with_notes(shape_of(make_support("trestle_table").pieces))
    assert not table.named
    assert not table.parts
    assert any("narrower" in note for note in notes)


def test_a_pole_through_a_board_leaves_a_hole():
    pieces = [
        box((-0.4, -0.3, 0.0), (0.4, 0.3, 0.03)),
        box((-0.3, -0.2, 0.7), (0.3, 0.2, 0.72)),
        box((0.05, 0.02, 0.03), (0.11, 0.08, 0.7)),
    ]
    found = found_of(pieces)
    low = min(found.surfaces, key=lambda each: each.position[2])
    assert len(low.holes) == 1
    assert -ring_area(low.holes[0]) == pytest.approx(0.06**2, abs=0.003)
    whole = join_meshes([piece.mesh for piece in pieces])
    assert found.pieces[0].mesh.bounds[0, 2] == pytest.approx(whole.bounds[0, 2])
