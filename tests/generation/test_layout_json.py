"""Layouts in JSON: spellings of a pose that are read, keys that are refused, and why there is no place."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import Pool, find_pool, write_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.generation.layouts import read_layout_json
from cluttergen_jax.generation.repair import hint_for_positions, read_layouts, reason_without_place
from cluttergen_jax.geometry import rotation_matrix, yaw_quaternion
from tests.helpers.worlds import box

CASES = Path(__file__).parents[1] / "cases" / "repair"


def write(path, *entries, **more):
    objects = [{"name": "mug", **entry} for entry in entries]
    path.write_text(json.dumps({"pool": "dining", "support": "table", "objects": objects} | more))
    return path


def pose_of(tmp_path, entry, **more):
    return read_layout_json(write(tmp_path / "a.json", entry, **more)).entries[0].pose


@pytest.mark.parametrize(
    ("entry", "more"),
    [
        ({"position": [0.1, -0.2, 0.75]}, {}),
        ({"position": [0.1, -0.2, 0.75]}, {"unit": "m"}),
        ({"position": [10, -20, 75]}, {"unit": "cm"}),
        ({"position": [10, -20, 75], "unit": "centimetres"}, {}),
        ({"position": [100, -200, 750]}, {"units": "mm"}),
        ({"position_cm": [10, -20, 75]}, {}),
        ({"position_mm": [100, -200, 750]}, {}),
        ({"position_m": [0.1, -0.2, 0.75], "position_cm": [10, -20, 75]}, {}),
        ({"position": {"x": 0.1, "y": -0.2, "z": 0.75}}, {}),
    ],
)
def test_a_position_is_in_the_unit_that_is_stated(tmp_path, entry, more):
    np.testing.assert_allclose(
        pose_of(tmp_path, entry, **more), [0.1, -0.2, 0.75, 1, 0, 0, 0], atol=1e-12
    )


ANGLES = np.array([0.3, -0.5, 1.1])
TURN = Rotation.from_euler("xyz", ANGLES)
YAW = Rotation.from_euler("z", 1.1)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("quaternion_wxyz", TURN.as_quat(scalar_first=True).tolist(), TURN),
        ("quaternion_xyzw", TURN.as_quat().tolist(), TURN),
        ("quat_xyzw", (-TURN.as_quat()).tolist(), TURN),
        ("rpy", ANGLES.tolist(), TURN),
        ("euler_rad", ANGLES.tolist(), TURN),
        ("euler_deg", np.degrees(ANGLES).tolist(), TURN),
        ("rpy_deg", np.degrees(ANGLES).tolist(), TURN),
        ("yaw", 1.1, YAW),
        ("yaw_deg", math.degrees(1.1), YAW),
    ],
)
def test_an_orientation_is_read_by_its_key(tmp_path, key, value, expected):
    pose = pose_of(tmp_path, {"position": [0, 0, 1], key: value})
    np.testing.assert_allclose(rotation_matrix(pose[3:]), expected.as_matrix(), atol=1e-9)


def turn_about(axis, angle):
    """f64[3, 3], written by hand: about x, y or z."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = [c, -s, s, c]
    return matrix


@pytest.mark.parametrize("order", ["xyz", "zyx", "yzx", "zxz", "XYZ", "ZYX", "ZXZ"])
@pytest.mark.parametrize("unit", ["deg", "rad", "degrees"])
def test_angles_are_read_in_the_order_and_the_unit_that_are_stated(tmp_path, order, unit):
    first, second, third = map(turn_about, order.lower(), ANGLES)
    # Turns about axes that turn along are those about fixed axes the other way round.
    expected = first @ second @ third if order.isupper() else third @ second @ first
    given = ANGLES if unit == "rad" else np.degrees(ANGLES)
    entry = {"euler": given.tolist(), "euler_unit": unit, "euler_order": order}
    pose = pose_of(tmp_path, {"position": [0, 0, 1], **entry})
    np.testing.assert_allclose(rotation_matrix(pose[3:]), expected, atol=1e-9)
    if unit == "deg":
        entry = {"euler_deg": given.tolist(), "euler_order": order}
        again = pose_of(tmp_path, {"position": [0, 0, 1], **entry})
        np.testing.assert_allclose(again, pose)


