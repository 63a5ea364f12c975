"""Repair: what stands is left, what is disturbed stands again nearby, and what cannot be placed is named."""

import json

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, rotation_matrix, turn_between
from cluttergen_jax.placement.repair import MAX_TILT, put_upright
from studies.benchmarks.repair import rests_on, write_disturbed


def test_an_orientation_loses_its_tilt_by_the_least_turn():
    draw = np.random.default_rng(0)
    for _ in range(200):
        axis = draw.normal(size=3)
        yaw = draw.uniform(-np.pi, np.pi)
        angle = draw.uniform(0, np.pi)
        axis /= np.linalg.norm(axis)
        tilted = product(
            np.array([np.cos(angle / 2), *np.sin(angle / 2) * axis]),
            np.array([np.cos(yaw), 0, 0, np.sin(yaw)]),
        )
        tilt = np.arccos(np.clip(rotation_matrix(tilted)[2, 2], -1, 1))
        upright = put_upright(tilted)
        if tilt > MAX_TILT + 1e-9:
            assert upright is tilted
        else:
            np.testing.assert_allclose(rotation_matrix(upright)[2], [0, 0, 1], atol=1e-9)
            np.testing.assert_allclose(turn_between(np, upright, tilted), tilt, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "no layout"),
        ('{"objects": []}', "no objects"),
        ('{"objects": [{"name": "mug"}]}', "position"),
        ('{"objects": [{"name": "mug", "position": [0, 0, 1]}]}', "names no pool"),
        (
            '{"pool": "dining", "support": "table", "objects": [{"name": "mug", "position": [0, 0]}]}',
            "no layout",
        ),
        (
            '{"pool": "dining", "support": "table", "objects": [{"name": "mug", "position": [0, 0, 1],'
            ' "quaternion_wxyz": [0, 0, 0, 0]}]}',
            "no direction",
        ),
        (
            '{"pool": "dining", "support": {"name": "table", "region": {"half_extents": [0.2, 0.25]}}, '
            '"objects": [{"name": "mug", "position": [0, 0, 1]}]}',
            "region of 0.4 x 0.5 m",
        ),
    ],
)
def test_a_file_that_is_no_layout_is_refused(tmp_path, text, said):
    (tmp_path / "layout.json").write_text(text)
    with pytest.raises(ConfigError, match=said):
        cg.repair(tmp_path / "layout.json", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def layout(path, *objects):
    """A file of objects: name, x, y, and height of the origin above the table's top."""
    entries = [
        {"name": name, "asset": name.split(".")[0], "position": [x, y, 0.7 + z]}
        for name, x, y, z in objects
    ]
    path.write_text(json.dumps({"pool": "dining", "support": "table", "objects": entries}))
    return path


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Five scenes of five objects on a small table, three of them on others."""
    path = tmp_path_factory.mktemp("repair") / "bank"
    return cg.generate(
        path,
        num_scenes=5,
        num_objects=5,
        support="table-0.30x0.40",
        clutter="stack=2",
        render=False,
    )


@pytest.mark.slow
def test_noise_is_repaired_nearby_and_what_lay_on_what_does_so_again(bank, tmp_path):
    (tmp_path / "noisy").mkdir()
    scenes = list(cg.read_scenes(bank))
    write_disturbed(scenes, tmp_path / "noisy", "table-0.30x0.40", 10.0, 10.0, 0)
    report = cg.repair(tmp_path / "noisy", tmp_path / "out")
    assert all(each.is_stable for each in report.layouts)
    assert cg.verify(tmp_path / "out").is_sound
    shift = np.concatenate([each.shift for each in report.layouts])
    assert np.median(shift) < 0.01
    assert shift.max() <= 0.05
    wanted = 0
    kept = 0
    for scene, each in zip(scenes, report.layouts, strict=True):
        before = json.loads((tmp_path / "noisy" / each.layout.source).read_text())["objects"]
        given = np.array([entry["position"] for entry in before])
        np.testing.assert_allclose(
            np.linalg.norm(each.poses[:, :3] - given, axis=1), each.shift, atol=1e-6
        )
        now = cg.Scene(
            scene.names, scene.objects, each.poses, scene.support, scene.stability, scene.contact
        )
        wanted = wanted + len(rests_on(scene))
        kept = kept + len(rests_on(scene) & rests_on(now))
    assert wanted >= 5
    assert kept / wanted >= 0.9
    # The same command again makes nothing new, and tells the same.
    again = cg.repair(tmp_path / "noisy", tmp_path / "out")
    assert str(again) == str(report)
    assert again.rows.equals(report.rows)


@pytest.mark.slow
def test_what_is_stable_is_left_to_the_bit(bank, tmp_path):
    report = cg.repair(bank.path, tmp_path / "out")
    before, after = (cg.read_bank(path).rows(range(5)) for path in (bank.path, tmp_path / "out"))
    assert all(each.is_stable for each in report.layouts)
    for index in range(5):
        old = dict(zip(before[index].objects, before[index].poses, strict=True))
        new = dict(zip(after[index].objects, after[index].poses, strict=True))
        assert {name: pose.tobytes() for name, pose in old.items()} == {
            n: p.tobytes() for n, p in new.items()
        }


def test_a_file_that_is_there_is_replaced_only_where_that_is_asked(tmp_path):
    path = layout(tmp_path / "good.json", ("mug", 0, 0, 0.2))
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=r"which exists.*`overwrite`"):
        cg.repair(path, path)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_objects_on_several_boards_are_repaired_on_their_own(tmp_path):
    support = find_support("bookcase")
    boards = [each.position for each in support.surfaces]
    half = {each.name: each.half_extents[2] for each in find_pool("dining").objects}
    names = sorted(half, key=half.__getitem__)[: len(boards)]
    entries = [
        {"name": name, "position": [*board[:2], board[2] + half[name] + 0.01]}
        for name, board in zip(names, boards, strict=False)
    ]
    path = tmp_path / "shelf.json"
    path.write_text(json.dumps({"pool": "dining", "support": "bookcase", "objects": entries}))
    report = cg.repair(path, tmp_path / "fixed.json")
    assert report.layouts[0].is_stable
    assert report.layouts[0].shift.max() < 0.02
    heights = {round(float(pose[2]), 1) for pose in report.layouts[0].poses}
    assert len(heights) >= len(boards) - 1


@pytest.mark.slow
def test_a_file_becomes_a_file_and_what_cannot_be_placed_is_named(tmp_path, capsys):
    good = layout(
        tmp_path / "good.json",
        ("mug.a", 0, 0, 0.2),
        ("mug.b", 0.02, 0, 0.04),
        ("fork", 0.2, 0, -0.05),
    )
    words = ["repair", str(good), "--out", str(tmp_path / "fixed.json"), "--max-shift", "0.2"]
    assert main(words) == 0
    fixed = json.loads((tmp_path / "fixed.json").read_text())
    assert fixed["is_stable"]
    assert [entry["name"] for entry in fixed["objects"]] == ["mug.a", "mug.b", "fork"]
    # It is a layout again, and a stable one.
    report = cg.repair(tmp_path / "fixed.json", tmp_path / "bank")
    assert report.layouts[0].shift.max() < 1e-6
    # Beyond the edge of the table, farther than it may be moved.
    bad = layout(tmp_path / "bad.json", ("mug", 0, 0, 0.05), ("soup_can", 0.5, 0, 0.05))
    assert main(["repair", str(bad), "--out", str(tmp_path / "half.json")]) == 1
    assert "no stable place near its own for soup_can" in capsys.readouterr().out
    half = json.loads((tmp_path / "half.json").read_text())
    assert [entry["is_placed"] for entry in half["objects"]] == [True, False]
    assert half["objects"][1]["position"] == [0.5, 0, 0.75]
