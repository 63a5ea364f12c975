"""Where scenes to look at come from, what is said of them, and how the viewer refuses what cannot be."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cluttergen_jax.api.render import render
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import AssetError, BankError, ConfigError
from cluttergen_jax.generation.sources import BankSource, open_source
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene
from tests.helpers.drawing import needs_gl

GENERATE = [
    "generate",
    "--objects",
    "mug",
    "bowl",
    "--support",
    "table-0.20x0.24",
    "--method",
    "random",
]


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Four scenes of two objects on a table so small that some fail."""
    path = tmp_path_factory.mktemp("view") / "bank"
    assert (
        main([*GENERATE, "--out", str(path), "-n", "4", "--max-attempts", "2", "--no-render"]) == 0
    )
    return path


@pytest.fixture(scope="module")
def source(bank):
    return open_source(str(bank))[0]


def test_attempts_are_made_again_and_end_in_the_stored_scene(source):
    assert source.numbers == (0, 1, 2, 3)
    for number in source.numbers:
        stored = source.still(number)
        recording = source.replay(number)
        assert not stored.attempts
        assert recording.attempts
        assert (stored.is_success, stored.verdict) == (recording.is_success, recording.verdict)
        ends = {recording.names[i]: recording.poses[i] for i in recording.placed}
        assert list(ends) == sorted(stored.names, key=recording.names.index)
        for name, pose in zip(stored.names, stored.poses, strict=True):
            np.testing.assert_array_equal(ends[name], pose)
        assert stored.region == source.still(0).region
        assert recording.region.half_extents == pytest.approx((0.1, 0.12))


def test_a_scene_that_ends_elsewhere_is_not_passed_off(bank, source, monkeypatch):
    honest = BankSource.still

    def moved(self, number):
        stored = honest(self, number)
        return replace(stored, poses=stored.poses + np.float32(1e-6))

    monkeypatch.setattr(BankSource, "still", moved)
    with pytest.raises(BankError, match="ends elsewhere"):
        source.replay(int(source.successes[0]))


def test_scene_file_is_read_as_the_bank_has_it(bank, source, tmp_path):
    number = int(source.successes[0])
    file = bank / "scenes" / f"{number:06d}.xml"
    scene = read_mjcf_scene(file)
    stored = source.still(number)
    assert scene.names == stored.names
    np.testing.assert_allclose(scene.poses, stored.poses, atol=1e-6)
    assert scene.support.top == pytest.approx(stored.support.top, abs=0.001)
    assert scene.support.region.half_extents == pytest.approx((0.1, 0.12), abs=1e-3)
    for ours, theirs in zip(scene.objects, stored.objects, strict=True):
        assert ours.mass == pytest.approx(theirs.mass)
        np.testing.assert_allclose(ours.half_extents, theirs.half_extents, atol=1e-5)
        np.testing.assert_allclose(ours.inertia, theirs.inertia, rtol=1e-4, atol=1e-9)
        assert len(ours.pieces) == len(theirs.pieces)
        # The cloud lies on the surface: no point is far from the bank's own cloud.
        gaps = np.linalg.norm(ours.cloud[:100, None] - theirs.cloud[None], axis=-1).min(1)
        assert gaps.max() < 0.02
    elsewhere = tmp_path / "plain.xml"
    elsewhere.write_text(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    with pytest.raises(AssetError, match="move freely"):
        open_source(str(elsewhere))
    elsewhere.write_text("<mujoco>")
    with pytest.raises(AssetError, match="cannot be compiled"):
        open_source(str(elsewhere))


@needs_gl
def test_render_writes_what_is_asked_for(bank, source, tmp_path):
    number = int(source.successes[0])
    quick = [
        "--size",
        "96x72",
        "--samples",
        "1",
        "--fps",
        "4",
        "--seconds",
        "1",
        "--out",
        str(tmp_path),
    ]
    asked = [
        "--turntable",
        "--replay",
        "--depth",
        "--segmentation",
        "--points",
        "--bop",
        "--views",
        "2",
    ]
    assert main(["render", f"{bank}:{number}", *asked, *quick]) == 0
    endings = [
        ".png",
        "-depth.png",
        "-segmentation.png",
        "-camera.json",
        "-sensors.npz",
        "-points.ply",
        "-turntable.gif",
        "-replay.gif",
    ]
    assert {each.name for each in tmp_path.iterdir()} == {
        f"{number:06d}{ending}" for ending in endings
    } | {"bop"}
    views = tmp_path / "bop" / "train_synt" / f"{number:06d}" / "rgb"
    assert [each.name for each in sorted(views.iterdir())] == ["000000.png", "000001.png"]
    with pytest.raises(ConfigError, match="views = 0"):
        render(bank, bop=True, views=0)
    assert main(["render", str(bank), "--sheet", *quick]) == 0
    other = tmp_path / "other bank"
    shutil.copytree(bank, other)
    assert main(["render", str(other), "--sheet", *quick]) == 0
    sheets = {each.name for each in tmp_path.glob("*sheet.png")}
    assert sheets == {f"{bank.name}-sheet.png", "other-bank-sheet.png"}


@needs_gl
def test_cameras_and_qualities_of_pictures(bank, source, tmp_path):
    number = int(source.successes[0])
    asked = {
        "scenes": [number],
        "depth": True,
        "cameras": ("overhead", "free"),
        "size": "80x60",
        "seed": 2,
    }

    def drawn(quality):
        out = tmp_path / quality
        report = render(bank, out, quality=quality, **asked)
        assert not report.failures
        stems = {name: out / f"{number:06d}-{name}" for name in ("overhead", "free")}
        ends = (".png", "-depth.png", "-camera.json", "-sensors.npz")
        assert {str(path) for path in report.paths} == {
            f"{stem}{end}" for stem in stems.values() for end in ends
        }
        told = [json.loads(Path(f"{stem}-camera.json").read_text()) for stem in stems.values()]
        assert told[0]["T_world_camera"] != told[1]["T_world_camera"]
        picture = np.array(Image.open(f"{stems['free']}.png")).astype(int)
        with np.load(f"{stems['free']}-sensors.npz") as sensors:
            # The same camera saw both.
            assert np.abs(sensors["rgb"] - picture).mean() < 8
        return picture

    draft = drawn("draft")
    fine = drawn("fine")
    assert draft.shape == fine.shape == (60, 80, 3)
    assert 0 < np.abs(draft - fine).mean() < 20
    with pytest.raises(ConfigError, match="quality = 'best'"):
        render(bank, tmp_path / "none", quality="best")