def test_one_turn_needs_no_order(tmp_path):
    pose = pose_of(tmp_path, {"position": [0, 0, 1], "euler": [0, 0, 90], "euler_unit": "deg"})
    np.testing.assert_allclose(pose[3:], yaw_quaternion(math.pi / 2), atol=1e-12)


@pytest.mark.parametrize(
    ("entry", "more", "said"),
    [
        (
            {"quaternion": [1, 0, 0, 0]},
            {},
            r"'quaternion' is not known.*quaternion_wxyz.*quaternion_xyzw",
        ),
        ({"quaternion_wxzy": [1, 0, 0, 0]}, {}, r"Did you mean 'quaternion_wxyz'"),
        ({"euler": [0, 0, 90]}, {}, r"'euler' is not known. Did you mean 'euler_deg'"),
        ({"scale": 2}, {}, r"'scale' is not known"),
        ({"yaw": 90}, {}, r"yaw = 90.*Did you mean 'yaw_deg'"),
        ({"rpy": [0, 0, 90]}, {}, r"Did you mean 'rpy_deg'"),
        ({"yaw_deg": 90, "quaternion_wxyz": [1, 0, 0, 0]}, {}, "say different things"),
        ({"position_cm": [0, 0, 1]}, {}, "say different things"),
        ({"unit": "cm"}, {"unit": "mm"}, "one unit"),
        ({}, {"unit": "inch"}, "m, cm, mm"),
        ({"position_m": [0, 0, 1]}, {"unit": "cm"}, "one unit"),
        ({}, {"suport": "table"}, r"'suport' is not known. Did you mean 'support'"),
        ({}, {"gravity": [0, 0, -9.8]}, "'gravity' is not known"),
        ({"quaternion_wxyz": [0, 0, 0, 0]}, {}, "no direction"),
        ({"euler": [0, 0, 90], "euler_order": "xyz"}, {}, "'euler' is not known"),
        ({"euler": [0, 0, 90], "euler_unit": "turns"}, {}, "euler_unit = 'turns'.*deg"),
        ({"euler": [10, 0, 90], "euler_unit": "deg"}, {}, "several turns without its order"),
        ({"euler_deg": [10, 0, 90], "euler_order": "xxy"}, {}, "euler_order = 'xxy'"),
        ({"euler_deg": [10, 0, 90], "euler_order": "xYz"}, {}, "euler_order = 'xYz'"),
        ({"euler": [0, 0, 90], "euler_unit": "rad"}, {}, "more than a full turn"),
        ({"euler_order": "xyz", "yaw_deg": 3}, {}, "euler_order without angles"),
        ({"quaternion_wxyz": ["1", 0, 0, 0]}, {}, "4 numbers"),
        ({"yaw_deg": [90]}, {}, r"yaw_deg = \[90\].*one number"),
        ({"rotation": [0, 0, 90]}, {}, "Did you mean 'rpy_deg'"),
        ({"rotation": [1, 0, 0, 0]}, {}, "Did you mean 'quaternion_wxyz'"),
        ({"angle": 90}, {}, "Did you mean 'yaw_deg'"),
        ({"orientation": {"yaw": 90}}, {}, r"'orientation' is not known\. Allowed"),
        ({"id": 3}, {}, r"'id' is not known\. Allowed"),
        ({"position": [0, 0, True]}, {}, "3 numbers"),
        ({"name": ""}, {}, "name"),
        ({}, {"support": {"name": "table", "colour": "red"}}, "'colour' is not known"),
    ],
)
def test_what_is_not_understood_is_refused_by_its_name(tmp_path, entry, more, said):
    path = write(tmp_path / "a.json", {"position": [0, 0, 1]} | entry, **more)
    with pytest.raises(ConfigError, match=said):
        read_layout_json(path)


