"""SDF worlds as MuJoCo reads the same scene in MJCF: places, masses, joints, gravity, what is included."""

import mujoco
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import AssetError
from cluttergen_jax.judging.scene_files import read_model, read_sdf_world
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.exports import dining_scene

BOX = "<collision name='c'><geometry><box><size>.1 .1 .1</size></box></geometry></collision>"
MASS = "<inertial><mass>{}</mass><inertia><ixx>.001</ixx><iyy>.001</iyy><izz>.001</izz></inertia></inertial>"
LINK = "<link name='{}'><pose>{}</pose>" + MASS.format("{}") + BOX + "</link>"
PLANE = (
    "<include><uri>model://ground_plane</uri></include><include><uri>model://sun</uri></include>"
)


def world(path, *models, more=""):
    path.write_text(f"<sdf version='1.9'><world name='w'>{more}{''.join(models)}</world></sdf>")
    return path


def model(name, inside, pose="0 0 0 0 0 0", static=False):
    return f"<model name='{name}'><static>{str(static).lower()}</static><pose>{pose}</pose>{inside}</model>"


def link(name="l", pose="0 0 0 0 0 0", mass=0.5):
    return LINK.format(name, pose, mass)


def joint(kind, parent, child, more=""):
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f"<joint name='j-{child}' type='{kind}'>{ends}{more}</joint>"


@pytest.mark.slow
def test_an_exported_world_is_judged_as_the_mjcf_of_the_same_scene(tmp_path):
    scene = dining_scene()
    found = {}
    for form in ("sdf", "mjcf"):
        export_scenes([scene], tmp_path / form, form)
        (found[form],) = cg.judge(tmp_path / form, seconds=(0.2, 1.0), detectors=("native",)).starts
    sdf = found["sdf"].found
    mjcf = found["mjcf"].found
    assert len(sdf.names) == len(scene.names)
    np.testing.assert_allclose(sdf.begin, mjcf.begin, atol=1e-5)
    assert sdf.is_still.tolist() == mjcf.is_still.tolist()
    assert sdf.is_deep.tolist() == mjcf.is_deep.tolist()


def test_a_world_of_models_of_its_own_and_of_others(tmp_path):
    folder = tmp_path / "crate"
    folder.mkdir()
    (folder / "model.sdf").write_text(f"<sdf version='1.9'>{model('crate', link())}</sdf>")
    (folder / "model.config").write_text("<model><name>crate</name><sdf>model.sdf</sdf></model>")
    crates = "".join(
        f"<include><uri>model://crate</uri><name>{name}</name><pose>{x} 0 .45 0 0 0</pose></include>"
        for name, x in (("a", 0.0), ("b", 0.08), ("c", 0.3), ("d", 3.0))
    )
    table = model("table", link().replace(".1 .1 .1", "1 1 .4"), "0 0 .2 0 0 0", static=True)
    path = world(tmp_path / "w.sdf", PLANE, crates, table)
    rows = {
        row["body"]: row
        for row in cg.judge(path, seconds=(0.2,), detectors=("native",)).rows.to_pylist()
    }
    assert rows["a"]["penetration"] == pytest.approx(0.02, abs=1e-6)
    assert rows["a"]["against"] == "b"
    assert rows["c"]["is_still_0.2s"]
    assert rows["d"]["falls"]
    # In a folder a model's own file is a part of worlds, not a scene.
    report = cg.judge(tmp_path, seconds=(0.1,), detectors=("native",))
    assert {each.file.name for each in report.starts} == {"w.sdf"}
    assert "1 XML files are no scenes" in str(report)


