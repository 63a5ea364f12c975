"""Banks in mjlab, on a CPU, asked in the interpreter that CLUTTERGEN_MJLAB_PYTHON names."""

import importlib.metadata
import os
import re
import runpy
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.bank_reader import Bank
from tests.helpers.environments import ask_peer, named_python
from tests.helpers.exports import fourteen_scenes
from tests.helpers.worlds import prism, trio

SCRIPT = Path(cg.__file__).parent / "scene/export/scripts/cluttergen_mjlab.py"
KNOWN = {"mjlab": "1.6.0", "mujoco-warp": "3.11.0", "pyarrow": "15.0"}


@pytest.fixture
def installed(monkeypatch):
    """Has packages of these versions seem to be installed."""

    def pretend(**versions):
        known = KNOWN | {name.replace("_", "-"): each for name, each in versions.items()}
        monkeypatch.setattr(importlib.metadata, "version", known.__getitem__)

    return pretend


@pytest.mark.parametrize("version", ["1.5.2", "1.7.0", "2.0"])
def test_an_unknown_mjlab_is_refused_before_anything_of_it_is_used(installed, version):
    installed(mjlab=version)
    with pytest.raises(ImportError, match=rf"mjlab {version}\. Allowed: 1\.6\. Try: pip install"):
        runpy.run_path(str(SCRIPT))


def test_a_known_fault_is_told_where_it_is(installed, recwarn):
    for version, is_told in (("3.11.0", True), ("3.15.0", True), ("3.16.0", False)):
        installed(mujoco_warp=version)
        recwarn.clear()
        # It goes on to what this environment lacks.
        with pytest.raises(ImportError):
            runpy.run_path(str(SCRIPT))
        told = [str(each.message) for each in recwarn if "mujoco_warp#1657" in str(each.message)]
        assert len(told) == is_told


@pytest.fixture(scope="module")
def python():
    return named_python("mjlab")


@pytest.fixture(scope="module")
def dining(tmp_path_factory):
    """Eight scenes of six objects, other ones in nearly every scene."""
    options = {"pool": "dining", "num_objects": 6, "num_scenes": 8, "seed": 3}
    return cg.generate(tmp_path_factory.mktemp("banks") / "bank", **options, render=False).path


def assert_stand(told, most):
    """All worlds are finite, and nothing in them moved farther."""
    for world in told["worlds"]:
        assert np.isfinite(world["poses"]).all()
        assert world["is_finite"]
        assert max(world["shift"]) < most


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_scenes_at_rest_stay_at_rest(python, dining, tmp_path):
    """The script of 70609177 has something in one of these scenes fly 13 m within three seconds."""
    folder = cg.export(dining, tmp_path / "out", "mjlab")
    told = ask_peer("mjlab", python, folder, 8, 3, seconds=3000)
    assert_stand(told, 0.0005)
    assert (told["cone"] == "pyramidal") == told["has_clamp"]
    # What touches has a mesh in every world, and every such mesh its hull.
    assert (told["num_empty"], told["num_without_hull"]) == (0, 0)
    known = find_pool("dining")
    for world in told["worlds"]:
        for name, colour in zip(world["objects"], world["colour"], strict=True):
            (own, *_) = known[name].pieces
            np.testing.assert_allclose(colour, own.rgba, atol=1e-5)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_worlds_are_scenes(python, dining, tmp_path):
    """Worlds of other objects each, and worlds of the same objects, which are drawn among all scenes."""
    trios = fourteen_scenes(tmp_path / "trios")
    masses = {asset.name: asset.mass for asset in (*find_pool("dining").objects, *trio())}
    for path, num_sets in ((dining, 3), (trios, 1)):
        folder = cg.export(path, tmp_path / f"{num_sets}", "mjlab")
        told = ask_peer("mjlab", python, folder, 3, 0.5, seconds=3000)
        assert_stand(told, 0.0005)
        scenes = [dict(zip(each.names, each.poses, strict=True)) for each in Bank(path)]
        for world in told["worlds"]:
            same = [each for each in scenes if set(each) == set(world["objects"])]
            wanted = [[each[name] for name in world["objects"]] for each in same]
            assert min(np.abs(np.array(wanted) - world["poses"]).max((1, 2))) < 1e-5
            assert world["mass"] == pytest.approx(
                [masses[name] for name in world["objects"]], rel=1e-5
            )
        assert len({tuple(world["objects"]) for world in told["worlds"]}) == num_sets


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_world_of_a_set_begins_in_its_layouts(python, tmp_path):
    options = {"pool": "dining", "num_objects": 3, "sets": 2, "num_scenes": 8, "seed": 1}
    bank = cg.generate(tmp_path / "bank", **options, render=False).path
    told = ask_peer(
        "mjlab", python, cg.export(bank, tmp_path / "out", "mjlab"), 2, 0.1, 12, seconds=3000
    )
    assert_stand(told, 0.0005)
    for world in told["worlds"]:
        wanted = [
            [dict(zip(each.names, each.poses, strict=True))[name] for name in world["objects"]]
            for each in Bank(bank).successes()
            if set(each.names) == set(world["objects"])
        ]
        assert len(wanted) > 1
        drawn = np.abs(np.array(world["starts"])[:, None] - np.array(wanted)[None]).max((2, 3))
        assert (drawn.min(1) < 1e-5).all()
        assert len(set(drawn.argmin(1))) > 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_each_world_has_its_objects_friction(python, tmp_path):
    box, eight, tall = trio()
    own = (replace(box, friction=0.3), replace(prism("puck", 0.05, 0.02), friction=0.2))
    wanted = {"box": 0.3, "puck": 0.2}
    bank = fourteen_scenes(tmp_path / "bank", lambda index: (own[index % 2], eight, tall))
    told = ask_peer(
        "mjlab", python, cg.export(bank, tmp_path / "out", "mjlab"), 4, 0.5, seconds=3000
    )
    assert_stand(told, 0.002)
    for world in told["worlds"]:
        known = [wanted.get(name, 0.5) for name in world["objects"]]
        assert world["friction"] == pytest.approx(known, rel=1e-5)
        # Against what has none of its own it decides.
        assert world["objects"][0] in ("box", "puck")
        assert world["priority"][0] > max(world["priority"][1:]) == 0
    assert {world["objects"][0] for world in told["worlds"]} == {"box", "puck"}


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_policy_learns_to_lift_in_mjlabs_own_program(python, dining, tmp_path):
    """From another folder, without this package: two iterations of PPO, which leave a checkpoint."""
    folder = cg.export(dining, tmp_path / "out", "mjlab")
    words = ("--env.scene.num-envs", "2", "--agent.max-iterations", "2", "--agent.logger")
    environment = {key: each for key, each in os.environ.items() if key != "PYTHONPATH"}
    task = ("train", "Cluttergen-Lift-Yam", *words, "tensorboard", "--agent.num-steps-per-env", "4")
    ran = subprocess.run(
        [python, str(folder / "cluttergen_mjlab.py"), *task, "--gpu-ids", "None"],
        cwd=tmp_path,
        env=environment | {"CUDA_VISIBLE_DEVICES": ""},
        capture_output=True,
        text=True,
        check=False,
        timeout=3000,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    assert list((tmp_path / "logs/rsl_rl/cluttergen_lift_yam").rglob("model_*.pt"))
    assert not re.search(r"\bnan\b", ran.stdout, re.IGNORECASE)
