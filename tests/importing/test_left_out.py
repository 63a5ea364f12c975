"""What is no object for a table: scenery, actors, ghosts, copies, and what is too large or too heavy."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.deviation import gap_alarm
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Provenance, Shape
from cluttergen_jax.assets.solid import solid_of
from cluttergen_jax.cli.main import load
from cluttergen_jax.cli.pools import print_report
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.importing import run
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, read_shape
from cluttergen_jax.importing.run import ImportConfig, ObjectConfig, import_sources, make_job
from cluttergen_jax.importing.scenery import Limits
from tests.helpers.cases import CASES
from tests.helpers.shapes import make_box

BOX = '<geom type="box" size=".03 .03 .03" mass=".1"/>'


def write(path, *bodies, rest=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<mujoco><worldbody>{''.join(bodies)}</worldbody>{rest}</mujoco>")


def body(name, inside=BOX, free=False):
    return f'<body name="{name}">{"<freejoint/>" if free else ""}{inside}</body>'


def arm(joints):
    """A chain of bodies with one hinge each."""
    inside = BOX
    for _ in range(joints):
        inside = f'<body><joint type="hinge"/>{inside}</body>'
    return inside


def planned(folder, **options):
    """Names of the objects, and by place what was left out and why."""
    plan = plan_all([folder], ReadOptions(), **options)
    return [each.source.name for each in plan.objects], {
        each.name: each.reason for each in plan.left_out
    }


def test_scenery_in_every_file_and_mocap_bodies_are_no_objects():
    names, left = planned(CASES / "19_scenery_in_every_file" / "objects")
    assert names == ["brick", "mug"]
    assert {place.split("#")[1] for place in left} == {"tablelink", "wall", "mocap"}
    assert "mocap" in left["mug.xml#mocap"]
    assert "fixed to the world" in left["brick.xml#tablelink"]
    everything, nothing = planned(CASES / "19_scenery_in_every_file" / "objects", take_all=True)
    assert (len(everything), nothing) == (8, {})


@pytest.mark.parametrize("name", ["tin-visual.xml", "seen.xml"])
def test_a_ghost_is_no_object_whatever_it_is_called(tmp_path, name):
    shutil.copytree(CASES / "18_ghost_twin" / "objects", tmp_path / "set")
    (tmp_path / "set" / "tin-visual.xml").rename(tmp_path / "set" / name)
    plan = plan_all([tmp_path / "set"], ReadOptions())
    assert [each.source.name for each in plan.objects] == ["tin"]
    if name == "seen.xml":
        assert [(each.name, each.detail) for each in plan.left_out] == [(name, "of tin.xml")]


def test_what_most_files_have_is_scenery_and_what_few_have_is_one_object(tmp_path):
    table = body("table", '<geom type="box" size=".3 .3 .02"/>')
    for index, name in enumerate(("cup", "bowl", "pan", "jug", "pot")):
        shape = f'<geom type="box" size=".0{index + 2} .03 .03"/>'
        write(tmp_path / f"{name}.xml", table, body(name, shape))
    write(tmp_path / "pan_again.xml", table, body("pan", '<geom type="box" size=".04 .03 .03"/>'))
    names, left = planned(tmp_path)
    assert names == ["bowl", "cup", "jug", "pan", "pot"]
    assert {why for place, why in left.items() if place.endswith("#table")} == {
        "stands alike in several files"
    }
    assert left["pan_again.xml#pan"] == "alike in another file"


def test_bodies_of_the_same_parts_elsewhere_are_two_objects(tmp_path):
    table = body("table", '<geom type="box" size=".3 .3 .02"/>')
    bar = '<geom type="box" size=".09 .02 .02"/>'
    part = '<body pos="{} .06 0">{}</body>'
    foot = '<geom type="box" size=".02 .05 .02"/>'
    for name, x in (("ell", ".07"), ("tee", "0"), ("tee_again", "0")):
        write(tmp_path / f"{name}.xml", table, body(name, bar + part.format(x, foot)))
    names, left = planned(tmp_path)
    assert names == ["ell", "tee"]
    assert left["tee_again.xml#tee_again"] == "alike in another file"


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("joints", [1, 3, 4])
def test_chains_of_four_joints_are_robots_and_shorter_ones_are_not(tmp_path, joints, free):
    write(tmp_path / "thing.xml", body("thing", arm(joints), free))
    assert planned(tmp_path)[0] == (["thing"] if joints < 4 else [])


def test_settings_take_one_body_and_leave_another(tmp_path):
    shutil.copytree(CASES / "19_scenery_in_every_file" / "objects", tmp_path / "set")
    settings = tmp_path / "set" / "objects.toml"
    settings.write_text('["mug.xml#wall"]\ntake = true\n["brick.xml#brick"]\ntake = false\n')
    names, left = planned(tmp_path / "set")
    assert sorted(names) == ["mug", "wall"]
    assert left["brick.xml#brick"] == "as the settings say"
    settings.write_text('["mug.xml"]\ntake = "yes"\n')
    with pytest.raises(ConfigError, match="take"):
        planned(tmp_path / "set")


# Size and mass


def shape_of(size, density=500.0, mass=None):
    box = trimesh.creation.box(size)
    piece = Piece(Mesh(box.vertices, box.faces))
    return Shape("box", "box", (piece,), Provenance("none", "none"), density=density, mass=mass)


@pytest.mark.parametrize(
    ("size", "density", "mass", "word"),
    [
        ((0.05, 0.05, 0.59), 500, None, None),
        ((0.05, 0.05, 0.60), 500, None, "large"),
        ((0.35, 0.35, 0.35), 500, None, "heavy"),
        ((0.35, 0.35, 0.35), 300, None, None),
        ((0.35, 0.35, 0.35), 500, 3.0, None),
        ((0.05, 0.05, 0.05), 500, 21.0, "heavy"),
    ],
)
def test_limits_of_size_and_mass(size, density, mass, word):
    left = Limits().why_shape_left_out("box", shape_of(size, density, mass))
    assert (left is None) if word is None else (word in left.reason)


CONFIG = ImportConfig(ObjectConfig(trials=8), jobs=1, progress=False)


def at_once(jobs, config, watch=None):
    """The jobs one by one in this process: no test here is about processes."""
    for index, each in enumerate(jobs):
        yield index, run.Outcome(make_job(each))


def plain_body(shape, config, trials):
    """A box as large as the shape, in place of a body that takes a second to make."""
    size = np.ptp(shape.pieces[0].mesh.vertices, axis=0)
    return replace(make_box(shape.name, tuple(size / 2)), provenance=shape.provenance)


@pytest.fixture
def quick_import(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(run, "_outcomes", at_once)
    monkeypatch.setattr(run, "measured_object", plain_body)


def test_what_is_too_large_is_told_in_one_block(quick_import, capsys):
    folder = CASES / "17_not_table_top"
    report = import_sources([folder], "t", CONFIG)
    assert [each.name for each in report.objects] == ["small_0", "small_1", "small_2"]
    assert not report.failures
    print_report(report, load("import"))
    block = capsys.readouterr().out.partition("2 left out")[2]
    assert all(
        word in block
        for word in (
            "unit_cube",
            "1.00 x 1.00",
            "unit_cylinder",
            "0.6 m",
            "--max-size",
            "--take-all",
        )
    )
    # What was taken once lies in the cache, and is beyond the limits as before.
    cube = folder / "objects" / "unit_cube.obj"
    assert import_sources([cube], "all_of_it", ImportConfig(CONFIG.object, take_all=True)).objects
    assert [each.name for each in import_sources([cube], "again", CONFIG).left_out] == [
        "unit_cube.obj"
    ]


# Pieces apart


@pytest.mark.parametrize(("name", "gap"), [("planks", "90 mm"), ("knob_and_handle", "85 mm")])
def test_pieces_that_do_not_touch_are_flagged(name, gap):
    plan = plan_all([CASES / "16_pieces_apart" / "objects" / f"{name}.obj"], ReadOptions())
    shape = read_shape(plan.objects[0].source)
    assert gap in gap_alarm(solid_of([piece.mesh for piece in shape.pieces]))
