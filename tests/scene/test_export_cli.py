"""`cluttergen export`, as a user would call it."""

import mujoco
import numpy as np
import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.judging.verify import verify_scene
from cluttergen_jax.scene.bank import read_bank
from tests.helpers.exports import fourteen_scenes


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return fourteen_scenes(tmp_path_factory.mktemp("export") / "bank")


@pytest.fixture(scope="module")
def numbers(bank):
    """Numbers of the scenes that succeeded and of those that failed."""
    scenes = list(read_bank(bank).scenes())
    good = [int(scene.index) for scene in scenes if scene.is_success]
    bad = [int(scene.index) for scene in scenes if not scene.is_success]
    assert len(good) > 2
    assert bad
    return good, bad


def test_all_successful_scenes_by_default(bank, numbers, tmp_path, capsys):
    good, _ = numbers
    assert main(["export", str(bank), "--out", str(tmp_path / "out")]) == 0
    assert f"{len(good)} scenes" in capsys.readouterr().out
    assert len(good) == 12
    files = sorted((tmp_path / "out" / "scenes").iterdir())
    assert [int(path.stem) for path in files] == good
    scenes = {int(scene.index): scene for scene in read_bank(bank).scenes()}
    for path in files:
        model = mujoco.MjModel.from_xml_path(str(path))
        np.testing.assert_allclose(model.qpos0, scenes[int(path.stem)].poses.ravel(), atol=1e-5)
    assert verify_scene(files[0]).stands


def test_what_cannot_be_done_is_explained_and_leaves_nothing(bank, numbers, tmp_path, capsys):
    good, bad = numbers
    cases = [
        ([str(tmp_path / "nowhere")], "is not a bank"),
        ([str(bank), "--format", "blend"], "mjcf"),
        ([str(bank), "--scenes", f"{good[0]},{bad[0]},999"], f"scene {bad[0]} failed"),
        ([str(bank), "--scenes", "999"], "no scene 999"),
        ([str(bank), "--scenes", "a"], "numbers and ranges"),
        ([f"{bank}:{good[0]}", "--scenes", "1"], "one of the two"),
        ([f"{bank}:{bad[0]}"], "failed"),
    ]
    for more, says in cases:
        assert main(["export", *more, "--out", str(tmp_path / "out")]) == 2
        assert says in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == []
