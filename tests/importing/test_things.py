"""Several things in one mesh file are named, chosen by name, and told from one object in several pieces."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.cli.pools import left_out_text
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing.cache import cache_key
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.readers.things import SeveralThings, read_thing
from cluttergen_jax.importing.run import Job, ObjectConfig, make_job
from cluttergen_jax.importing.scenery import SEVERAL, LeftOut, Limits
from tests.helpers.cases import CASES

THREE = CASES / "25_several_in_one" / "three.glb"


def box(sides, at=(0, 0, 0)):
    return trimesh.creation.box(sides).apply_translation(at)


def can(at=(0, 0, 0.05), radius=0.033, height=0.1):
    return trimesh.creation.cylinder(radius, height, sections=16).apply_translation(at)


def save(path, **parts):
    """Meshes as nodes of a scene, as `o` of OBJ, or as one surface without names."""
    if path.suffix == ".glb":
        scene = trimesh.Scene()
        for name, mesh in parts.items():
            scene.add_geometry(mesh, node_name=name, geom_name=name)
        scene.export(path)
    elif path.suffix == ".obj":
        lines = []
        first = 1
        for name, mesh in parts.items():
            lines += [f"o {name}", *("v {} {} {}".format(*each) for each in mesh.vertices.tolist())]
            lines += ["f {} {} {}".format(*(each + first)) for each in mesh.faces]
            first += len(mesh.vertices)
        path.write_text("\n".join(lines))
    else:
        trimesh.util.concatenate(list(parts.values())).export(path)
    return path


def things(path):
    """How the things in a file are chosen; empty if it is one."""
    try:
        read_thing(path, is_whole=False)
    except SeveralThings as error:
        return [each.partition("#")[2] for each in error.places]
    return []


def sides(path, node="", is_whole=False):
    pieces = read_thing(path, node=node, is_whole=is_whole).pieces
    return np.ptp(np.concatenate([each.mesh.vertices for each in pieces]), axis=0)


APART = {
    "mug": can(),
    "book": box((0.2, 0.15, 0.03), (0.3, 0, 0.015)),
    "dice": box((0.02,) * 3, (0, 0.2, 0)),
}


@pytest.mark.parametrize(
    ("suffix", "names"), [(".glb", {"mug", "book", "dice"}), (".obj", {"mug", "book", "dice"})]
)
def test_things_of_names_are_chosen_by_them(tmp_path, suffix, names):
    path = save(tmp_path / f"trio{suffix}", **APART)
    assert set(things(path)) == names
    for name, mesh in APART.items():
        np.testing.assert_allclose(sides(path, name), mesh.extents, atol=1e-6)


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_things_without_names_are_chosen_by_number(tmp_path, suffix):
    path = save(tmp_path / f"two{suffix}", a=can(), b=can((0.4, 0, 0.05), 0.02))
    assert things(path) == ["0", "1"]
    np.testing.assert_allclose(sides(path, "1"), [0.04, 0.04, 0.1], atol=1e-6)


def test_three_cubes_of_one_file_are_left_out_and_named():
    (planned,) = plan_all([THREE], ReadOptions()).objects
    job = Job(
        planned.source, "", ObjectConfig(planned.options), limits=Limits(), place=planned.place
    )
    made = make_job(job)
    assert isinstance(made, LeftOut)
    assert made.detail == "three.glb#cube0, three.glb#cube1, three.glb#cube2"
    assert "by its name behind '#'" in made.reason


def test_the_example_for_objects_toml_is_one_thing():
    left_out = (LeftOut("a.glb", SEVERAL, "a.glb#fork, a.glb#spoon"),)
    assert left_out_text(left_out).endswith("['a.glb#fork'] take = true)\n")
    assert "['b.stl'] take" in left_out_text((*left_out, LeftOut("b.stl", "too large")))


@pytest.mark.parametrize("node", ["cube0", "cube1", "cube2"])
def test_one_cube_of_the_file_is_an_object(node):
    (planned,) = plan_all([f"{THREE}#{node}"], ReadOptions()).objects
    assert (planned.source.name, planned.place) == (node, f"three.glb#{node}")
    job = Job(planned.source, "", ObjectConfig(planned.options, trials=1), limits=Limits())
    made = make_job(job)
    assert isinstance(made, ObjectAsset)
    np.testing.assert_allclose(made.half_extents, [0.025] * 3, atol=1e-4)


def test_settings_choose_nodes(tmp_path):
    path = save(tmp_path / "trio.glb", **APART)
    (tmp_path / "objects.toml").write_text('["trio.glb#mug"]\nmass = 0.3\n["trio.glb#book"]\n')
    objects = plan_all([tmp_path], ReadOptions()).objects
    assert [(each.source.name, each.options.mass) for each in objects] == [
        ("mug", 0.3),
        ("book", None),
    ]
    keys = {cache_key(each.source, ObjectConfig()) for each in objects}
    assert len(keys | {cache_key(find_sources(path)[0], ObjectConfig())}) == 3


def test_a_misspelt_node_is_asked_about():
    (source,) = find_sources(f"{THREE}#cube")
    with pytest.raises(
        ConfigError, match=r"Did you mean 'cube\d'\? Allowed: cube0, cube1, cube2\."
    ):
        read_shape(source)
    with pytest.raises(AssetError, match="does not exist"):
        find_sources(f"{THREE.parent}/four.glb#cube0")


def test_a_body_of_a_model_file_is_chosen_alike(tmp_path):
    bodies = "".join(f'<body name="{n}"><geom size=".03"/></body>' for n in ("pan", "lid"))
    (tmp_path / "kitchen.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    (source,) = find_sources(f"{tmp_path}/kitchen.xml#lid")
    assert (source.name, source.body) == ("lid", "lid")
    with pytest.raises(AssetError, match=r"Did you mean 'lid'\? Allowed: pan, lid"):
        find_sources(f"{tmp_path}/kitchen.xml#lidd")


KEYS = [(x, y) for x in range(5) for y in range(3)]
LAPTOP = {f"key_{x}_{y}": box((0.014, 0.014, 0.002), (0.02 * x, 0.02 * y, 0.012)) for x, y in KEYS}


@pytest.mark.parametrize(
    "parts",
    [
        {"mug": can(), "lid": can((0, 0, 0.106), height=0.01)},
        {"cup": can(), "handle": box((0.02, 0.01, 0.05), (0.045, 0, 0.05))},
        {"base": box((0.2, 0.12, 0.02), (0.04, 0.02, 0)), **LAPTOP},
        {"tray": box((0.3, 0.2, 0.01)), "rim": box((0.3, 0.2, 0.005), (0, 0, 0.02))},
        {"body": can(), "crumb": box((0.002,) * 3, (0.1, 0, 0))},
        {"part_1": can(), "part_2": can((0.1, 0, 0.05))},
    ],
    ids=["lid", "handle", "laptop", "rim", "crumb", "parts"],
)
@pytest.mark.parametrize("suffix", [".glb", ".obj", ".stl"])
def test_pieces_of_one_object_stay_one(tmp_path, suffix, parts):
    path = save(tmp_path / f"thing{suffix}", **parts)
    assert things(path) == []
    np.testing.assert_allclose(sides(path), sides(path, is_whole=True))


@pytest.mark.parametrize("name", ["planks", "knob_and_handle"])
def test_loose_pieces_of_one_object_are_one_with_a_note(name):
    file = read_thing(CASES / "16_pieces_apart" / "objects" / f"{name}.obj", is_whole=False)
    assert any(f"one alone: {name}.obj#0, {name}.obj#1" in note for note in file.notes)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".stl"])
@pytest.mark.parametrize("side", [0.4, 2.0])
def test_a_ground_sheet_is_scenery(tmp_path, suffix, side):
    sheet = box((side, side, 0.001), (0, 0, -0.0005))
    path = save(tmp_path / f"can{suffix}", ground=sheet, can=can())
    np.testing.assert_allclose(sides(path), [0.066, 0.066, 0.1], atol=1e-3)
    assert sides(path, is_whole=True).max() == pytest.approx(side)
    assert any("scenery" in note for note in read_thing(path, is_whole=False).notes)


@pytest.mark.parametrize(
    "parts",
    [
        {"coaster": box((0.1, 0.1, 0.002), (0, 0, -0.001)), "cup": can()},
        {"plate": box((0.26, 0.26, 0.02), (0, 0, -0.01)), "apple": can(radius=0.04)},
        {"label": box((0.3, 0.2, 0.001)), "card": box((0.05, 0.05, 0.0005), (0, 0, 0.001))},
    ],
    ids=["coaster", "thick", "flat"],
)
def test_what_is_no_sheet_stays(tmp_path, parts):
    path = save(tmp_path / "thing.glb", **parts)
    np.testing.assert_allclose(sides(path), sides(path, is_whole=True))


def test_pictures_stay_with_what_is_cut_out(tmp_path):
    """Texture coordinates go with the triangles that are kept."""
    path = tmp_path / "two.obj"
    square = "v {0} 0 0\nv {1} 0 0\nv {1} 1 0\nv {0} 1 1\n"
    path.write_text(
        "mtllib two.mtl\nusemtl m\n" + square.format(0, 1) + square.format(5, 6)
        + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt .2 .2\nvt .4 .2\nvt .4 .4\nvt .2 .4\n"
        + "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 5/5 6/6 7/7\nf 5/5 7/7 8/8\n"
    )  # fmt: skip
    (tmp_path / "two.mtl").write_text("newmtl m\nmap_Kd p.png\n")
    Image.new("RGB", (4, 4), "red").save(tmp_path / "p.png")
    (piece,) = read_thing(path, node="1").pieces
    assert piece.uv.min() == pytest.approx(0.2)
    assert piece.uv.max() == pytest.approx(0.4)
    assert piece.mesh.vertices[:, 0].min() == pytest.approx(5.0)
