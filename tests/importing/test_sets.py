"""Published sets are known by what their folders hold: which files are models, and what they do not say."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, read_shape
from cluttergen_jax.importing.readers.sets import layouts
from tests.helpers.shapes import save_box

BODY = '<body name="{}"><geom type="box" size=".02 .02 .02"/></body>'
MODELS = [
    "bottle",
    "bread",
    "can",
    "cereal",
    "lemon",
    "milk",
    "plate-with-hole",
    "round-nut",
    "square-nut",
]


def save_model(path, *bodies):
    path.parent.mkdir(parents=True, exist_ok=True)
    text = "".join(map(BODY.format, bodies or ("object",)))
    path.write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")


def robosuite(folder, objects="objects"):
    """A folder laid out as robosuite's models/assets."""
    for name in (*MODELS, "door", "door_lock", "bread-visual", "can-visual"):
        save_model(folder / objects / f"{name}.xml")
    save_box(folder / objects / "meshes" / "sphere8.obj")
    save_model(folder / "robots" / "panda" / "robot.xml")
    save_model(folder / "arenas" / "table_arena.xml")
    save_model(folder / "base.xml")
    return folder


@pytest.mark.parametrize(
    ("objects", "given"),
    [
        ("objects", ""),
        ("objects", "objects"),
        ("renamed", "renamed"),
        ("objects", "../.."),
        ("things", ".."),
    ],
)
def test_robosuite_has_nine_models(tmp_path, objects, given):
    folder = robosuite(tmp_path / "a" / "b", objects)
    plan = plan_all([(folder / given).resolve()], ReadOptions())
    assert sorted(each.source.name for each in plan.objects) == MODELS
    assert {each.options.licence for each in plan.objects} == {"MIT"}
    assert {(each.up.axis, each.up.reason) for each in plan.objects} == {
        ("z", "as in robosuite's objects")
    }
    (line,) = plan.sets
    assert line.startswith(f"recognised: robosuite's objects in {objects}/, up z, licence MIT")
    told = {Path(each.name).name: each.reason for each in plan.left_out}
    assert "furniture" in told["door.xml"]
    assert "set=none" in told["door_lock.xml"]


def test_labels_and_licences_stand_in_files_beside_objects(tmp_path):
    uid = "0123456789abcdef" * 2
    save_box(tmp_path / "o" / "glbs" / "000-023" / f"{uid}.glb")
    (tmp_path / "o" / "metadata").mkdir()
    record = {uid: {"name": "Teapot", "license": "by"}}
    (tmp_path / "o" / "metadata" / "000-023.json.gz").write_bytes(
        gzip.compress(json.dumps(record).encode())
    )
    (planned,) = plan_all([tmp_path / "o" / "glbs"], ReadOptions()).objects
    assert (planned.source.label, planned.options.licence) == ("Teapot", "by")

    folder = tmp_path / "p" / "3398"
    save_box(folder / "textured_objs" / "original-1.obj")
    mesh = '<visual><geometry><mesh filename="textured_objs/original-1.obj"/></geometry></visual>'
    (folder / "mobility.urdf").write_text(f'<robot name="r"><link name="l">{mesh}</link></robot>')
    (folder / "meta.json").write_text('{"model_cat": "Bottle"}')
    (planned,) = plan_all([folder], ReadOptions()).objects
    assert (planned.source.name, planned.source.label) == ("3398", "Bottle")
    (folder / "meta.json").write_text("[")
    (planned,) = plan_all([tmp_path / "p"], ReadOptions()).objects
    assert planned.source.label == "3398"


