"""Exports in programs that cannot be installed beside this one: each is asked in an interpreter of its own.

CLUTTERGEN_MANISKILL_PYTHON, CLUTTERGEN_ROBOSUITE_PYTHON and CLUTTERGEN_LIBERO_PYTHON name the interpreters of
environments that have mani_skill, robosuite 1.5 with h5py and MuJoCo 3.3, and libero as its script says;
without them the tests are skipped. Drake, which comes with the extra peers, is asked in this interpreter.
`tests/peers` holds what is run; it prints JSON.
"""

import os
import sys

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.environments import ask_peer
from tests.helpers.exports import NAMES, assert_same_pose, spread

SECONDS = 2.0
WITH_TALL = ("mug", "bottle", "dinner_plate", "mug#2")
"""One stands as high as the hand of a robot beside the table."""
SUPPORTS = {"maniskill": "table-0.80x0.80"}
"""Of boxes alone, which ManiSkill paints only where it can draw; others have pictures of their own."""


def asked(peer, format, names, tmp_path, *words):
    """Two scenes of the same objects, and what a peer reports of their export, chiefly of the first."""
    python = os.environ.get(f"CLUTTERGEN_{peer.upper()}_PYTHON")
    if peer == "drake":
        pytest.importorskip("pydrake", reason="needs the extra peers")
        python = sys.executable
    if not python:
        pytest.skip(f"CLUTTERGEN_{peer.upper()}_PYTHON names no interpreter that has {peer}")
    pool = find_pool("dining")
    scenes = [
        spread(
            [pool[name.split("#")[0]] for name in own],
            find_support(SUPPORTS.get(peer, "round_table")),
            own,
            index,
            turn,
        )
        for index, (own, turn) in enumerate([(names, 0.7), (names[1:] + names[:1], 0.2)])
    ]
    folder = export_scenes(scenes, tmp_path / "out", format)
    return scenes, ask_peer(peer, python, folder, SECONDS, *words)


@pytest.mark.parametrize(
    ("peer", "format", "names", "words"),
    [
        ("drake", "sdf", NAMES, [".sdf"]),
        pytest.param("drake", "sdf", NAMES, [".dmd.yaml"], marks=pytest.mark.slow),
        ("maniskill", "maniskill", NAMES, []),
        ("robosuite", "robosuite", WITH_TALL, []),
        ("libero", "libero", WITH_TALL, []),
    ],
)
def test_peers_read_poses_and_masses_and_the_scene_stands(peer, format, names, words, tmp_path):
    scenes, report = asked(peer, format, names, tmp_path, *words)
    scene = scenes[0]
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        for moment in ("before", "restored"):
            if moment in report:
                assert_same_pose(report[moment][name][:3], report[moment][name][3:], pose)
        assert report["mass"][name] == pytest.approx(asset.mass, rel=1e-5)
        if "inertia" in report:
            np.testing.assert_allclose(report["inertia"][name], asset.inertia, rtol=1e-5, atol=1e-9)
        shift = np.linalg.norm(np.array(report["after"][name][:3]) - pose[:3])
        assert shift < 0.002, (name, shift)
    if peer == "drake":
        # It passes over what a world says of light and steps; of directives nothing.
        assert all("element in world" in each for each in report["warnings"]), report["warnings"]
        assert words == [".sdf"] or not report["warnings"]
        assert set(map(tuple, report["friction"].values())) == {(scene.contact.friction[0],)}
    if peer == "robosuite":
        assert report["hand"] - report["highest"] > 0.02
    if peer == "libero":
        check_task(scenes, report)


def check_task(scenes, report):
    """Both scenes are states of one task, the robot is clear of them, and goals are judged."""
    scene, other = scenes
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        # Without several contact points for a pair the plate creeps by more.
        assert np.linalg.norm(np.array(report["after"][name][:3]) - pose[:3]) < 0.0003, name
        assert report["hand"] > pose[2] + asset.half_extents[2]
    for name, pose in zip(other.names, other.poses, strict=True):
        assert_same_pose(report["other"][name][:3], report["other"][name][3:], pose)
    assert report["touched"] == []
    assert [report[key] for key in ("done", "restored_success", "other_success")] == [
        False,
        True,
        False,
    ]
