"""What belongs together: a model, what it names, and the pieces that lie beside it, are one object."""

from pathlib import Path

import pytest

from cluttergen_jax.importing.readers import find_sources, survey
from cluttergen_jax.importing.readers.pieces import whole_of
from tests.helpers.shapes import save_box

CASES = Path(__file__).parents[1] / "cases" / "import" / "13_pieces_beside_model"
MJCF = """<mujoco><asset><mesh name="m" file="{}"/></asset>
<worldbody><body><geom type="mesh" mesh="m" mass="0.3"/></body></worldbody></mujoco>"""


def save(folder, *files, model="", mesh="a.obj"):
    """Boxes, and perhaps a model that names one of them."""
    for file in files:
        save_box(folder / file)
    if model:
        (folder / model).parent.mkdir(parents=True, exist_ok=True)
        (folder / model).write_text(MJCF.format(mesh))


def names(folder):
    return sorted(source.name for source in find_sources(folder))


@pytest.mark.parametrize(
    ("folder", "name", "pieces"), [("with_model", "mug", 3), ("mesh_alone", "cup", 2)]
)
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
        "_cv_decomp",
        "_convex_decomposition",
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
