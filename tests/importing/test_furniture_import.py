"""Furniture as files have it: on its edge, of several bodies, long, with drawers of thin walls."""

import numpy as np
import pytest
import trimesh

from cluttergen_jax import import_support
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing.furniture import choose_up, find_furniture, looks_of, read_upright
from cluttergen_jax.importing.readers import ReadOptions
from cluttergen_jax.importing.readers.source import turn_of
from cluttergen_jax.importing.run import import_sources
from cluttergen_jax.importing.supports import AirBox, air_over, support_with_notes, without_air
from scenes.furniture import SUPPORTS, make_support
from tests.helpers.cases import CASES

pytestmark = pytest.mark.usefixtures("home")
ON_EDGE = CASES / "29_table_on_edge" / "zup_table.glb"
OF_BODIES = CASES / "30_furniture_of_bodies" / "desk.xml"
PARTNET = CASES / "26_partnet_joint_90" / "45001"
TABLES = ["trestle_table", "picnic_table", "coffee_table", "round_table", "l_desk"]


def sides(support):
    return sorted(2 * half for half in support.region.half_extents)


# -- Which way up.


def test_a_table_on_its_edge_is_stood_up_and_that_is_said(capsys):
    assert main(["import", "--support", str(ON_EDGE)]) == 0
    said = capsys.readouterr().err
    assert "stood up by its shape, its z axis up" in said
    assert "--up file" in said
    support = find_support("zup_table")
    assert sides(support) == pytest.approx([0.7, 1.2], abs=0.01)
    assert support.top == pytest.approx(0.73, abs=0.01)


def test_an_axis_that_is_asked_for_is_kept_with_an_alarm(capsys):
    assert main(["import", "--support", str(ON_EDGE), "--up", "file"]) == 0
    assert "ALARM: its largest surface is 5 cm wide" in capsys.readouterr().err
    assert sides(find_support("zup_table"))[0] < 0.15


def mesh_of(name):
    return join_meshes([piece.mesh for piece in make_support(name).pieces])


# Sloping boards are looked at again, see `read_upright`.
STANDING = [name for name in SUPPORTS if make_support(name).pieces and "tilted" not in name]


@pytest.mark.parametrize(
    "name",
    [name if name in TABLES else pytest.param(name, marks=pytest.mark.slow) for name in STANDING],
)
def test_our_furniture_stays_as_it_is_stated_whichever_axis_that_is(name):
    for axis in ("z", "y"):
        # The mesh is upright whatever its file's axis was called.
        assert choose_up(looks_of(mesh_of(name), axis), axis, True) == (axis, [])


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize(("stated", "is_stated"), [("y", True), ("-x", True), ("z", False)])
def test_a_table_whose_file_has_another_axis_up_is_stood_up(name, stated, is_stated):
    true = "z" if stated != "z" else "y"
    # From upright to the file's frame, and from there to what the stated axis makes of it.
    turn = turn_of(stated) @ turn_of(true).T
    lying = mesh_of(name).transform(turn, np.zeros(3))
    axis, notes = choose_up(looks_of(lying, stated), stated, is_stated)
    assert axis == true
    assert len(notes) == 1


def test_a_table_on_its_top_is_turned_over_and_a_tray_is_not():
    table = mesh_of(TABLES[0]).transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    assert choose_up(looks_of(table, "z"), "z", True)[0] == "-z"
    outer = trimesh.creation.box(bounds=((-0.3, -0.2, 0), (0.3, 0.2, 0.3)))
    inner = trimesh.creation.box(bounds=((-0.28, -0.18, 0.02), (0.28, 0.18, 0.4)))
    crate = trimesh.boolean.difference([outer, inner], engine="manifold")
    assert choose_up(looks_of(Mesh(crate.vertices, crate.faces), "z"), "z", True) == ("z", [])


def test_a_block_that_says_nothing_keeps_what_is_taken_by_default_and_that_is_said(
    tmp_path, capsys
):
    trimesh.creation.box((0.3, 0.4, 0.5)).export(tmp_path / "block.stl")
    assert main(["import", "--support", str(tmp_path / "block.stl")]) == 0
    assert find_support("block").top == pytest.approx(0.5)
    said = capsys.readouterr().err
    assert "not turned" in said
    assert "STL does not say" in said


# -- Bodies.


def test_bodies_beside_each_other_are_one_piece_and_each_can_be_chosen(capsys):
    assert main(["import", "--support", str(OF_BODIES)]) == 0
    assert "taken as one piece of furniture: frame, drawer" in capsys.readouterr().err
    desk = find_support("desk")
    assert sides(desk) == pytest.approx([0.6, 1.0])
    assert [joint.name for joint in desk.joints] == ["slide"]
    assert [round(each.position[2], 3) for each in desk.surfaces] == [0.75, 0.626]
    frame = import_support(f"{OF_BODIES}#frame")
    assert (frame.name, frame.joints) == ("frame", ())
    drawer = import_support(f"{OF_BODIES}#drawer")
    assert sides(drawer)[0] < 0.4
    assert not drawer.joints
    assert main(["import", "--support", f"{OF_BODIES}#drawr"]) == 2
    said = capsys.readouterr().err
    assert "Did you mean 'drawer'" in said
    assert "Allowed: frame, drawer" in said


