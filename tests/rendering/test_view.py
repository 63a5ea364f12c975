"""Where scenes to look at come from, what is said of them, and how the viewer refuses what cannot be."""

import os
import shutil
import socket
import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from cluttergen_jax.api.render import render
from cluttergen_jax.api.text import parse_size
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import AssetError, BankError, ConfigError, MissingExtraError, PoolError
from cluttergen_jax.generation.sources import BankSource, LiveConfig, LiveSource, open_source
from cluttergen_jax.generation.sources.rendering import chosen_numbers
from cluttergen_jax.generation.sources.viewing import native_model
from cluttergen_jax.rendering.viewer.viewer import DisplayError, check_display, free_port, open_server
from cluttergen_jax.rendering.viewer.words import attempt_words, scene_words
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene
from tests.helpers.drawing import needs_gl
from tests.helpers.recordings import cubes

GENERATE = ["generate", "--objects", "mug", "bowl", "--support", "table-0.20x0.24", "--method", "random"]


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Four scenes of two objects on a table so small that some fail."""
    path = tmp_path_factory.mktemp("view") / "bank"
    assert main([*GENERATE, "--out", str(path), "-n", "4", "--attempts", "2", "--no-render"]) == 0
    return path


@pytest.fixture(scope="module")
def source(bank):
    return open_source(str(bank))[0]


def test_attempts_are_made_again_and_end_in_the_stored_scene(source):
    assert source.numbers == (0, 1, 2, 3)
    for number in source.numbers:
        stored, recording = source.still(number), source.replay(number)
        assert not stored.attempts
        assert recording.attempts
        assert (stored.is_success, stored.verdict) == (recording.is_success, recording.verdict)
        ends = {recording.names[i]: recording.poses[i] for i in recording.placed}
        assert list(ends) == sorted(stored.names, key=recording.names.index)
        for name, pose in zip(stored.names, stored.poses, strict=True):
            np.testing.assert_array_equal(ends[name], pose)
        assert stored.region == source.still(0).region
        assert recording.region.half_extents == pytest.approx((0.1, 0.12))


def test_proposals_are_drawn_beside_the_attempt_and_change_nothing(source):
    plain, drawn = source.replay(0), source.replay(0, 16)
    assert all(attempt.proposals is None for attempt in plain.attempts)
    for one, other in zip(plain.attempts, drawn.attempts, strict=True):
        np.testing.assert_array_equal(one.trajectory, other.trajectory)
        assert other.proposals.shape == (16, 4)
        assert ((other.proposals >= 0) & (other.proposals <= 1)).all()
        assert len(np.unique(other.proposals, axis=0)) == 16


def test_a_scene_that_ends_elsewhere_is_not_passed_off(bank, source, monkeypatch):
    honest = BankSource.still

    def moved(self, number):
        stored = honest(self, number)
        return replace(stored, poses=stored.poses + np.float32(1e-6))

    monkeypatch.setattr(BankSource, "still", moved)
    with pytest.raises(BankError, match="ends elsewhere"):
        source.replay(int(source.successes[0]))


def test_new_scenes_are_sampled_by_any_method_and_differ_by_seed(source):
    assert source.methods == ("random", "clear", "drop", "spread")
    first, same, other = (source.sample("random", seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.poses, same.poses)
    assert np.abs(first.poses - other.poses).max() > 0.01


def test_arguments_name_banks_and_scenes(bank, source):
    assert open_source(f"{bank}:2")[1] == 2
    number = int(source.successes[0])
    found, own = open_source(str(bank / "scenes" / f"{number:06d}.xml"))
    assert (type(found), own) == (BankSource, number)
    with pytest.raises(PoolError, match="no bank, no scene"):
        open_source(str(bank.parent))
    with pytest.raises(BankError, match="no scene 9"):
        source.still(9)


def test_empty_bank_is_refused(bank, tmp_path):
    (tmp_path / "bank.json").write_text((bank / "bank.json").read_text())
    with pytest.raises(BankError, match="no scenes"):
        open_source(str(tmp_path))
    assert main(["view", str(tmp_path), "--port", "0", "--no-browser"]) == 2
    assert main(["render", str(tmp_path)]) == 2


def test_scene_file_is_read_as_the_bank_has_it(bank, source, tmp_path):
    number = int(source.successes[0])
    file = bank / "scenes" / f"{number:06d}.xml"
    scene, stored = read_mjcf_scene(file), source.still(number)
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
    elsewhere.write_text('<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>')
    with pytest.raises(AssetError, match="move freely"):
        open_source(str(elsewhere))
    elsewhere.write_text("<mujoco>")
    with pytest.raises(AssetError, match="cannot be compiled"):
        open_source(str(elsewhere))


def test_live_source_makes_the_scene_of_a_seed():
    live = LiveSource(LiveConfig(pool="dining", method="random", num_objects=1))
    assert live.methods[0] == "random"
    assert live.numbers[0] == 0
    recording = live.still(3)
    assert len(recording.attempts) >= 1
    np.testing.assert_array_equal(recording.poses, live.sample("random", 3).poses)


def test_live_source_takes_the_embedded_policy():
    live = LiveSource(LiveConfig(method="policy", num_objects=2))
    assert live.methods[0] == "policy"
    with pytest.raises(PoolError, match="no checkpoint"):
        LiveSource(LiveConfig(method="beta", num_objects=2))


def test_scenes_to_draw(source):
    assert chosen_numbers(source, 2, None, 1) == [2]
    assert chosen_numbers(source, None, None, 1) == [source.successes[0]]
    assert chosen_numbers(source, None, None, 12) == list(source.successes)
    assert chosen_numbers(source, None, [0, 2, 3], 1) == [0, 2, 3]
    assert chosen_numbers(source, None, "all", 1) == [0, 1, 2, 3]
    with pytest.raises(ConfigError, match="single scene"):
        chosen_numbers(source, 2, [1], 1)
    assert parse_size("320x200") == (320, 200)
    with pytest.raises(ConfigError, match="pixels"):
        parse_size("320")


@needs_gl
def test_render_writes_what_is_asked_for(bank, source, tmp_path):
    number = int(source.successes[0])
    quick = ["--size", "96x72", "--samples", "1", "--fps", "4", "--seconds", "1", "--out", str(tmp_path)]
    asked = ["--turntable", "--replay", "--depth", "--segmentation", "--points", "--bop", "--views", "2"]
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
    assert {each.name for each in tmp_path.iterdir()} == {f"{number:06d}{ending}" for ending in endings} | {
        "bop"
    }
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


def test_a_figure_that_cannot_be_made_costs_nothing_else(bank, source, tmp_path, capsys):
    asked = ["--scenes", "all", "--figure", "--points", "--no-picture"]
    assert main(["render", str(bank), *asked, "--out", str(tmp_path)]) == 1
    assert {each.name for each in tmp_path.iterdir()} == {f"{k:06d}-points.ply" for k in source.numbers}
    said = capsys.readouterr().err
    assert "4 could not be made" in said
    for number in source.numbers:
        assert f"{number:06d}-figure.png: {source.name}, scene {number}: no object failed 2 times" in said
    assert said.count("Try: another scene") == 1


def test_files_of_attempts_that_nobody_knows_cost_nothing_else(bank, source, tmp_path, capsys):
    file = tmp_path / "alone.xml"
    number = int(source.successes[0])
    shutil.copytree(bank / "assets", tmp_path / "assets")
    text = (bank / "scenes" / f"{number:06d}.xml").read_text()
    file.write_text(text.replace("../assets", "assets"))
    asked = ["--replay", "--points", "--no-picture", "--out", str(tmp_path / "out")]
    assert main(["render", str(file), *asked]) == 1
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["alone-points.ply"]
    assert "alone, its attempts: alone: a scene file does not tell" in capsys.readouterr().err


def test_a_picture_that_is_missing_in_a_scene_file_is_noted(tmp_path, capsys):
    (tmp_path / "die.xml").write_text(
        """<mujoco><asset><texture name="t" type="2d" file="gone.png"/><material name="m" texture="t"/>
        </asset><worldbody><body name="die" pos="0 0 .1"><freejoint/><geom type="box" size=".03 .03 .03"
        material="m"/></body></worldbody></mujoco>"""
    )
    asked = ["--points", "--no-picture", "--out", str(tmp_path / "out")]
    assert main(["render", str(tmp_path / "die.xml"), *asked]) == 0
    assert "'gone.png' cannot be read" in capsys.readouterr().err


def test_missing_scene_and_format_are_explained(bank, capsys):
    assert main(["render", f"{bank}:77"]) == 2
    assert "no scene 77" in capsys.readouterr().err
    assert main(["render", str(bank), "--scenes", "0-99", "--points"]) == 2
    assert "96 of the 100 scenes asked for (4-99) are not in it, which holds 0-3" in capsys.readouterr().err
    assert main(["render", f"{bank}:0", "--replay", "--film", "avi"]) == 2
    assert "('gif', 'mp4')" in capsys.readouterr().err
    assert main(["view", f"{bank}:77", "--port", "0", "--no-browser"]) == 2
    assert "no scene 77" in capsys.readouterr().err


def test_port_in_use_is_refused_and_zero_takes_a_free_one():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"{port} cannot be listened on"):
            free_port("127.0.0.1", port)
        assert main(["view", "--host", "127.0.0.1", "--port", str(port), "--no-browser"]) == 2
    assert free_port("127.0.0.1", 0) > 0
    with pytest.raises(ConfigError, match="65535"):
        free_port("127.0.0.1", 70000)


def test_missing_viser_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.delitem(sys.modules, "cluttergen_jax.rendering.viewer.guard", raising=False)
    with pytest.raises(MissingExtraError, match="cluttergen_jax\\[viewer\\]"):
        open_server("127.0.0.1", 0, "none")


def test_native_viewer_without_a_screen_says_so(bank):
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-m", "cluttergen_jax", "view", str(bank), "--native"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=240)
    if sys.platform == "linux":
        assert done.returncode == 2
        assert "DISPLAY is not set" in done.stderr


def test_display_check_reads_the_environment(monkeypatch):
    monkeypatch.setattr("platform.system", lambda: "Linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(DisplayError, match="without `native`"):
        check_display()
    monkeypatch.setenv("DISPLAY", ":0")
    check_display()


def test_native_model_begins_at_the_scene_and_stands(source):
    recording = source.still(int(source.successes[0]))
    model, qpos = native_model(recording)
    np.testing.assert_allclose(qpos.reshape(-1, 7), recording.poses, atol=1e-6)
    np.testing.assert_allclose(model.qpos0, qpos, atol=1e-6)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_step(model, data, 240)
    assert np.abs(data.qpos.reshape(-1, 7)[:, :3] - recording.poses[:, :3]).max() < 0.005


def test_words_name_verdicts_figures_and_causes():
    recording = cubes()
    text = scene_words(recording)
    assert "**cubes** stands" in text
    assert "objects placed: 2" in text
    assert "0.02 mm" in text
    assert "last check: < 1 um" in scene_words(replace(recording, drift=9.4e-8))
    assert "attempts: 4, of which 1 displaced, 1 fell" in text
    failed = scene_words(replace(recording, is_success=False, verdict="crept"), note="a note")
    assert "failed: crept (the finished scene moved in the last check)" in failed
    assert failed.endswith("a note")
    assert "before the first of 4" in attempt_words(recording, 0)
    assert "fell below the support's top (60 steps)" in attempt_words(recording, 3)
    assert "**green**, its attempt 3" in attempt_words(recording, 4)
    assert "stable after 24 steps" in attempt_words(recording, 4)
    assert attempt_words(replace(recording, attempts=()), 0) == "attempts: not known"


def test_a_bank_from_before_regions_were_recorded_can_be_looked_at(bank):
    found = BankSource(bank)
    found.bank.record["recipe"].pop("region")
    assert found.still(0).region == read_bank(bank).support.region
    with pytest.raises(BankError, match="not recorded whole"):
        found.replay(0)
    assert found.methods == ()
