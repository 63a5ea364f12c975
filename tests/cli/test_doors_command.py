"""A cupboard whose doors are closed when all objects are placed, through the commands that a user runs."""

import json
import re

import mujoco
import numpy as np
import pytest
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.doors import are_closed
from cluttergen_jax.cli.main import main
from cluttergen_jax.generation.sources import open_source
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.physics.doors import DoorCloser
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.scene import read_scenes

SETTINGS = ["--objects", "mug", "bowl", "soup_can", "--support", "cupboard"]
RANDOM = ["--method", "random", "--max-attempts", "10", "--budget", "200"]
HITS = {f"door_{side} hits {name}" for side in ("left", "right") for name in ("mug", "soup_can")}
TRAVEL = 0.322
"""Metres by which the drawer opens."""


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("doors") / "bank"
    asked = [*SETTINGS, "--surface", "drawer:1,shelf_1:2", "--no-render", *RANDOM]
    assert main(["generate", "-n", "4", *asked, "--out", str(path)]) == 0
    return read_bank(path)


def test_all_doors_are_closed_and_the_bank_says_so(bank, capsys):
    rows = bank.table.to_pylist()
    assert all(row["is_success"] and row["joints"] == [0.0, 0.0, 0.0] for row in rows)
    assert bank.recipe["placement"]["doors"] == "closed"
    assert bank.spec.doors == "closed"
    assert are_closed(bank.support)
    assert not are_closed(bank.open_support)
    assert main(["stats", str(bank.path)]) == 0
    assert "doors      all closed at once" in capsys.readouterr().out
    assert main(["stats", str(bank.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["door_hits"] == {}
    assert "door_left hits mug" in (bank.path / "README.md").read_text()


def test_what_is_in_the_cupboard_is_behind_its_closed_front(bank):
    front = min(box.outline[:, 1].min() for box in bank.support.boxes)
    for scene in read_scenes(bank):
        for asset, pose in zip(scene.objects, scene.poses, strict=True):
            assert transform_points(pose, asset.vertices)[:, 1].min() > front
        opened = scene.open_doors()
        moved = opened.poses[:, 1] - scene.poses[:, 1]
        # One object is in the drawer and comes out with it; what is on the shelf stays.
        np.testing.assert_allclose(sorted(moved), [-TRAVEL, 0, 0], atol=1e-6)


def test_scenes_stand_closed_for_ten_seconds_and_are_drawn_anew_to_the_bit(bank, capsys):
    assert main(["verify", str(bank.path), "--seconds", "10"]) == 0
    assert "4 of 4 scenes stand for 10 s" in capsys.readouterr().out
    source, _ = open_source(str(bank.path))
    # `replay` refuses what ends elsewhere.
    assert source.replay(1).is_success


@pytest.mark.parametrize("joints", [[], ["--joints"]])
def test_exports_stand_in_mujoco_with_their_doors_closed(bank, joints, tmp_path):
    out = tmp_path / "out"
    words = ["export", str(bank.path), *joints, "--out", str(out), "--scenes", "0"]
    assert main(words) == 0
    model = mujoco.MjModel.from_xml_path(str(out / "scenes" / "000000.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    start = data.qpos.copy()
    while data.time < 10:
        mujoco.mj_step(model, data)
    is_free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    np.testing.assert_allclose(data.qpos[model.jnt_qposadr[~is_free]], 0.0, atol=1e-3)
    assert (~is_free).sum() == (3 if joints else 0)
    for address in model.jnt_qposadr[is_free]:
        moved = np.linalg.norm((data.qpos - start)[address : address + 3])
        assert moved < 0.005


@pytest.mark.slow
def test_pictures_show_doors_closed_and_where_asked_open(bank, tmp_path):
    for state in ("closed", "open"):
        asked = ["--doors", state, "--scenes", "0", "--segmentation", "--no-picture"]
        assert main(["render", str(bank.path), *asked, "--out", str(tmp_path / state)]) == 0
    seen = {
        state: set(np.unique(np.array(Image.open(tmp_path / state / "000000-segmentation.png"))))
        for state in ("closed", "open")
    }
    # Nothing but the floor and the cupboard, and what is in the drawer once it is open.
    assert seen["closed"] == {0, 1}
    assert seen["open"] > {0, 1}


@pytest.mark.slow
def test_what_is_placed_later_is_placed_with_the_doors_open_again(bank, tmp_path):
    more = cg.generate(
        tmp_path / "more",
        objects=("water_glass",),
        support="cupboard",
        surface="shelf_2",
        start=f"{bank.path}:0",
        method="random",
        max_attempts=10,
        num_scenes=2,
        render=False,
    )
    before = bank.rows([0])[0]
    for row in more.scenes():
        assert row.is_success
        for name, pose in zip(before.objects, before.poses, strict=True):
            place = row.objects.index(name)
            np.testing.assert_allclose(row.poses[place, :3], pose[:3], atol=0.001)


@pytest.mark.slow
def test_doors_stay_open_where_that_is_asked_for(tmp_path):
    out = tmp_path / "open"
    assert (
        main(
            [
                "generate",
                "-n",
                "2",
                *SETTINGS,
                "--doors",
                "open",
                "--max-files",
                "0",
                "--out",
                str(out),
            ]
        )
        == 0
    )
    bank = read_bank(out)
    assert "joints" not in bank.table.schema.names
    assert not are_closed(bank.support)


@pytest.mark.parametrize("setting", ["paper", "default"])
def test_what_a_door_hits_is_said_and_placed_again(setting, tmp_path, capsys, monkeypatch):
    # Attempts in the way of a door are refused at once; without that, closing finds them.
    monkeypatch.setattr(DoorCloser, "is_in_the_way", lambda *_: False)
    out = tmp_path / "front"
    asked = ["--objects", "mug", "soup_can", "--support", "cupboard", "--region", "0,-0.16,0.6,0.1"]
    again = ["--setting", setting, "--ruin-after", "0" if setting == "paper" else "5"]
    asked += [*again, *RANDOM, "--max-files", "0"]
    assert main(["generate", "-n", "6", *asked, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    bank = read_bank(out)
    hits = bank.table["door_hit"].to_pylist()
    assert any(text in HITS for text in hits)
    assert re.search(r"doors      blocked \d+ times?: door_\w+ hits \w+ \(\d\)", said)
    if setting == "default":
        assert all(bank.table["is_success"].to_pylist())
        return
    for row, text in zip(bank.scenes(), hits, strict=True):
        assert (row.verdict == "blocked") == (not row.is_success) == bool(text)
        if text:
            # Where a door stands open it is drawn so.
            assert not are_closed(bank.support_of(row))
    assert main(["stats", str(out)]) == 0
    assert "blocked" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--support", "bookcase", "--doors", "closed"], "'bookcase', which has no joints"),
        (
            ["--support", "cupboard", "--objects", "mug", "--method", "pile"],
            "with doors that are to be closed",
        ),
        (
            ["--support", "cupboard", "--objects", "mug", "--engine", "jax"],
            "engine 'jax' with doors",
        ),
        (["--support", "cupboard", "--objects", "bottle"], "too tall for shelf_1"),
    ],
)
def test_what_cannot_be_is_said_before_work(asked, said, tmp_path, capsys):
    assert main(["generate", "-n", "1", *asked, "--out", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
