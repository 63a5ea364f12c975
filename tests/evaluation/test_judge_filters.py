"""Overlaps whatever contacts a file leaves out, bodies with joints, arrays that are none, damaged files."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.judging.judge import find_free_bodies
from studies.benchmarks.plain_judge import judge as judge_plainly

CASES = Path(__file__).parents[1] / "cases" / "judge"
QUICK = {"seconds": (0.1,), "detectors": ("native",)}
_FLOOR = '<geom name="floor" type="plane" size="0 0 1"/>'
_BOX = (
    '<body name="{}" pos="{} 0 .03"><freejoint/><geom type="box" size=".03 .03 .03" {}/>{}</body>'
)


def scene(path, *parts, rest="", option=""):
    path.write_text(
        f"<mujoco>{option}<worldbody>{_FLOOR}{''.join(parts)}</worldbody>{rest}</mujoco>"
    )
    return path


def overlaps(path, **options):
    """Millimetres and with what, by body."""
    rows = cg.judge(path, **QUICK, **options).rows.to_pylist()
    return {row["body"]: (round(1000 * row["penetration"], 1), row["against"]) for row in rows}


@pytest.mark.parametrize("detector", ["native", "libccd"])
def test_an_excluded_overlap_is_measured(detector):
    report = cg.judge(CASES / "excluded_overlap.xml", seconds=(0.2,), detectors=(detector,))
    assert [row["penetration"] for row in report.rows.to_pylist()] == pytest.approx(
        [0.04, 0.04], abs=1e-6
    )
    assert report.shares(detector)["overlap"] == 1.0


@pytest.mark.parametrize(
    ("own", "rest", "option"),
    [
        ("", "", ""),
        ("", '<contact><exclude body1="a" body2="b"/></contact>', ""),
        ('contype="2" conaffinity="1"', "", ""),
        ('contype="1" conaffinity="0"', "", ""),
        ("", "", '<option><flag contact="disable"/></option>'),
        ("", "", '<option><flag constraint="disable"/></option>'),
        ("", '<contact><pair geom1="floor" geom2="a"/></contact>', ""),
    ],
)
def test_an_overlap_is_the_same_whatever_filters_contacts(tmp_path, own, rest, option):
    bodies = [_BOX.format("a", 0, f'name="a" {own}', ""), _BOX.format("b", 0.02, own, "")]
    assert overlaps(scene(tmp_path / "s.xml", *bodies, rest=rest, option=option)) == {
        "a": (40.0, "b"),
        "b": (40.0, "a"),
    }


def test_what_can_be_touched_by_nothing_counts_by_what_is_drawn(tmp_path):
    ghost = 'contype="0" conaffinity="0"'
    shelf = (
        f'<body name="shelf" pos=".05 0 .03"><geom type="box" size=".03 .03 .03" {ghost}/></body>'
    )
    path = scene(tmp_path / "s.xml", _BOX.format("a", 0, "", ""), shelf)
    assert overlaps(path)["a"][0] == 10.0
    assert "measured by what is drawn of them: 'shelf'" in str(cg.judge(path, **QUICK))
    # What one can look through, and what a program moves, is no obstacle.
    for instead in (
        shelf.replace("size", 'rgba="1 0 0 .3" size'),
        shelf.replace("<body", '<body mocap="true"'),
        shelf.replace('type="box"', 'rgba="1 1 1 0" type="box"'),
    ):
        assert (
            overlaps(scene(tmp_path / "s.xml", _BOX.format("a", 0, "", ""), instead))["a"][0] < 0.1
        )


def test_pictures_of_a_body_that_collides_are_no_overlaps(tmp_path):
    twin = '<geom type="box" size=".06 .06 .06" contype="0" conaffinity="0" group="2"/>'
    bodies = [_BOX.format("a", 0, "", twin), _BOX.format("b", 0.07, "", twin)]
    assert {depth for depth, _ in overlaps(scene(tmp_path / "s.xml", *bodies)).values()} <= {0.0}


def test_a_link_does_not_overlap_its_own_body_but_others(tmp_path):
    lid = '<body pos="0 0 .03"><joint axis="0 1 0"/><geom type="box" size=".02 .02 .02"/></body>'
    bodies = [_BOX.format("a", 0, "", lid), _BOX.format("b", 0.2, "", "")]
    assert overlaps(scene(tmp_path / "s.xml", *bodies))["a"][0] < 0.1
    over = '<body name="c" pos="0 0 .09"><freejoint/><geom type="box" size=".02 .02 .02"/></body>'
    assert overlaps(scene(tmp_path / "s.xml", *bodies, over))["c"] == (10.0, "a")


def test_a_file_without_room_for_the_contacts_that_it_leaves_out_is_measured_all_the_same(tmp_path):
    bodies = [
        f'<body name="b{i}" pos="{0.001 * i} 0 .03"><freejoint/><geom type="box" size=".03 .03 .03"/></body>'
        for i in range(12)
    ]
    rest = '<contact><exclude body1="b0" body2="b1"/></contact>'
    masked = [each.replace("<geom", '<geom contype="1" conaffinity="0"') for each in bodies]
    # As much room as keeps the contacts that the file asks for, and no more.
    size = '<size memory="100K"/>'
    path = scene(tmp_path / "s.xml", *masked, rest=rest, option=size)
    found = overlaps(path)
    assert len(found) == 12
    assert min(depth for depth, _ in found.values()) > 45.0


def test_a_body_with_a_hinge_is_judged_and_its_lid_counts(tmp_path):
    report = cg.judge(CASES / "laptop.xml", **QUICK)
    assert [each.found.names for each in report.starts] == [("base",)]
    assert report.shares("native")["overlap"] == 0.0
    # Where it may open wide, a lid that leans back falls open, and its base lies still.
    text = (CASES / "laptop.xml").read_text().replace('range="-1 0"', 'range="-90 0"')
    path = tmp_path / "s.xml"
    path.write_text(text.replace('"0 .1 .012"', '"0 .1 .012" euler="-20 0 0"'))
    (start,) = cg.judge(path, seconds=(1.0,), detectors=("native",)).starts
    assert start.found.shift[-1, 0] > 0.02
    (held,) = cg.judge(path, seconds=(1.0,), detectors=("native",), hold_joints=True).starts
    assert held.found.is_still.all()


def test_the_second_judge_agrees_where_contacts_are_left_out(tmp_path):
    draw = np.random.default_rng(1)
    alike = 0
    asked = 0
    for number in range(4):
        geom = '<geom type="box" size=".02 .02 .02" mass=".01"/>'
        lid = f'<body pos="0 0 .05"><joint axis="0 1 0"/>{geom}</body>'
        bodies = [
            _BOX.format(f"b{i}", 0.055 * i + draw.uniform(-0.01, 0.01), "", lid) for i in range(3)
        ]
        rest = '<contact><exclude body1="b0" body2="b1"/></contact>'
        path = scene(tmp_path / f"{number}.xml", *bodies, rest=rest)
        own = judge_plainly(path, seconds=(0.2, 1.0))
        found = cg.judge(path, seconds=(0.2, 1.0), detectors=("native",)).rows.to_pylist()
        for one, other in zip(own, found, strict=True):
            for flag in ("is_still_0.2s", "is_still_1s", "is_deep", "floats", "falls"):
                asked += 1
                alike += one[flag] == other[flag]
    assert asked == 60
    assert alike / asked >= 0.95


def test_a_scene_without_its_picture_is_judged_with_a_note(capsys):
    assert main(["judge", str(CASES / "missing_texture.xml"), "--seconds", "0.2"]) == 0
    assert "gone.png" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("states", "said"),
    [
        (np.ones((1, 7), complex), "complex128"),
        (np.full((1, 7), "0.1"), "real numbers"),
        (np.full((1, 7), None), "object"),
        (np.ones((1, 7), bool), "bool"),
        ([[1.0], [1.0, 2.0]], "no array"),
        (np.ones(()), r"shape \(\)"),
        (np.ones((0, 7)), r"shape \(0, 7\)"),
        (
            np.array([[0, 0, 1, 1, 0, 0, 0], [0, 0, 1, 0, 0, 0, 0.0]]),
            r"states\[1, 3:7\].*'a'.*length 0",
        ),
        (np.array([[0, 0, 1, 2, 0, 0, 0.0]]), r"length 2"),
        (np.r_[0, 0, 1, 1, 0, 0, 0, np.full(6, np.inf)], r"states\[0, 7\] = inf"),
        (np.r_[9, 0, 0, 1, 0.9, 0, 0, 0, np.zeros(6)], r"states\[0, 4:8\]"),
    ],
)
def test_arrays_that_are_no_states_say_what_is_wrong(tmp_path, states, said):
    path = scene(tmp_path / "s.xml", _BOX.format("a", 0, "", ""))
    (reason,) = cg.judge(path, states, **QUICK).unread.values()
    assert re.search(said, reason), reason


def test_states_of_few_digits_and_lists_are_taken(tmp_path):
    path = scene(tmp_path / "s.xml", _BOX.format("a", 0, "", ""))
    row = [0, 0, 0.03, 0.707, 0, 0, 0.707]
    for states in ([row], np.array(row, np.float16), np.array([row], ">f4")):
        assert not cg.judge(path, states, **QUICK).unread
    assert not cg.judge(path, np.array([[0, 0, 1, 1, 0, 0, 0]]), **QUICK).unread


def test_no_damaged_file_ends_a_folder(tmp_path, capsys):
    scene(tmp_path / "good.xml", _BOX.format("a", 0, "", ""))
    (tmp_path / "cut.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "latin.urdf").write_bytes(b"<robot name='\xe4'>\xff</robot>")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "good.xml"))
    mujoco.mj_saveModel(model, str(tmp_path / "whole.mjb"))
    (tmp_path / "half.mjb").write_bytes((tmp_path / "whole.mjb").read_bytes()[:700])
    (tmp_path / "empty.mjb").write_bytes(b"")
    (tmp_path / "cut.world").write_text("<sdf><world name='w'><model name='a'>")
    (tmp_path / "lost.sdf").write_text(
        "<sdf version='1.9'><world name='w'><include><uri>model://gone</uri></include></world></sdf>"
    )
    report = cg.judge(tmp_path, **QUICK)
    bad = {"cut.xml", "latin.urdf", "half.mjb", "empty.mjb", "cut.world", "lost.sdf"}
    assert {path.name for path in report.unread} == bad
    assert {each.file.name for each in report.starts} == {"good.xml", "whole.mjb"}
    assert sum(row["error"] is not None for row in report.rows.to_pylist()) == len(bad)
    assert main(["judge", str(tmp_path), "--seconds", "0.1"]) == 1
    assert "model://gone" in capsys.readouterr().out
    assert main(["judge", str(tmp_path / "good.xml"), "--seconds", "0.1"]) == 0


_STAGE = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
)
def Xform "body" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
{
    def Mesh "mesh" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        %s
    }
}
"""
_POINTS = "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, %s)]\n"
_FACES = "int[] faceVertexCounts = [3, 3, 3, 3]\n"
_FACES += "int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, %d]"


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("", "a mesh of 0 points"),
        (_POINTS % "nan", "a mesh of 4 points"),
        (_POINTS % 1, "faces do not fit"),
        (_POINTS % 1 + _FACES % 9, "faces do not fit"),
        (_POINTS % 0 + _FACES % 3, "not convex"),
        ("double oops =", "Expected"),
    ],
)
def test_usd_says_what_is_wrong_with_it(tmp_path, inside, said):
    pytest.importorskip("pxr", reason="needs the extra usd")
    (tmp_path / "bad.usda").write_text(_STAGE % inside)
    (tmp_path / "good.usda").write_text(_STAGE % (_POINTS % 1 + _FACES % 3))
    report = cg.judge(tmp_path, **QUICK)
    assert [each.file.name for each in report.starts] == ["good.usda"]
    ((path, reason),) = report.unread.items()
    assert path.name == "bad.usda"
    assert said in reason


def test_usd_that_refers_to_what_is_not_there_is_not_judged_without_it(tmp_path):
    pytest.importorskip("pxr", reason="needs the extra usd")
    text = _STAGE % (_POINTS % 1 + _FACES % 3) + 'def Xform "more" (references = @gone.usda@) {}\n'
    (tmp_path / "part.usda").write_text(text)
    (reason,) = cg.judge(tmp_path, **QUICK).unread.values()
    assert "@gone.usda@" in reason


def test_shapes_are_those_that_collide_with_anything(tmp_path):
    both = '<geom name="seen" type="box" size=".1 .1 .1" contype="0" conaffinity="0"/>'
    path = scene(
        tmp_path / "s.xml", _BOX.format("a", 0, 'name="hit" contype="0" conaffinity="4"', both)
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    found = find_free_bodies(model)
    assert [model.geom(int(each)).name for each in np.flatnonzero(found.is_shape)] == [
        "floor",
        "hit",
    ]
    assert found.notes == ()
