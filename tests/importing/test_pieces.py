"""What belongs together: a model, what it names, and the pieces that lie beside it, are one object."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cluttergen_jax.cli.import_ import Import, print_report
from cluttergen_jax.importing.readers import find_sources, read_shape, survey
from cluttergen_jax.importing.readers.pieces import whole_of
from cluttergen_jax.importing.readers.tree import Skipped
from cluttergen_jax.importing.run import ImportReport

CASES = Path(__file__).parents[1] / "cases" / "import" / "13_pieces_beside_model"
MJCF = """<mujoco><asset><mesh name="m" file="{}"/></asset>
<worldbody><body><geom type="mesh" mesh="m" mass="0.3"/></body></worldbody></mujoco>"""


def save_box(path, side=0.05):
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((side, side, side)).export(path)


def save(folder, *files, model="", mesh="a.obj"):
    """Boxes, and perhaps a model that names one of them."""
    for file in files:
        save_box(folder / file)
    if model:
        (folder / model).parent.mkdir(parents=True, exist_ok=True)
        (folder / model).write_text(MJCF.format(mesh))


def names(folder):
    return sorted(source.name for source in find_sources(folder))


@pytest.mark.parametrize(("folder", "name", "pieces"), [("with_model", "mug", 3), ("mesh_alone", "cup", 2)])
def test_files_called_after_an_object_are_pieces_of_it(folder, name, pieces):
    found = survey(CASES / folder)
    assert [source.name for source in found.sources] == [name]
    assert [each.is_piece for each in found.skipped] == [True] * pieces
    assert all(f"a piece of {name}." in each.reason for each in found.skipped)


@pytest.mark.parametrize(
    "tail",
    [
        "_col",
        "_collision",
        "_coll",
        "_vhacd",
        "_coacd",
        "_convex",
        "_hull",
        "_site",
        "_vis",
        "-visual",
        "_textured",
        ".coacd",
        "_collision_0",
        "_coacd_part_12",
        "_vhacd3",
        "_convex_hull_2",
        "_part_3",
        "-part-4",
        "_collision_mesh",
        "_Visual",
    ],
)
def test_every_spelling_of_a_piece_is_known(tail, tmp_path):
    assert whole_of(f"blue_mug{tail}") == "blue_mug"
    save(tmp_path, "blue_mug.obj", f"blue_mug{tail}.stl", "bowl.obj")
    assert names(tmp_path) == ["blue_mug", "bowl"]


@pytest.mark.parametrize("name", ["thing_0", "colander", "mug_collar", "site", "visual_aid", "apart-3"])
def test_other_names_are_no_pieces(name):
    assert not whole_of(name)


@pytest.mark.parametrize("folder", ["collision", "visual", "convex", "vhacd", "collision_meshes"])
def test_folders_of_pieces_hold_no_objects(tmp_path, folder):
    save(tmp_path, "mug.obj", f"{folder}/0.obj", f"{folder}/mug.obj", f"{folder}/other.stl")
    assert names(tmp_path) == ["mug"]


def test_what_is_seen_stands_for_what_is_there_in_pieces_alone(tmp_path):
    save(tmp_path, "mug/visual/mug.obj", "mug/collision/mug_0.obj", "mug/collision/mug_1.obj")
    save(tmp_path, "cup_vis.obj", "cup_col.obj", "cup_coacd_0.obj")
    assert names(tmp_path) == ["cup", "mug"]


def test_a_piece_without_a_whole_is_an_object(tmp_path):
    save(tmp_path, "mug_col.obj", "pan_textured.stl", "small_0.obj", "small_1.obj")
    assert names(tmp_path) == ["mug_col", "pan_textured", "small_0", "small_1"]


def test_a_folder_called_after_its_model_holds_its_pieces(tmp_path):
    save(tmp_path / "rack", "boards.obj", "rack_stand.obj", "rack_3.obj", model="rack.xml", mesh="boards.obj")
    (tmp_path / "rack" / "rack_boards.xml").write_text(MJCF.format("rack_stand.obj"))
    save(tmp_path / "pot", "visual.obj", "lid.obj", model="model.xml", mesh="visual.obj")
    (tmp_path / "pot" / "model_orig.xml").write_text(MJCF.format("visual.obj"))
    assert names(tmp_path) == ["pot", "rack"]


def test_meshes_that_no_model_names_are_no_objects_beside_those_of_models(tmp_path):
    """As in robosuite: `objects/meshes` has the meshes of `objects/*.xml`, some left over."""
    save(tmp_path, "meshes/a.obj", "meshes/a.stl", "meshes/cube.obj", model="can.xml", mesh="meshes/a.stl")
    (tmp_path / "can-visual.xml").write_text(MJCF.format("meshes/a.stl"))
    assert names(tmp_path) == ["can"]


@pytest.mark.parametrize(
    "text",
    [
        MJCF.format("a.obj").replace("</body>", ""),
        MJCF.format("a.obj")[:60],
        "<<<" + MJCF.format("a.obj"),
        MJCF.format("a.obj").replace("</asset>", '<texture name="t" file="gone.png"/></asset>'),
        f"<mujocoinclude>{MJCF.format('a.obj')}</mujocoinclude>",
        '<robot><link name="l"><visual><geometry><mesh filename="a.obj"/></geometry></visual></link>',
    ],
)
def test_a_model_that_cannot_be_read_still_owns_what_it_names(tmp_path, text):
    save(tmp_path, "a.obj", "b.obj")
    (tmp_path / ("c.urdf" if "<robot" in text else "c.xml")).write_text(text)
    assert "a" not in names(tmp_path)
    assert "b" in names(tmp_path)


def test_parts_of_mjcf_are_no_failures(tmp_path):
    save(tmp_path, "a.obj", model="mug.xml")
    (tmp_path / "looks.xml").write_text('<mujoco><asset><mesh name="b" file="a.obj"/></asset></mujoco>')
    (tmp_path / "body.xml").write_text("<mujocoinclude><body/></mujocoinclude>")
    (tmp_path / "lights.xml").write_text("<mujoco><worldbody><light/></worldbody></mujoco>")
    found = survey(tmp_path)
    assert [source.name for source in found.sources] == ["mug"]
    assert {each.reason for each in found.skipped} == {"a part of MJCF models, made to be included"}


def test_windows_paths_are_followed(tmp_path):
    save(tmp_path, "parts/a.obj", "parts/b.obj")
    (tmp_path / "assets.xml").write_text('<mujoco><asset><mesh file="parts\\a.obj"/></asset></mujoco>')
    world = "<worldbody><body/></worldbody>"
    (tmp_path / "mug.xml").write_text(f'<mujoco><include file=".\\assets.xml"/>{world}</mujoco>')
    assert names(tmp_path) == ["b", "mug"]


def test_a_mesh_in_mujocos_own_format_is_read(tmp_path):
    box = trimesh.creation.box((0.04, 0.06, 0.08))
    head = struct.pack("4i", len(box.vertices), 0, 0, len(box.faces))
    data = box.vertices.astype("f4").tobytes() + box.faces.astype("i4").tobytes()
    (tmp_path / "box.msh").write_bytes(head + data)
    (tmp_path / "loose.msh").write_bytes(b"")
    (tmp_path / "carton.xml").write_text(MJCF.format("box.msh"))
    (source,) = find_sources(tmp_path)
    (piece,) = read_shape(source).pieces
    np.testing.assert_allclose(np.ptp(piece.mesh.vertices, axis=0), [0.04, 0.06, 0.08], atol=1e-6)


def test_pieces_are_counted_in_one_line(capsys):
    skipped = tuple(Skipped(f"f/mug_col_{i}.obj", "by its name a piece of mug.obj", True) for i in range(38))
    print_report(
        ImportReport(None, (), 0, (), (*skipped, Skipped("f/notes.txt", "not a mesh format"))), Import
    )
    told = capsys.readouterr().out
    assert "38 files are pieces of these objects" in told
    assert "1 skipped:" in told
    assert "mug_col_3" not in told