@pytest.mark.parametrize(
    "text",
    [
        '{"pool": "dining", "pool": "study", "objects": []}',
        '{"objects": [{"name": "mug", "position": [0, 0, NaN]}]}',
        '{"objects": [{"name": "mug", "position": [0, 0, 1e999]}]}',
        '{"objects": {"mug": [0, 0, 1]}}',
        '{"objects": [["mug"]]}',
        '{"objects": [{"name": "mug", "position": [0, 0, 1' + "0" * 400 + "]}]}",
        "[" * 100_000,
        "\ud83d".encode("utf-8", "surrogatepass").decode("latin-1"),
        "",
    ],
)
def test_what_is_no_layout_ends_in_a_sentence(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError):
        read_layout_json(tmp_path / "a.json")


def test_an_order_of_a_quaternion_in_which_it_lies_is_told(tmp_path):
    half = math.sqrt(0.5)
    entry = {"position": [0, 0, 1], "quaternion_wxyz": [0, 0, half, half]}
    (note,) = read_layout_json(write(tmp_path / "a.json", entry)).notes
    assert "in the order of quaternion_xyzw it is upright" in note
    (note,) = read_layout_json(
        write(tmp_path / "a.json", {"position": [0, 0, 1], "quat_wxyz": [2, 0, 0, 0]})
    ).notes
    assert "of length 2" in note
    # What lies in both orders is meant to lie.
    entry = {"position": [0, 0, 1], "quaternion_wxyz": [half, half, 0, 0]}
    assert read_layout_json(write(tmp_path / "a.json", entry)).notes == ()


def test_the_case_of_a_quaternion_xyzw_is_read():
    (entry,) = read_layout_json(CASES / "quaternion_xyzw.json").entries
    assert entry.pose[3:].tolist() == [1, 0, 0, 0]


def test_a_quaternion_xyzw_turns_what_is_repaired(tmp_path):
    turn = yaw_quaternion(1.0)
    entry = {"position": [0, 0, 0.75], "quaternion_xyzw": [*turn[1:], turn[0]]}
    report = cg.repair(
        write(tmp_path / "a.json", entry, support="table-0.60x0.60"), tmp_path / "b.json"
    )
    (fixed,) = json.loads((tmp_path / "b.json").read_text())["objects"]
    assert report.layouts[0].is_stable
    np.testing.assert_allclose(np.abs(np.array(fixed["quaternion_wxyz"]) @ turn), 1, atol=1e-4)
    # What it writes is a layout that it reads.
    assert read_layout_json(tmp_path / "b.json").entries[0].name == "mug"


def test_heights_above_the_table_are_told_as_such(tmp_path, capsys):
    assert (
        main(["repair", str(CASES / "z_from_table_top.json"), "--out", str(tmp_path / "a.json")])
        == 1
    )
    said = capsys.readouterr().out
    assert "mug (0.75 m under the top of" in said
    assert "measured from its top" in said
    written = json.loads((tmp_path / "a.json").read_text())
    assert ["under" in each["reason"] for each in written["objects"]] == [True, True]


@pytest.mark.parametrize(
    ("position", "said"),
    [
        ((0, 0, 0.2), r"0.55 m under the top of 'table'"),
        ((0, 0, 1.5), r"0.75 m above the top"),
        ((0.8, 0, 0.75), r"0.49 m beyond the edge of 'table'$"),
        ((0.8, 0, 0), r"beyond the edge of 'table' and 0.75 m under"),
        ((0.1, 0.1, 0.76), r"too little room within 0.05 m"),
    ],
)
def test_why_there_is_no_place(position, said):
    mug = find_pool("dining")["mug"]
    table = find_support("table-0.60x0.60")
    pose = np.array([*position, 1, 0, 0, 0])
    reason = reason_without_place(mug, pose, table, 0.05)
    assert re.search(said, reason), reason