def test_what_moves_freely_beside_furniture_is_left_out_and_named(tmp_path, capsys):
    text = OF_BODIES.read_text().replace(
        "</worldbody>",
        '<body name="mug" pos="0 0 0.8"><freejoint/><geom size="0.03"/></body></worldbody>',
    )
    (tmp_path / "room.xml").write_text(text)
    support = import_support(tmp_path / "room.xml")
    assert "left out, as they move freely: mug" in capsys.readouterr().err
    assert max(piece.mesh.bounds[1, 2] for piece in support.pieces) == pytest.approx(0.75)


BOX = '<visual name="v"><geometry><box><size>0.4 0.4 1.0</size></box></geometry></visual>'


def test_models_of_an_sdf_file_links_of_a_urdf_and_nodes_of_a_glb_are_chosen(tmp_path):
    models = "".join(
        f'<model name="{name}"><pose>{x} 0 0.5 0 0 0</pose><link name="l">{BOX}</link></model>'
        for name, x in (("left", -0.2), ("right", 0.2))
    )
    sdf = tmp_path / "pair.sdf"
    sdf.write_text(f'<sdf version="1.7"><world name="w">{models}</world></sdf>')
    assert sides(import_support(sdf, up="file")) == pytest.approx([0.4, 0.8])
    assert sides(import_support(f"{sdf}#left", up="file")) == pytest.approx([0.4, 0.4])
    with pytest.raises(ConfigError, match="Did you mean 'left'"):
        import_support(f"{sdf}#lefd")
    urdf = tmp_path / "two.urdf"
    links = "".join(
        f'<link name="{name}"><visual><geometry><box size="{size}"/></geometry></visual></link>'
        for name, size in (("base", "0.5 0.5 0.02"), ("leaf", "0.3 0.3 0.02"))
    )
    place = '<parent link="base"/><child link="leaf"/><origin xyz="0 0 0.3"/>'
    joint = f'<joint name="j" type="fixed">{place}</joint>'
    urdf.write_text(f'<robot name="two">{links}{joint}</robot>')
    assert sides(import_support(f"{urdf}#leaf", up="file")) == pytest.approx([0.3, 0.3])
    with pytest.raises(ConfigError, match="Allowed: base, leaf"):
        import_support(f"{urdf}#shelf")
    scene = trimesh.Scene()
    for name, x in (("small", 0.0), ("large", 2.0)):
        side = 0.3 if name == "small" else 0.6
        scene.add_geometry(
            trimesh.creation.box((side, 0.4, side)),
            name,
            name,
            transform=trimesh.transformations.translation_matrix((x, 0, 0)),
        )
    scene.export(tmp_path / "both.glb")
    assert sides(import_support(f"{tmp_path / 'both.glb'}#small", up="file")) == pytest.approx(
        [0.3, 0.3]
    )
    with pytest.raises(ConfigError, match="Did you mean 'small'"):
        import_support(f"{tmp_path / 'both.glb'}#smal")


def test_a_mesh_without_bodies_and_several_files_are_refused_with_a_way_out(tmp_path):
    for name in ("one", "two"):
        trimesh.creation.box((0.4, 0.4, 0.5)).export(tmp_path / f"{name}.stl")
    with pytest.raises(AssetError, match="STL has no bodies"):
        import_support(f"{tmp_path / 'one.stl'}#top")
    with pytest.raises(AssetError, match="holds 2 pieces of furniture") as error:
        import_support(tmp_path)
    assert import_support(error.value.hint.rstrip(".")).name == "one"


# -- Sizes and limits.


def long_table(folder, kind):
    if kind == "xml":
        text = '<geom type="box" size="1.6 0.4 0.35"/>'
        (folder / "bench.xml").write_text(
            f"<mujoco><worldbody><body name='b'>{text}</body></worldbody></mujoco>"
        )
    else:
        trimesh.creation.box((3.2, 0.7, 0.8)).export(folder / f"bench.{kind}")
    return folder / f"bench.{kind}"


@pytest.mark.parametrize("kind", ["xml", "obj", pytest.param("glb", marks=pytest.mark.slow)])
def test_what_is_longer_than_two_metres_is_furniture_where_its_unit_is_known(tmp_path, kind):
    file = long_table(tmp_path, kind)
    assert max(sides(import_support(file, up="file"))) == pytest.approx(3.2, abs=1e-6)
    report = import_sources([file], "objects")
    if kind == "obj":
        assert "a largest side between 5 mm and 2 m. Try: scale=" in report.failures[0].reason
    else:
        assert not report.failures
        assert "furniture by its size" in report.left_out[0].reason


