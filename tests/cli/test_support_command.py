"""`cluttergen import --support`: a table's file becomes a support that can be named like any other."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.support_file import find_support, user_supports
from cluttergen_jax.cli.main import main
from cluttergen_jax.rendering.picture import distinct_colour
from cluttergen_jax.scene.bank import read_bank
from scenes.furniture import make_support

pytestmark = pytest.mark.usefixtures("home")
DESK = make_support("drawer_desk")


@pytest.fixture
def file(tmp_path):
    """A desk of our own as a bare mesh, in centimetres, somewhere."""
    mesh = join_meshes([piece.mesh for piece in DESK.pieces])
    path = tmp_path / "Old Desk.obj"
    trimesh.Trimesh(100 * (mesh.vertices + np.array([3, -2, 0])), mesh.faces, process=False).export(
        path
    )
    return path


def area(support):
    return float(np.prod(support.region.half_extents))


def test_a_table_is_imported_listed_and_carries_objects(file, tmp_path, capsys):
    assert main(["import", "--support", str(file), "--scale", "0.01"]) == 0
    assert "--support old_desk" in capsys.readouterr().out
    found = find_support("old_desk")
    assert found.top == pytest.approx(DESK.top, abs=1e-5)
    assert area(found) == pytest.approx(area(DESK), rel=0.05)
    assert main(["list"]) == 0
    assert "  old_desk\n" in capsys.readouterr().out
    bank = tmp_path / "bank"
    asked = [
        "--support",
        "old_desk",
        "--objects",
        "soup_can",
        "--method",
        "random",
        "--max-files",
        "0",
    ]
    assert main(["generate", "-n", "4", *asked, "--out", str(bank)]) == 0
    scenes = read_bank(bank)
    assert scenes.support.name == "old_desk"
    assert scenes.table.num_rows == 4
    for scene in scenes.scenes():
        assert scene.is_success
        assert scene.poses[0, 2] > found.top


def test_a_name_stands_for_one_table(file, tmp_path, capsys):
    asked = ["import", "--support", str(file), "--scale", "0.01", "--name", "mine"]
    assert main(asked) == 0
    assert main(asked) == 0
    stool = tmp_path / "stool.stl"
    trimesh.creation.box((0.3, 0.4, 0.5)).export(stool)
    other = ["import", "--support", str(stool), "--name", "mine"]
    assert main(other) == 2
    assert "--force" in capsys.readouterr().err
    assert find_support("mine").top == pytest.approx(DESK.top, abs=1e-5)
    assert main([*other, "--force"]) == 0
    assert find_support("mine").top == pytest.approx(0.5)
    np.testing.assert_allclose(
        sorted(find_support("mine").region.half_extents), [0.15, 0.2], atol=1e-6
    )
    assert [each.name for each in user_supports().iterdir()] == ["mine"]


def test_a_support_is_inspected_by_name(tmp_path, capsys):
    assert main(["inspect", "bookcase"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines[2:]] == ["top", "shelf_1", "shelf_2", "shelf_3"]
    assert "open" in lines[2]
    assert "0.316 m" in lines[3]
    assert main(["inspect", "table-0.40x0.50"]) == 0
    assert "0.200 m^2" in capsys.readouterr().out
    assert main(["inspect", "bookcase", "--grasps"]) == 2
    assert main(["inspect", "bookcase", "--out", str(tmp_path / "page.html")]) == 2
    assert not list(tmp_path.iterdir())
    assert main(["inspect", "book_case"]) == 2


@pytest.mark.slow
def test_surfaces_are_drawn_and_numbered(tmp_path):
    assert main(["inspect", "bookcase", "--out", str(tmp_path / "it.png")]) == 0
    image = np.asarray(Image.open(tmp_path / "it.png"))
    first = (255 * np.array(distinct_colour(0)[:3])).round()
    assert (np.abs(image.astype(int) - first).max(-1) < 12).sum() > 200
