"""COLLADA's units and images, and the material files of OBJ."""

import re

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.materials import GREY
from cluttergen_jax.importing.readers.mesh_file import material_lines
from tests.helpers.cases import CASES

DIE = (CASES / "03_dae_unit" / "inch_die.dae").read_text()
SIZES = {"inch_die": [0.019, 0.0114, 0.0076], "mm_named": [0.1, 0.06, 0.04]}


def size_of(path):
    (shape,) = read_source(path)
    return np.ptp(join_meshes([piece.mesh for piece in shape.pieces]).bounds, axis=0)


@pytest.mark.parametrize("name", SIZES)
def test_a_collada_unit_holds_alone_and_in_a_urdf(tmp_path, name):
    path = CASES / "03_dae_unit" / f"{name}.dae"
    np.testing.assert_allclose(size_of(path), SIZES[name], atol=1e-5)
    form = f'<mesh filename="{path}" scale="2"/>'
    urdf = tmp_path / "a.urdf"
    urdf.write_text(
        f'<robot><link name="a"><visual><geometry>{form}</geometry></visual></link></robot>'
    )
    np.testing.assert_allclose(size_of(urdf), 2 * np.array(SIZES[name]), atol=1e-5)


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "inch", ""])
def test_a_unit_that_is_no_length_is_refused(tmp_path, unit):
    (tmp_path / "die.dae").write_text(DIE.replace("0.0254", unit))
    with pytest.raises(AssetError, match=rf'die\.dae: <unit meter="{unit}">.*metres'):
        read_source(tmp_path / "die.dae")


def test_an_image_without_a_path_costs_no_surface():
    path = CASES / "20_dae_image_without_path" / "objects"
    np.testing.assert_allclose(size_of(path), [0.06, 0.06, 0.06])
    (shape,) = read_source(path)
    assert "no path is given" in shape.notes[0]


def colours(path):
    (shape,) = read_source(path)
    return {piece.rgba[:3] for piece in shape.pieces}


def painted(folder, use, materials, line="mtllib a.mtl"):
    text = f"{line}\nusemtl {use}\n" + trimesh.creation.box((0.1, 0.06, 0.04)).export(
        file_type="obj"
    )
    (folder / "a.obj").write_text(text)
    (folder / "a.mtl").write_text(materials)
    (shape,) = read_source(folder / "a.obj")
    return shape


def test_a_material_that_is_nowhere_defined_is_told(tmp_path):
    shape = painted(tmp_path, "blue", "newmtl red\nKd 1 0 0\n")
    assert "a.obj names material 'blue', which is nowhere defined" in shape.notes
    assert shape.pieces[0].rgba == GREY


def test_mtllib_counts_at_the_beginning_of_a_line_alone():
    text = b"# mtllib no.mtl\n \tmtllib a.mtl\r\nxmtllib no\no mtllib b.mtl\n"
    text += b"mtllib  two words.mtl # why\nmtllib a.mtl"
    assert material_lines(text) == ["a.mtl", "two words.mtl"]


def test_a_tab_behind_mtllib_is_a_space():
    assert colours(CASES / "10_obj_mtllib") == {(1.0, 0.0, 0.0)}


def test_a_material_file_whose_name_has_spaces_goes_before_two_files(tmp_path):
    (tmp_path / "my cup.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "box.obj").write_text(
        (CASES / "10_obj_mtllib" / "tab.obj").read_text().replace("tab", "my cup", 1)
    )
    assert colours(tmp_path / "box.obj") == {(1.0, 0.0, 0.0)}


QUADS = "0 1 3 2", "4 6 7 5", "0 4 5 1", "2 3 7 6", "0 2 6 4", "1 5 7 3"
SAID = '<input semantic="VERTEX" source="#vv" offset="0"/>'
LISTS = {
    "polylist": f'<polylist count="6">{SAID}<vcount>4 4 4 4 4 4</vcount><p>{" ".join(QUADS)}</p></polylist>',
    "polygons": f'<polygons count="6">{SAID}{"".join(f"<p>{each}</p>" for each in QUADS)}</polygons>',
}


@pytest.mark.parametrize("kind", LISTS)
def test_collada_polygons_are_the_triangles_that_they_hold(tmp_path, kind):
    path = tmp_path / "die.dae"
    path.write_text(re.sub("<triangles.*</triangles>", LISTS[kind], DIE))
    np.testing.assert_allclose(size_of(path), SIZES["inch_die"], atol=1e-5)
    (shape,) = read_source(path)
    assert shape.pieces[0].mesh.volume == pytest.approx(np.prod(SIZES["inch_die"]), rel=1e-3)
    hole = f'<polygons count="1">{SAID}<ph><p>0 1 3 2</p><h>4 6 7</h></ph></polygons>'
    path.write_text(path.read_text().replace("</mesh>", hole + "</mesh>"))
    said = "1 polygons with holes (<ph>) cannot be cut into triangles and are left out"
    assert said in read_source(path)[0].notes


@pytest.mark.parametrize("hole", ["4 5 6 7", "7 6 5 4"], ids=["one way round", "the other"])
def test_collada_polygons_keep_their_holes(tmp_path, hole):
    """A plate of 80 x 80 x 30 mm with a hole of 40 x 40 mm."""
    side = 0.04
    inner = 0.02
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = [(k * x, k * y, z) for z in (0.0, 0.03) for k in (side, inner) for x, y in corners]
    walls = [
        f"<p>{a} {b} {b + 8} {a + 8}</p>"
        for a, b in [(0, 1), (1, 2), (2, 3), (3, 0), (5, 4), (6, 5), (7, 6), (4, 7)]
    ]
    above = " ".join(str(int(each) + 8) for each in hole.split())
    plates = f"<ph><p>3 2 1 0</p><h>{hole}</h></ph><ph><p>8 9 10 11</p><h>{above}</h></ph>"
    text = re.sub(
        "<triangles.*</triangles>",
        f'<polygons count="10">{SAID}{"".join(walls)}{plates}</polygons>',
        DIE,
    )
    numbers = " ".join(str(each / 0.0254) for point in points for each in point)
    text = re.sub(
        r"(<float_array[^>]*count=)[^>]*>[^<]*", rf'\1"{3 * len(points)}">{numbers}', text, count=1
    )
    text = re.sub(r'(<accessor[^>]*count=)"\d+"', rf'\1"{len(points)}"', text, count=1)
    (tmp_path / "plate.dae").write_text(text)
    (shape,) = read_source(tmp_path / "plate.dae")
    assert shape.pieces[0].mesh.volume == pytest.approx(0.03 * 4 * (side**2 - inner**2))
    assert not any("<ph>" in note for note in shape.notes)