def test_a_board_of_several_is_named():
    mug = find_pool("dining")["mug"]
    shelf = find_support("bookcase").on_surface("all")
    board = shelf.surfaces[1]
    x, y, z = board.position
    pose = np.array([x, y, z + 0.2, 1, 0, 0, 0])
    assert repr(board.name) in reason_without_place(mug, pose, shelf, 0.05)


@pytest.mark.parametrize(("factor", "unit"), [(100.0, "cm"), (1000.0, "mm")])
def test_other_units_are_asked_for_where_all_would_fit(factor, unit):
    pool = find_pool("dining")
    table = find_support("table-0.60x0.60")
    objects = [pool["mug"], pool["bowl"]]
    poses = np.array([[0.1, 0, 0.75, 1, 0, 0, 0], [-0.1, 0.1, 0.74, 1, 0, 0, 0]])
    assert hint_for_positions(objects, poses, table, True) == ""
    poses[:, :3] *= factor
    assert f'"unit": "{unit}"' in hint_for_positions(objects, poses, table, True)
    assert hint_for_positions(objects, poses, table, False) == ""
    poses[0, 0] += factor
    assert hint_for_positions(objects, poses, table, True) == ""


@pytest.mark.parametrize(
    ("given", "more"),
    [("coffee mug", {}), ("mug_1", {}), ("my cup", {"asset": "mugg"})],
)
def test_an_object_that_is_not_in_the_pool_is_named_with_its_file_and_its_asset(
    tmp_path, given, more
):
    path = write(tmp_path / "a.json", {"name": given, "position": [0, 0, 0.75]} | more)
    with pytest.raises(PoolError, match=rf"a\.json: '{given}': .*Did you mean 'mug'") as caught:
        read_layouts(path, None, None, None)
    advised = json.loads("{" + re.search(r'"asset": "\w+"', str(caught.value))[0] + "}")
    write(path, {"name": given, "position": [0, 0, 0.75]} | advised)
    assert [asset.name for asset in read_layouts(path, None, None, None).layouts[0].objects] == [
        "mug"
    ]


def test_what_an_object_overlaps_is_told_with_its_depth(tmp_path):
    """Two plates in each other and a mug in both, with no room to move."""
    height = find_support("table").top
    plates = [
        {"name": name, "asset": "dinner_plate", "position": [0, 0, height + 0.011]}
        for name in ("mine", "yours")
    ]
    entries = [*plates, {"name": "mug", "position": [0.02, 0, height + 0.048]}]
    path = write(tmp_path / "a.json", *entries)
    report = cg.repair(path, tmp_path / "b.json", max_shift=0.001)
    (layout,) = report.layouts
    assert not layout.is_stable
    reasons = dict(zip(layout.layout.names, layout.reasons, strict=True))
    told = " ".join(reasons.values())
    depths = [float(found) for found in re.findall(r"by (\d+) mm", told)]
    assert re.search(r"overlaps '(mine|yours|mug)' by \d+ mm", told), told
    # None is deeper in another than it is tall.
    assert 1 <= min(depths) <= max(depths) <= 100
    # What found a place has no reason.
    assert all(
        not why for why, there in zip(layout.reasons, layout.is_placed, strict=True) if there
    )


def test_an_overlap_is_as_deep_as_two_boxes_are_in_each_other(tmp_path):
    folder = write_pool(tmp_path / "boxes", Pool("boxes", (box("block", (0.05, 0.05, 0.05)),)))
    height = find_support("table").top + 0.05
    entries = [
        {"name": name, "asset": "block", "position": [x, 0, height]}
        for name, x in (("one", 0.0), ("two", 0.069), ("far", -0.2))
    ]
    path = write(tmp_path / "a.json", *entries, pool=str(folder))
    (layout,) = cg.repair(path, tmp_path / "b.json", max_shift=0.001).layouts
    told = dict(zip(layout.layout.names, layout.reasons, strict=True))
    assert told["far"] == ""
    assert sorted(filter(None, told.values())) in (
        ["overlaps 'one' by 31 mm: too little room within 0.001 m, or it does not stay there"],
        ["overlaps 'two' by 31 mm: too little room within 0.001 m, or it does not stay there"],
    )