def test_furniture_of_impossible_size_is_refused_before_any_work(tmp_path):
    trimesh.creation.box((60, 40, 70)).export(tmp_path / "table.obj")
    with pytest.raises(AssetError, match=r"scale=0.01 if the file is in centimetres \(0.7 m"):
        import_support(tmp_path / "table.obj")
    support = import_support(tmp_path / "table.obj", scale=0.01, up="file")
    assert support.top == pytest.approx(0.7)
    # A name that comes with the package is left to it.
    assert support.name == "my_table"
    with pytest.raises(AssetError, match="between 100 mm"):
        import_support(tmp_path / "table.obj", scale=0.0001)


def test_a_joint_is_opened_up_to_its_limit_as_people_write_it(capsys):
    support = import_support(PARTNET, joint=["joint_1=90"])
    assert "'joint_1' is at its limit, 89.95 degrees: 90 was asked" in capsys.readouterr().err
    assert {joint.name: joint.value for joint in support.joints}["joint_1"] == pytest.approx(1.57)
    for beyond in ("joint_1=91", "joint_1=-1", "joint_0=0.402"):
        with pytest.raises(ConfigError, match="Allowed"):
            import_support(PARTNET, joint=[beyond])


# -- Air over surfaces.


def test_what_is_cut_out_of_parts_is_free_and_all_else_is_filled_as_before():
    rng = np.random.default_rng(0)
    turn = np.eye(4)
    turn[:3, :3] = trimesh.transformations.rotation_matrix(0.4, (0, 0, 1))[:3, :3]
    turn[:3, 3] = 0.1, 0.2, 0.3
    corners = np.array([[-0.1, -0.2], [0.1, -0.2], [0.1, 0.2], [-0.1, 0.2]])
    column = AirBox(turn, corners, 0.25)
    center = np.array([0.1, 0.2, 0.3])
    part = trimesh.creation.icosphere(2, 0.4).vertices + center
    pieces = without_air([np.asarray(part)], [column])
    assert len(pieces) == 6
    points = rng.uniform(-0.4, 0.4, (4000, 3)) + center
    local = (points - turn[:3, 3]) @ turn[:3, :3]
    is_air = (np.abs(local[:, :2]) < (0.1, 0.2)).all(1) & (local[:, 2] > 0) & (local[:, 2] < 0.25)

    def is_in(shape):
        planes = hull_of(shape).equations
        return (points @ planes[:, :3].T + planes[:, 3]).max(1) < 0

    is_left = np.any([is_in(piece) for piece in pieces], axis=0)
    np.testing.assert_array_equal(is_left, is_in(part) & ~is_air)
    far = np.asarray(part) + 2.0
    assert without_air([far], [column])[0] is far


def pigeonholes():
    """Six pigeonholes of sheets without thickness, as one surface."""
    sheets = []
    for z in (0.0, 0.3, 0.6):
        sheets.append([(-0.4, -0.2, z), (0.4, -0.2, z), (0.4, 0.2, z), (-0.4, 0.2, z)])
    for x in (-0.4, -0.13, 0.13, 0.4):
        sheets.append([(x, -0.2, 0.0), (x, 0.2, 0.0), (x, 0.2, 0.6), (x, -0.2, 0.6)])
    sheets.append([(-0.4, 0.2, 0.0), (0.4, 0.2, 0.0), (0.4, 0.2, 0.6), (-0.4, 0.2, 0.6)])
    mesh = trimesh.util.concatenate(
        [trimesh.Trimesh(sheet, [[0, 1, 2], [0, 2, 3]], process=False) for sheet in sheets]
    )
    mesh.merge_vertices()
    piece = Piece(Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    return Shape("it", "it", (piece,), Provenance("test", "Apache-2.0"))


@pytest.mark.slow
def test_compartments_with_thin_walls_stay_open():
    support, notes = support_with_notes(pigeonholes())
    inside = [surface for surface in support.surfaces if surface.name != "top"]
    assert len(inside) == 6
    mesh = join_meshes([piece.mesh for piece in support.pieces])
    for surface in inside:
        assert surface.free_height > 0.28
        air = air_over(mesh, support, surface)
        assert air.seen == pytest.approx(0.3, abs=1e-3)
        assert not air.is_short
    cut = [
        note
        for note in notes
        if "0.30 m of air are seen over it, and convex parts left 0.00 m" in note
    ]
    assert len(cut) == 6


def test_sloping_boards_are_surfaces_and_are_not_turned(tmp_path):
    mesh = mesh_of("tilted_board_10")
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(tmp_path / "board.stl")
    shape, _ = read_upright(find_furniture(tmp_path / "board.stl")[0], ReadOptions(), {})
    np.testing.assert_allclose(
        join_meshes([piece.mesh for piece in shape.pieces]).bounds, mesh.bounds, atol=1e-5
    )