@pytest.mark.parametrize(
    ("name", "files", "objects"),
    [
        (
            "libero",
            [
                "stable_hope_objects/milk/milk.xml",
                "articulated_objects/stove.xml",
                "scenes/a/a.xml",
            ],
            ["milk"],
        ),
        (
            "robocasa",
            ["objects/objaverse/apple/apple_0/model.xml", "fixtures/sinks/s/model.xml"],
            ["apple_0"],
        ),
        (
            "gso",
            ["Mug/model.xml", "Mug/model.obj", "Mug/model_collision_0.obj", "Mug/texture.png"],
            ["mug"],
        ),
        (
            "hope",
            ["full/AlphabetSoup.obj", "full/BBQSauce.obj", "full/Ketchup.obj", "eval/Ketchup.obj"],
            ["alphabetsoup", "bbqsauce", "ketchup"],
        ),
        ("bop", ["models/models_info.json", "models/obj_000001.ply"], ["obj_000001"]),
        ("egad", ["e/A0.obj", "e/C3.obj", "e/G6.obj"], ["a0", "c3", "g6"]),
        ("ycb", ["025_mug/google_16k/textured.obj", "025_mug/tsdf/nontextured.stl"], ["025_mug"]),
        (
            "maniskill",
            ["mani_skill2_ycb/models/025_mug/textured.obj", "robots/panda.xml"],
            ["025_mug"],
        ),
        ("random-urdfs", ["000/000.urdf", "000/000.obj"], ["000"]),
    ],
)
def test_sets_are_recognised(tmp_path, name, files, objects):
    for file in files:
        path = tmp_path / file
        if path.suffix == ".xml":
            save_model(path)
        elif path.suffix in (".obj", ".ply", ".stl"):
            save_box(path)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            mesh = f'<visual><geometry><mesh filename="{path.stem}.obj"/></geometry></visual>'
            path.write_text(f'<robot name="r"><link name="l">{mesh}</link></robot>')
    plan = plan_all([tmp_path], ReadOptions())
    assert layouts()[name].title in plan.sets[0]
    assert sorted(each.source.name for each in plan.objects) == objects
    scale = {"hope": 0.01, "bop": 0.001}.get(name, 1.0)
    assert {each.options.scale for each in plan.objects} == {scale}


def libero(folder):
    """A model of LIBERO beside raw and collision meshes of the same thing."""
    home = folder / "assets" / "stable_scanned_objects" / "white_bowl"
    for name in (
        "model.obj",
        "ceramic_bowl_col.obj",
        "bowl.obj",
        "visual/bowl_vis.stl",
        "ceramic_bowl.obj",
    ):
        save_box(home / name)
    mesh = '<asset><mesh name="m" file="visual/bowl_vis.stl"/></asset>'
    for name in ("white_bowl.xml", "bowl_handle.xml"):
        body = '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody>'
        (home / name).write_text(f"<mujoco>{mesh}{body}</mujoco>")
    return folder


def test_in_a_set_only_its_models_are_objects(tmp_path):
    plan = plan_all([libero(tmp_path)], ReadOptions())
    assert [each.source.name for each in plan.objects] == ["white_bowl"]
    assert not plan.left_out
    reasons = [
        each.reason for each in plan.skipped if each.reason == "no model of LIBERO's objects"
    ]
    assert len(reasons) == 2
    assert plan.sets[0].endswith("2 other files there no objects of their own")
    everything = plan_all([tmp_path], ReadOptions(), take_all=True)
    assert [each.source.name for each in everything.objects] == ["white_bowl"]


def test_settings_take_what_is_no_model_of_the_set(tmp_path):
    libero(tmp_path)
    (tmp_path / "objects.toml").write_text('["ceramic_bowl.obj"]\ntake = true\n')
    names = [each.source.name for each in plan_all([tmp_path], ReadOptions()).objects]
    assert sorted(names) == ["ceramic_bowl", "white_bowl"]


def test_a_set_of_another_layout_goes_by_the_general_rules(tmp_path):
    """Where no model is where it was thought to be, nothing is lost."""
    home = tmp_path / "stable_hope_objects" / "milk_box"
    save_model(home / "milk.xml")
    assert [each.source.name for each in plan_all([tmp_path], ReadOptions()).objects] == ["milk"]


def test_raw_and_collision_meshes_beside_a_model_are_pieces_without_a_set(tmp_path):
    plan = plan_all([libero(tmp_path)], ReadOptions(), layout="none")
    names = [each.source.path.name for each in plan.objects]
    assert sorted(names) == ["bowl_handle.xml", "ceramic_bowl.obj", "white_bowl.xml"]


def kept(folder, name, **options):
    plan = plan_all([folder], ReadOptions(**options))
    (planned,) = [each for each in plan.objects if each.source.name == name]
    return read_shape(planned.source, planned.options)


def test_collision_shapes_beside_a_mesh_are_kept_as_its_parts(tmp_path):
    """The finest kind, each connected piece a part; scaled as the mesh is."""
    save_box(tmp_path / "mug.obj")
    save_box(tmp_path / "mug_col.obj")
    halves = [
        trimesh.creation.box((0.02, 0.05, 0.05)).apply_translation((x, 0, 0))
        for x in (-0.015, 0.015)
    ]
    trimesh.util.concatenate(halves).export(tmp_path / "mug_coacd.stl")
    shape = kept(tmp_path, "mug", collision="keep", scale=2.0)
    assert shape.parts is not None
    np.testing.assert_allclose(
        [np.ptp(each.bounds, axis=0) for each in shape.parts], [[0.04, 0.1, 0.1]] * 2, atol=1e-6
    )
    assert "its collision parts are those of mug_coacd.stl" in shape.notes
    assert kept(tmp_path, "mug").parts is None