def test_poses_masses_and_options_are_the_files(tmp_path):
    inside = link("one", ".1 0 0 0 0 1.57079632679", 0.5) + link("two", "0 .3 0 0 0 0", 1.5)
    thing = model("thing", inside + joint("fixed", "one", "two"), "1 0 .5 0 0 0")
    options = "<gravity>0 0 -1.62</gravity><physics type='ode'><max_step_size>.004</max_step_size></physics>"
    read, _ = read_sdf_world(world(tmp_path / "w.sdf", thing, more=options))
    assert read.opt.gravity.tolist() == [0, 0, -1.62]
    assert read.opt.timestep == 0.004
    assert (read.nbody, read.ngeom, read.njnt) == (2, 2, 1)
    assert read.body_mass[1] == pytest.approx(2.0)
    data = mujoco.MjData(read)
    mujoco.mj_kinematics(read, data)
    np.testing.assert_allclose(data.xipos[1], [1 + 0.25 * 0.1, 0.75 * 0.3, 0.5], atol=1e-9)
    # Two masses and their own moments about their common centre (Steiner).
    apart = np.array([0.1, -0.3, 0.0])
    inertia = 2 * 0.001 * np.eye(3) + 0.375 * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    turn = data.ximat[1].reshape(3, 3)
    np.testing.assert_allclose(turn @ np.diag(read.body_inertia[1]) @ turn.T, inertia, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "type_", "span"),
    [
        ("revolute", 3, (-1.0, 0.5)),
        ("prismatic", 2, (-1.0, 0.5)),
        ("continuous", 3, None),
        ("ball", 1, None),
    ],
)
def test_joints_are_where_they_are_said_to_be(tmp_path, kind, type_, span):
    axis = "<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>.5</upper></limit></axis>"
    axis = "" if kind == "ball" else axis
    hinge = joint(kind, "base", "lid", "<pose>0 0 .1 0 0 0</pose>" + axis)
    inside = link("base") + link("lid", "0 .2 .1 0 0 1.57079632679") + hinge
    read, _ = read_sdf_world(
        world(tmp_path / "w.sdf", model("m", inside, "0 0 1 0 0 1.57079632679"))
    )
    assert read.jnt_type.tolist() == [0, type_]
    data = mujoco.MjData(read)
    mujoco.mj_kinematics(read, data)
    # The model is turned by 90 degrees: its y is the world's -x. The joint is 0.1 m over the lid's frame.
    np.testing.assert_allclose(data.xanchor[1], [-0.2, 0, 1.2], atol=1e-9)
    if kind != "ball":
        # The lid's own y is turned by 180 degrees in all.
        np.testing.assert_allclose(data.xaxis[1], [0, -1, 0], atol=1e-9)
    if span:
        np.testing.assert_allclose(read.jnt_range[1], span, atol=1e-9)
        assert read.jnt_limited[1]


def test_what_is_fixed_to_the_world_stays_and_what_is_joined_to_it_turns(tmp_path):
    door = "<axis><xyz>0 0 1</xyz></axis>"
    wall = model("wall", link() + joint("fixed", "world", "l"), "0 0 .05 0 0 0")
    swing = model("swing", link() + joint("revolute", "world", "l", door), "3 0 1 0 0 0")
    box = model("box", link(), "0 0 .15 0 0 0")
    read, _ = read_sdf_world(world(tmp_path / "w.sdf", wall, swing, box))
    assert read.body_rootid.tolist() == [0, 1, 2]
    assert read.jnt_type.tolist() == [3, 0]
    (start,) = cg.judge(tmp_path / "w.sdf", seconds=(0.2,), detectors=("native",)).starts
    assert start.found.names == ("box",)
    assert start.found.is_still.all()


def test_round_things_are_round_and_a_plane_may_lean(tmp_path):
    ball = link().replace(
        "<box><size>.1 .1 .1</size></box>", "<sphere><radius>.1</radius></sphere>"
    )
    slope = "<collision name='c'><geometry><plane><normal>-.1 0 1</normal></plane></geometry></collision>"
    ground = model("ground", f"<link name='l'>{slope}</link>", static=True)
    path = world(tmp_path / "w.sdf", ground, model("ball", ball, "0 0 .1005 0 0 0"))
    (start,) = cg.judge(path, seconds=(1.0,), detectors=("native",)).starts
    assert start.found.shift[-1, 0] > 0.1


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (link() + link("m") + joint("screw", "l", "m"), "'screw'"),
        (link() + link("m") + joint("revolute", "gone", "m"), "gone"),
        (link() + link("m") + joint("ball", "l", "m") + joint("ball", "m", "l"), "circle"),
        (
            link()
            + link("m")
            + joint("ball", "l", "m").replace("j-m", "k")
            + joint("ball", "l", "m"),
            "two joints",
        ),
        (link(mass=-1), "mass of -1 kg"),
        (link().replace("<box><size>.1 .1 .1</size></box>", "<heightmap/>"), "<heightmap>"),
        (link().replace("<geometry><box><size>.1 .1 .1</size></box></geometry>", ""), "nothing"),
        (link().replace(".1 .1 .1", ".1 x .1"), "size"),
        ("<include><uri>model://gone</uri></include>", "gone"),
    ],
)
def test_what_mujoco_has_nothing_like_is_named(tmp_path, inside, said):
    with pytest.raises(AssetError, match=said):
        read_model(world(tmp_path / "w.sdf", model("thing", inside)))
