"""The neutral judge: against a plain second one, and on scenes of which the answer is known."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.export import export_scenes
from studies.benchmarks.plain_judge import judge as judge_plainly
from studies.benchmarks.repair import disturb
from tests.helpers.exports import dining_scene

_BOX = '<body name="{}" pos="{} {} {}"><freejoint/><geom type="box" size=".1 .1 .1" {}/>{}</body>'
_FLOOR = '<geom type="plane" size="0 0 1"/>'
_FLAGS = ("is_still_0.2s", "is_still_1s", "is_deep", "floats", "falls")


def mjcf(path, *bodies, more="", option=""):
    path.write_text(
        f"<mujoco>{option}<worldbody>{_FLOOR}{''.join(bodies)}</worldbody>{more}</mujoco>"
    )
    return path


def box(name, x, z, geom="", inside="", y=0.0):
    return _BOX.format(name, x, y, z, geom, inside)


def flags(report, detector="native"):
    """By body: whether it is still, deep, floating and fallen."""
    kept = [row for row in report.rows.to_pylist() if row["detector"] == detector]
    return {row["body"]: [row[name] for name in _FLAGS[1:]] for row in kept}


def test_every_fault_is_found_by_its_name(tmp_path):
    stack = [box("low", 3, 0.1), box("top", 3, 0.3)]
    driven = box("driven", 7, 0.1, inside='<site name="s"/>')
    path = mjcf(
        tmp_path / "scene.xml",
        *[box("deep", 0, 0.05), box("near", 1, 0.1005), box("high", 2, 0.12), *stack],
        *[box("edge", 5, 0.7), '<geom type="box" size=".1 .1 .3" pos="5.15 0 .3"/>'],
        *[box("marker", 6, 0.1, 'contype="0" conaffinity="0"'), driven],
        box("jointed", 8, 0.1, inside='<body><joint/><geom size=".05" pos="0 0 .2"/></body>'),
        more='<actuator><motor site="s" gear="0 0 1 0 0 0"/></actuator>',
    )
    report = cg.judge(path, seconds=(0.2, 1.0))
    for detector in ("native", "libccd"):
        assert flags(report, detector) == {
            "deep": [False, True, False, False],
            "near": [True, False, False, False],
            "high": [False, False, True, False],
            "low": [True, False, False, False],
            "top": [True, False, False, False],
            "edge": [False, False, False, True],
            "jointed": [True, False, False, False],
        }
    text = str(report)
    assert "1 free bodies are not judged: an actuator drives them" in text
    assert "1 free bodies are not judged: they collide with nothing" in text
    assert "3 of 7 moved" in text


def test_a_plain_second_judge_agrees(tmp_path):
    draw = np.random.default_rng(0)
    asked = 0
    alike = 0
    for number in range(4):
        bodies = [
            box(f"b{i}", *draw.uniform(-0.2, 0.2, 1), 0.1 + 0.19 * i, y=draw.uniform(-0.1, 0.1))
            for i in range(3)
        ]
        path = mjcf(tmp_path / f"{number}.xml", *bodies)
        found = {
            row["body"]: row for row in cg.judge(path, seconds=(0.2, 1.0)).rows.to_pylist()[:3]
        }
        for own in judge_plainly(path, seconds=(0.2, 1.0)):
            asked += len(_FLAGS)
            alike += sum(found[own["body"]][name] == own[name] for name in _FLAGS)
    assert asked == 60
    assert alike / asked >= 0.99


@pytest.mark.slow
def test_a_plain_second_judge_agrees_on_our_scenes_as_they_are_and_disturbed(tmp_path):
    export_scenes([dining_scene()], tmp_path, "mjcf")
    (path,) = (tmp_path / "scenes").glob("*.xml")
    poses = dining_scene().poses
    draw = np.random.default_rng(0)
    states = [poses, *(disturb(poses, 0.01, 0.17, draw) for _ in range(7))]
    np.savez(path.with_suffix(".npz"), states=np.reshape(states, (8, -1)))
    rows = {
        (r["start"], r["body"], r["detector"]): r
        for r in cg.judge(path, seconds=(0.2, 1.0)).rows.to_pylist()
    }
    for detector in ("native", "libccd"):
        own = judge_plainly(path, detector, seconds=(0.2, 1.0))
        pairs = [
            (rows[each["start"], each["body"], detector][name], each[name])
            for each in own
            for name in _FLAGS
        ]
        assert np.mean([one == other for one, other in pairs]) >= 0.99
        assert all(rows["0", name, detector]["is_still_1s"] for name in dining_scene().names)
        assert np.mean([one for one, _ in pairs]) < 0.9


def test_what_diverges_has_moved_and_what_is_unreadable_says_why(tmp_path, capsys):
    wild = mjcf(
        tmp_path / "wild.xml",
        box("a", 0, 0.1),
        box("b", 0.01, 0.11),
        option='<option timestep="0.2"/>',
    )
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    (tmp_path / "fixed.xml").write_text(f"<mujoco><worldbody>{_FLOOR}</worldbody></mujoco>")
    (tmp_path / "part.xml").write_text("<mujocoinclude/>")
    (tmp_path / "slow.xml").write_text(wild.read_text().replace('"0.2"', '"1e-8"'))
    report = cg.judge(tmp_path, seconds=(1.0,), detectors=("native",))
    assert {path.name for path in report.unread} == {"broken.xml", "fixed.xml", "slow.xml"}
    assert not any(row["is_still_1s"] for row in report.rows.to_pylist() if row["body"])
    assert [row["error"] is None for row in report.rows.to_pylist()] == [True] * 2 + [False] * 3
    assert main(["judge", str(tmp_path / "fixed.xml")]) == 1
    assert "no body in it moves freely" in capsys.readouterr().out
    for words in (
        ["/nowhere.xml"],
        [str(tmp_path), "--states", "x.npz"],
        [str(wild), "--seconds", "2", "1"],
    ):
        assert main(["judge", *words]) == 2


@pytest.mark.slow
def test_a_report_is_written_with_a_picture_of_the_worst(tmp_path):
    path = mjcf(tmp_path / "scene.xml", box("a", 0, 0.5), box("b", 1, 0.1))
    report = cg.judge(path, seconds=(1.0,), out=tmp_path / "out")
    assert pq.read_table(tmp_path / "out" / "report.parquet").equals(report.rows)
    assert (tmp_path / "out" / "report.csv").read_text().count("\n") == 1 + 2 * 2
    pixels = np.asarray(Image.open(tmp_path / "out" / "worst.png").convert("RGB"), int)
    # What moved is red, what did not is not, at the start on the left and at the end on the right.
    is_red = pixels[..., 0] > 2 * pixels[..., 1:].max(-1) + 40
    assert all(200 < half.sum() < half.size / 4 for half in np.array_split(is_red, 2, axis=1))


def test_starts_are_keyframes_or_rows_of_states(tmp_path):
    keys = '<keyframe><key name="up" qpos="0 0 .5 1 0 0 0"/><key qpos="0 0 .1 1 0 0 0"/></keyframe>'
    path = mjcf(tmp_path / "scene.xml", box("a", 0, 0.1), more=keys)
    quick = {"seconds": (0.1,), "detectors": ("native",)}
    found = cg.judge(path, **quick)
    assert [each.start for each in found.starts] == ["up", "key-1"]
    assert [bool(each.found.floats[0]) for each in found.starts] == [True, False]
    qpos = np.array([[0, 0, 0.1, 1, 0, 0, 0], [0, 0, 0.9, 1, 0, 0, 0]])
    wide = np.c_[np.full(2, 7.0), qpos, np.ones((2, 6))]
    for states in (qpos, np.c_[qpos, np.ones((2, 6))], wide):
        found = cg.judge(path, states, **quick)
        assert [bool(each.found.floats[0]) for each in found.starts] == [False, True]
    np.savez(path.with_suffix(".npz"), states=np.repeat(wide, 5, axis=0))
    found = cg.judge(path, max_starts=3, **quick)
    assert [each.start for each in found.starts] == ["0", "4", "9"]
    assert "7 starts are not judged" in str(found)
    for states in (qpos[:, :6], np.full((1, 7), np.nan)):
        assert list(cg.judge(path, states, **quick).unread) == [path]
    with pytest.raises(ConfigError, match="max_starts"):
        cg.judge(path, max_starts=0)


def test_joints_are_held_where_that_is_asked(tmp_path):
    rod = '<geom type="capsule" fromto="0 0 0 -1 0 0" size=".05"/>'
    arm = f'<body pos="1 0 .5"><joint axis="0 1 0"/>{rod}</body>'
    path = mjcf(tmp_path / "scene.xml", box("under", -0.1, 0.1), arm)
    found = [
        cg.judge(path, seconds=(1.0,), hold_joints=hold).starts[0].found.is_still.all()
        for hold in (False, True)
    ]
    assert found == [False, True]


def test_urdf_with_a_floating_joint(tmp_path):
    shape = '<geometry><box size=".2 .2 .2"/></geometry>'
    inertia = '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="1"/>{inertia}</inertial>'
    (tmp_path / "scene.urdf").write_text(
        f'<robot name="r"><link name="w"><collision>{shape}</collision></link><link name="b">{inertial}'
        f'<collision>{shape}</collision></link><joint name="j" type="floating"><origin xyz="0 0 .2"/>'
        '<parent link="w"/><child link="b"/></joint></robot>'
    )
    assert flags(cg.judge(tmp_path, seconds=(0.2, 1.0))) == {"b": [True, False, False, False]}


@pytest.mark.slow
def test_usd_is_judged_as_the_mjcf_of_the_same_scene(tmp_path):
    pytest.importorskip("pxr", reason="needs the extra usd")
    scene = dining_scene()
    found = {}
    for form in ("usd", "mjcf"):
        export_scenes([scene], tmp_path / form, form)
        found[form] = cg.judge(
            tmp_path / form, seconds=(0.2, 1.0), detectors=("native",), out=tmp_path / "out"
        )
    names = [Path(name).name for name in found["usd"].starts[0].found.names]
    assert len(names) == len(scene.names)
    # In MuJoCo's default contacts all sink by 0.1 mm, and nothing falls.
    assert found["usd"].starts[0].found.is_still.all()
    usd, mjcf = (found[form].starts[0].found.begin for form in ("usd", "mjcf"))
    np.testing.assert_allclose(usd, mjcf, atol=1e-5)
    assert json.loads(json.dumps(found["usd"].shares("native")))["still 1 s"] == 1.0


def test_usd_weighs_what_it_states(tmp_path):
    pxr = pytest.importorskip("pxr", reason="needs the extra usd")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

    from cluttergen_jax.judging.scene_files import read_usd

    assert pxr
    stage = Usd.Stage.CreateNew(str(tmp_path / "scene.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 0.001)
    material = UsdShade.Material.Define(stage, "/wood")
    UsdPhysics.MaterialAPI.Apply(material.GetPrim()).CreateDensityAttr(0.5)

    def body(name):
        prim = UsdGeom.Xform.Define(stage, f"/{name}").GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        for index in range(2):
            cube = UsdGeom.Cube.Define(stage, f"/{name}/box_{index}")
            cube.CreateSizeAttr(10.0)
            UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        return prim, cube.GetPrim()

    for name in ("plain", "wooden", "dense", "part", "whole", "off"):
        prim, cube = body(name)
        if name == "wooden":
            UsdShade.MaterialBindingAPI.Apply(prim).Bind(
                material, UsdShade.Tokens.weakerThanDescendants, "physics"
            )
        if name == "dense":
            UsdPhysics.MassAPI.Apply(prim).CreateDensityAttr(2.0)
            UsdPhysics.MassAPI.Apply(cube).CreateDensityAttr(4.0)
        if name == "part":
            UsdPhysics.MassAPI.Apply(cube).CreateMassAttr(250.0)
        if name in ("whole", "off"):
            UsdPhysics.MassAPI.Apply(prim).CreateMassAttr(300.0)
        if name == "off":
            UsdPhysics.MassAPI(prim).CreateCenterOfMassAttr(Gf.Vec3f(1, 2, 3))
    stage.Save()
    model = read_usd(tmp_path / "scene.usda")
    masses = {model.body(i).name[1:]: model.body_mass[i] for i in range(1, model.nbody)}
    # A cube of 10 cm is a litre; 0.5 g/cm^3 is half a kilogram of it.
    expected = {"plain": 2.0, "wooden": 1.0, "dense": 6.0, "part": 1.25, "whole": 0.3, "off": 0.3}
    assert masses == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(model.body("/off").ipos, [0.01, 0.02, 0.03], atol=1e-7)
