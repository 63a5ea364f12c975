"""Saved scenes in the MuJoCo that people have: what their files say, and what other versions make of them."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.config import DETECTORS, StabilityConfig
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.simulations import Simulations, disabled_flags
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.export import export_scenes
from cluttergen_jax.scene.export.formats import find_format
from cluttergen_jax.types import Verdict
from tests.helpers.environments import python_with
from tests.helpers.exports import dining_scene
from tests.helpers.worlds import TOP, layout_of, prism, scene, tilted, trio

VERSIONS = ("3.3.7", "3.5.0", "3.10.0")
OLDER = ("3.0.1", "3.2.0")
SCRIPT = Path(__file__).parents[2] / "studies" / "benchmarks" / "other_mujoco.py"
BOTH = StabilityConfig(both_detectors=True)


def exported(folder, format, stability=BOTH):
    export_scenes([replace(dining_scene(), stability=stability)], folder, format)
    return (folder / "scenes" / "000000.xml").read_text()


def test_files_name_the_detector_they_were_checked_with(tmp_path):
    text = exported(tmp_path / "new", "mjcf")
    assert '<flag multiccd="enable" nativeccd="disable"/>' in text
    # Whatever is called has a name that dm_control takes, and no word that older versions do not know.
    assert not any(
        "/" in name for name in re.findall(r' (?:name|mesh|material|texture)="([^"]*)"', text)
    )
    assert "inertia=" not in text.replace("fullinertia=", "")
    unsaid = text.replace(' nativeccd="disable"', "")
    assert exported(tmp_path / "old", find_format("mjcf", old_mujoco=True), BOTH) == unsaid
    # What was checked with one detector steps as it was made.
    assert exported(tmp_path / "paper", "mjcf", StabilityConfig()) == unsaid.replace(
        repr(1 / 480), repr(1 / 240)
    )


def test_the_detectors_are_two():
    """A prism that falls on another one ends elsewhere by each of them."""
    layout = layout_of([prism("a", 0.04, 0.03), prism("b", 0.03, 0.02, sides=7)])
    sims = NativePhysics(layout, StabilityConfig(), 1).simulations(1)
    ends = {}
    where = {0: (0, 0, TOP + 0.03), 1: (0.01, 0.005, TOP + 0.0801)}
    poses, placed = scene(layout, where, {1: tilted((0.6, 0.8, 0), 7)})
    for name in DETECTORS:
        sims.release(poses[None], placed[None], placed[None])
        with sims.detected_by(name, 0.0):
            ends[name] = sims.run(np.array([0]), 40).poses[0, -1]
    assert np.abs(ends["native"] - ends["libccd"]).max() > 1e-3
    off = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    assert [bool(disabled_flags(layout.model, name) & off) for name in DETECTORS] == [False, True]


def test_contacts_of_robust_scenes_begin_at_a_distance(tmp_path):
    robust = replace(BOTH, robust_tilt=0.1)
    assert "margin=" not in exported(tmp_path / "plain", "mjcf")
    assert '<geom margin="5e-05"' in exported(tmp_path / "robust", "mjcf", robust)
    assert [each.file_margin for each in (BOTH, robust, StabilityConfig(robust_tilt=0.1))] == [
        0,
        5e-5,
        0,
    ]


@pytest.mark.parametrize("falls", [None, "native", "libccd"])
def test_the_last_check_asks_both_detectors(monkeypatch, falls):
    """A detector that lets things slide away, in place of one that is less precise."""
    layout = layout_of(trio())
    asked = []

    def choose(sims, detector, margin=0.0):
        asked.append(detector)
        sims.turn_gravity(
            np.array([1.0, 0, -1]) / 2**0.5 if detector == falls else np.array([0.0, 0, -1])
        )

    monkeypatch.setattr(Simulations, "choose_detector", choose)
    poses, is_placed = scene(layout, {0: (0, 0, TOP + 0.05), 1: (0.2, 0, TOP + 0.03)})

    def verdict(config):
        engine = NativePhysics(layout, config)
        if falls == "native":
            choose(engine.simulations(1), "native")
            asked.clear()
        return int(engine.stand_batch(poses[None], is_placed[None], np.array([True])).verdict[0])

    assert verdict(StabilityConfig()) == int(Verdict.CREPT if falls == "native" else Verdict.STABLE)
    assert asked == []
    assert verdict(BOTH) == int(Verdict.STABLE if falls is None else Verdict.CREPT)
    # What falls with the first is not asked of the other.
    assert asked == ([] if falls == "native" else ["libccd", "native"])


@pytest.fixture(scope="module")
def interpreters(tmp_path_factory):
    """By version of MuJoCo, the Python of an environment that has it alone."""

    folder = tmp_path_factory.mktemp("environments")
    return {
        version: python_with(folder / version, f"mujoco=={version}")
        for version in (*VERSIONS, *OLDER)
    }


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "bank"
    words = [
        "generate",
        "--pool",
        "all",
        "--num-objects",
        "20",
        "-n",
        "16",
        "--no-render",
        "--out",
        str(path),
    ]
    assert main(words) == 0
    return path


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_scenes_stand_in_other_versions_of_mujoco(interpreters, bank, tmp_path):
    number = int(np.sum(read_bank(bank).table["is_success"]))
    assert number >= 14
    assert main(["export", str(bank), "--old-mujoco", "--out", str(tmp_path / "old")]) == 0
    for version, python in interpreters.items():
        folder = tmp_path / "old" if version in OLDER else bank
        done = subprocess.run([python, SCRIPT, folder], capture_output=True, text=True, check=True)
        assert f"{number} of {number} scenes stand 10 s in MuJoCo {version}" in done.stdout
