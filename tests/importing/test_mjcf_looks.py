"""MJCF pictures: where MuJoCo itself draws them, and what becomes of one that is not there."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.mjcf import read_mjcf
from cluttergen_jax.importing.readers.source import make_source
from tests.helpers.drawing import needs_gl
from tests.helpers.mujoco_pictures import beside
from tests.helpers.textured import picture

CASES = Path(__file__).parents[1] / "cases" / "import"
SHAPES = {
    "box": "type='box' size='.05 .03 .02'",
    "cylinder": "type='cylinder' size='.04 .05'",
    "capsule": "type='capsule' size='.03 .04'",
    "ellipsoid": "type='ellipsoid' size='.05 .03 .02'",
    "sphere": "type='sphere' size='.03'",
    "blob": "type='mesh' mesh='blob'",
    "brick": "type='mesh' mesh='brick'",
}
QUICK = [
    ("box", "2d", True),
    ("box", "cube", True),
    ("cylinder", "2d", False),
    ("brick", "2d", False),
    ("blob", "cube", False),
]
ALL = [
    (shape, kind, uniform)
    for shape in SHAPES
    for kind in ("2d", "cube")
    for uniform in (False, True)
]
COLOURS = {
    "right": (255, 0, 0),
    "left": (0, 255, 0),
    "up": (0, 0, 255),
    "down": (255, 255, 0),
    "front": (0, 255, 255),
    "back": (255, 0, 255),
}
"""MuJoCo's names of the sides +x, -x, +y, -y, +z, -z."""


def write_model(folder, texture, geoms, material="", more=""):
    """A model of one body whose geoms wear `texture`."""
    (folder / "thing.xml").write_text(
        f"<mujoco><asset>{texture}<material name='m' texture='t' {material}/>{more}</asset>"
        f"<worldbody><body euler='20 0 0'>{geoms}</body></worldbody></mujoco>"
    )
    return folder / "thing.xml"


def write_shape(folder, shape, kind, is_uniform):
    """A picture of four colours, repeated 3 x 2 times, on a box, ball, cylinder, or mesh without uv."""
    picture().save(folder / "four.png")
    trimesh.creation.icosphere(2, 0.03).apply_scale([1, 0.7, 1.3]).export(folder / "blob.stl")
    trimesh.creation.box((0.1, 0.06, 0.04)).export(folder / "brick.stl")
    meshes = "<mesh name='blob' file='blob.stl'/><mesh name='brick' file='brick.stl'/>"
    repeat = "texrepeat='30 20' texuniform='true'" if is_uniform else "texrepeat='3 2'"
    texture = f"<texture name='t' type='{kind}' file='four.png'/>"
    geom = f"<geom {SHAPES[shape]} material='m'/>"
    return write_model(folder, texture, geom, f"rgba='1 .8 1 1' {repeat}", meshes)


@needs_gl
@pytest.mark.parametrize(
    ("shape", "kind", "is_uniform"),
    [pytest.param(*each, marks=() if each in QUICK else pytest.mark.slow) for each in ALL],
)
def test_a_picture_is_where_mujoco_draws_it(shape, kind, is_uniform, tmp_path):
    path = write_shape(tmp_path, shape, kind, is_uniform)
    source = mujoco.MjModel.from_xml_path(str(path))
    pieces = read_mjcf(make_source(path, "mjcf")).pieces
    differing, overlap = beside(source, pieces)
    # The rest are pixels at the edges between two colours.
    assert differing < 0.07
    assert overlap > 0.9


@pytest.mark.parametrize("name", ["nut_2d", "nut_cube"])
def test_a_box_is_wooden_on_all_sides(name):
    (shape,) = read_source(CASES / "15_mjcf_texture_without_uv" / "objects" / f"{name}.xml")
    (piece,) = shape.pieces
    wood = np.asarray(piece.texture.image).reshape(-1, 3) / 255
    corners = piece.mesh.corners
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        is_side = (corners @ normal >= (corners @ normal).max() - 1e-9).all(1)
        shown = piece.texture.at(piece.uv[piece.mesh.faces[is_side]].mean(1))
        assert np.ptp(piece.uv[piece.mesh.faces[is_side]].reshape(-1, 2), axis=0).min() > 0.9
        assert ((shown >= wood.min(0)) & (shown <= wood.max(0))).all()


def test_each_side_of_a_cube_map_shows_its_own_picture(tmp_path):
    for side, colour in COLOURS.items():
        Image.new("RGB", (16, 16), colour).save(tmp_path / f"{side}.png")
    files = " ".join(f"file{side}='{side}.png'" for side in COLOURS)
    path = write_model(
        tmp_path,
        f"<texture name='t' type='cube' {files}/>",
        "<geom type='box' size='.05 .03 .02' material='m'/>",
    )
    path.write_text(path.read_text().replace("euler='20 0 0'", ""))
    (piece,) = read_mjcf(make_source(path, "mjcf")).pieces
    faces = piece.mesh.faces
    shown = np.round(255 * piece.texture.at(piece.uv[faces].mean(1)))
    unit = piece.mesh.vertices[faces].mean(1) / [0.05, 0.03, 0.02]
    side = 2 * np.abs(unit).argmax(1) + (unit[np.arange(len(unit)), np.abs(unit).argmax(1)] < 0)
    np.testing.assert_array_equal(shown, np.array(list(COLOURS.values()))[side])


def test_a_missing_picture_costs_the_picture_alone():
    (shape,) = read_source(CASES / "14_mjcf_missing_image" / "objects" / "tin" / "tin.xml")
    assert [piece.texture for piece in shape.pieces] == [None]
    assert any("'label.png' cannot be read" in note for note in shape.notes)
