"""Colours at vertices are drawn: they are baked into an image, which lies on the surface as any other."""

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from cluttergen_jax.assets.body import make_object
from cluttergen_jax.assets.cloud import cloud_colours, coloured_points
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.assets.visuals import simplify_pieces
from cluttergen_jax.importing.readers import find_sources, read_shape
from cluttergen_jax.importing.readers.materials import LEFT_OUT
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from cluttergen_jax.importing.readers.source import ReadOptions
from tests.helpers.cases import CASES

RADIUS = 0.05


def shape_of(path, **options):
    (source,) = find_sources(path)
    return read_shape(source, ReadOptions(up="z", **options))


def rainbow(points):
    """u8[N, 3]: a smooth colour for each point of a ball."""
    return np.clip(127.5 * (1 + np.asarray(points) / RADIUS), 0, 255).astype(np.uint8)


def halves(points):
    """u8[N, 3]: red above, blue below."""
    return np.where(np.asarray(points)[:, 2:] > 0, [220, 20, 20], [20, 20, 220]).astype(np.uint8)


def ball(colour, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, RADIUS)
    mesh.visual.vertex_colors = np.column_stack(
        [colour(mesh.vertices), np.full(len(mesh.vertices), 255)]
    )
    return mesh


def written(folder, kind, mesh):
    path = folder / f"ball.{kind}"
    if kind == "dae":
        path.write_bytes(trimesh.exchange.dae.export_collada(mesh).replace(b"Y_UP", b"Z_UP"))
    else:
        mesh.export(path)
    return path


def away(pieces, colour):
    """How far colours of random points are from what they are to be, of 255, the greatest channel of each."""
    points, shown = zip(*(coloured_points(piece, 4000, 0) for piece in pieces), strict=True)
    points = RADIUS * trimesh.unitize(np.concatenate(points))
    return np.abs(255 * np.concatenate(shown) - colour(points)).max(1)


@pytest.mark.parametrize("name", ["two_tone.ply", "two_tone_glb.glb"])
def test_both_colours_are_seen(name, tmp_path):
    asset = make_object(shape_of(CASES / "27_vertex_colours" / name))
    assert not [note for note in asset.notes if "colour" in note]
    write_object(tmp_path / "a", asset)
    for each in (asset, read_object(tmp_path / "a")):
        colours = cloud_colours(each).astype(int)
        for colour in ([255, 0, 0], [0, 0, 255]):
            assert (np.abs(colours - colour).max(1) < 10).mean() > 0.25
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "a" / "object.xml")).ntex == 1


@pytest.mark.parametrize("kind", ["ply", "glb", "obj", "dae"])
def test_gradients_are_kept(tmp_path, kind):
    shape = shape_of(written(tmp_path, kind, ball(rainbow)))
    assert shape.notes == ()
    assert away(shape.pieces, rainbow).max() < 30
    assert away(shape.pieces, rainbow).mean() < 6
    assert max(shape.pieces[0].texture.image.size) <= 1024


@pytest.mark.parametrize(("max_texture", "most"), [(512, 6), (64, 12), (8, 40), (1, 128)])
def test_an_image_is_as_small_as_it_is_asked_to_be(tmp_path, max_texture, most):
    path = written(tmp_path, "ply", ball(rainbow))
    (piece,) = shape_of(path, max_texture=max_texture).pieces
    assert max(piece.texture.image.size) <= max_texture
    assert away([piece], rainbow).mean() < most


@pytest.mark.parametrize("colour", [rainbow, halves])
def test_colours_outlive_a_surface_of_fewer_triangles(tmp_path, colour):
    shape = shape_of(written(tmp_path, "ply", ball(colour, 5)))
    (piece,) = simplify_pieces(shape.pieces, max_textured=2000)
    assert len(piece.mesh.faces) <= 2000 < len(shape.pieces[0].mesh.faces)
    assert max(piece.texture.image.size) <= 1024
    # Next to the edge of two colours a point may have the other's.
    assert np.quantile(away([piece], colour), 0.95) < 25


def test_faces_with_colours_of_their_own(tmp_path):
    box = trimesh.creation.box((0.1, 0.08, 0.06))
    colours = np.zeros((12, 4), np.uint8)
    colours[:] = [0, 200, 0, 255]
    colours[:2] = [200, 0, 0, 255]
    box.visual.face_colors = colours
    box.export(tmp_path / "box.ply")
    (piece,) = shape_of(tmp_path / "box.ply").pieces
    _, near = cKDTree(box.triangles_center).query(piece.mesh.corners.mean(1))
    shown = 255 * piece.texture.at(piece.uv[piece.mesh.faces].mean(1))
    np.testing.assert_allclose(shown, colours[near, :3], atol=1)


def test_one_colour_for_all_needs_no_image(tmp_path):
    even = ball(lambda points: np.tile(np.array([[30, 90, 150]], np.uint8), (len(points), 1)))
    (piece,) = shape_of(written(tmp_path, "ply", even)).pieces
    assert piece.texture is None
    np.testing.assert_allclose(255 * np.array(piece.rgba), [30, 90, 150, 255], atol=1)


def test_alpha_is_one_for_all(tmp_path):
    mesh = ball(rainbow)
    colours = mesh.visual.vertex_colors.copy()
    colours[:, 3] = 128
    mesh.visual.vertex_colors = colours
    (piece,) = shape_of(written(tmp_path, "ply", mesh)).pieces
    np.testing.assert_allclose(piece.rgba, [1, 1, 1, 0.502], atol=1e-3)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a"], ()),
        (
            ["a", "b"],
            ("the colours of its materials are left out: those of its vertices are taken",),
        ),
    ],
)
def test_an_obj_file_s_vertices_go_before_plain_materials(tmp_path, names, said):
    text = written(tmp_path, "obj", ball(rainbow)).read_text()
    for name in names:
        text = text.replace("\nf ", f"\nusemtl {name}\nf\t", 1)
    (tmp_path / "ball.obj").write_text(f"mtllib ball.mtl\n{text}")
    (tmp_path / "ball.mtl").write_text("newmtl a\nKd 0.75 0.75 0.75\nnewmtl b\nKd 1 0 0\n")
    pieces, notes, _ = read_mesh_file(tmp_path / "ball.obj")
    assert notes == said
    assert all(piece.colours is not None for piece in pieces)


def test_where_an_image_may_lie_it_is_said_that_vertices_lose(tmp_path):
    text = written(tmp_path, "obj", ball(rainbow)).read_text()
    text = text.replace("\nf ", "\nvt 0 0\nusemtl a\nf ", 1)
    (tmp_path / "ball.obj").write_text(f"mtllib ball.mtl\n{text}")
    (tmp_path / "ball.mtl").write_text("newmtl a\nKd 1 0 0\n")
    _, notes, _ = read_mesh_file(tmp_path / "ball.obj")
    assert LEFT_OUT in notes
