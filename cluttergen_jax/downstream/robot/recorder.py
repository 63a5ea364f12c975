"""Recording of episodes as they are run, each once, into a folder of some format."""

from __future__ import annotations

import io
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.model import TIMESTEP
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.outcome import EpisodeRow, check_repeated
from cluttergen_jax.downstream.robot.recording import EpisodeRecording
from cluttergen_jax.downstream.words import RecordFormat
from cluttergen_jax.errors import BankError, MissingExtraError
from cluttergen_jax.files import file_whole, write_atomically
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import find_ffmpeg, save_film
from cluttergen_jax.stores import BlockStore

Row = TypeVar("Row", bound=EpisodeRow)
STARTS = "starts"
STORE = BlockStore(
    "recordings",
    "recording.json",
    "recordings of episodes",
    "cluttergen robot record",
    # A bank of starting scenes, where these are in no other.
    (STARTS,),
    argument="record",
)
FPS = 20
"""Steps of control in a second of simulated time, where a planner's motion is recorded."""
_CHUNK = 1000
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODE_TABLE = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_MOST_KEPT = 64
"""Pictures of an episode that count for the statistics of pixels are fewer, evenly spread."""


class RecordFolder(ABC):
    """A folder of recordings in some format, which an interrupted command continues.

    Args:
      environment: in which episodes are run, as it is written down. told: what else makes recordings
        comparable.

    Raises:
      BankError: it holds something else, recordings of other settings or a damaged episode, or another
        process writes there.
      MissingExtraError: something is not installed that the format needs.
    """

    def __init__(self, path: Path, environment: Mapping[str, Any], told: Mapping[str, Any]) -> None:
        self._path = path
        self._environment = environment
        self._fps = round(environment["control_hz"])
        height, width = environment["image_size"]
        self._sizes = dict.fromkeys(environment["cameras"], (width, height))
        self._import_extras()
        self._lock = STORE.folder(path).lock()
        try:
            STORE.begin(path, {**told, "environment": dict(environment)})
            self._resume()
        except BaseException:
            self._lock.release()
            raise

    @abstractmethod
    def _import_extras(self) -> None:
        """Raises MissingExtraError: something is not installed that the format needs."""

    @abstractmethod
    def _resume(self) -> None:
        """Reads what is there."""

    @abstractmethod
    def numbers(self) -> list[int]:
        """Of the episodes that are recorded, in their order."""

    @abstractmethod
    def add(self, recording: EpisodeRecording) -> None:
        """Writes an episode, whole or not at all."""

    def finish(self) -> None:
        """Writes what is told of all episodes, and lets the folder go."""
        self._lock.release()


@contextmanager
def _reading(place: Path) -> Iterator[None]:
    """A file that is read in the block. Raises BankError: it is damaged."""
    try:
        yield
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError) as error:
        raise BankError(f"{place}: damaged ({error})", "an episode", "another `record`") from error


class LeRobotFolder(RecordFolder):
    """A LeRobot dataset, version 3.0: Parquet, MP4 (extra `video`), tables of episodes and tasks.

    Every episode has files of its own, so that it appears whole or not at all, and what is there is never
    written again but for the small tables that tell of all.
    """

    def _import_extras(self) -> None:
        if self._sizes:
            find_ffmpeg()

    def _resume(self) -> None:
        """Tells of an episode that was written by a process which was killed before it told."""
        self._episodes: list[dict[str, Any]] = []
        self._features: dict[str, Any] = {}
        self._robot = ""
        while (place := self._place(EPISODE_TABLE, len(self._episodes))).is_file():
            with _reading(place):
                self._episodes += pq.read_table(place).to_pylist()
        place = self._path / "meta/info.json"
        if not place.is_file():
            # It was the first one, and is recorded again.
            self._episodes.clear()
            return
        with _reading(place):
            info = json.loads(place.read_bytes())
            told = info["total_episodes"]
            self._features = info["features"]
            self._robot = info["robot_type"]
        if told < len(self._episodes):
            self._tell()

    def numbers(self) -> list[int]:
        return [each["number"] for each in self._episodes]

    def add(self, recording: EpisodeRecording) -> None:
        index = len(self._episodes)
        length = len(recording)
        first = self._episodes[-1]["dataset_to_index"] if index else 0
        tasks = [*self._tasks(), recording.task]
        is_last = np.arange(length) == length - 1
        columns = {
            "observation.state": recording.state,
            "observation.environment_state": recording.objects,
            "action": recording.action,
            "next.reward": recording.reward,
            "next.done": is_last,
            "next.success": is_last & recording.is_success,
            "timestamp": (np.arange(length) / self._fps).astype(np.float32),
            "frame_index": np.arange(length),
            "episode_index": np.full(length, index),
            "index": np.arange(first, first + length),
            "task_index": np.full(length, tasks.index(recording.task)),
        }
        row: dict[str, Any] = {
            "episode_index": index,
            "tasks": [recording.task],
            "length": length,
            "dataset_from_index": first,
            "dataset_to_index": first + length,
            "number": recording.number,
            "success": recording.is_success,
            "outcome": recording.outcome,
            "start": recording.start,
        }
        chunk = _chunk(index)
        for kind in ("data", "meta/episodes"):
            row |= {f"{kind}/{name}": at for name, at in chunk.items()}
        for name in self._sizes:
            key = f"observation.images.{name}"
            counted = _Pixels(recording.pictures[name]())
            save_film(counted, self._place(_VIDEO, index, key), self._fps)
            told = chunk | {"from_timestamp": 0.0, "to_timestamp": length / self._fps}
            row |= {f"videos/{key}/{what}": value for what, value in told.items()}
            row |= {f"stats/{key}/{what}": value for what, value in counted.stats(length).items()}
        for key, values in columns.items():
            row |= {f"stats/{key}/{what}": value for what, value in _stats(values).items()}
        table = pa.table({key: _column(each) for key, each in columns.items()})
        _write(self._place(DATA, index), table)
        _write(self._place(EPISODE_TABLE, index), pa.Table.from_pylist([row]))
        self._episodes.append(row)
        self._features = self._features_of(columns, recording.names)
        self._robot = recording.robot
        self._tell()

    def _tasks(self) -> list[str]:
        """Of all episodes, each once."""
        return list(dict.fromkeys(each["tasks"][0] for each in self._episodes))

    def _place(self, form: str, index: int, key: str = "") -> Path:
        return self._path / form.format(video_key=key, **_chunk(index))

    def _features_of(
        self, columns: dict[str, np.ndarray], names: Mapping[str, list[str]]
    ) -> dict[str, Any]:
        told = {
            "observation.state": names["state"],
            "observation.environment_state": names["objects"],
            "action": names["action"],
        }
        features: dict[str, Any] = {
            key: {
                "dtype": str(each.dtype),
                "shape": list(each.shape[1:] or (1,)),
                "names": told.get(key),
            }
            for key, each in columns.items()
        }
        for name, (width, height) in self._sizes.items():
            info = {"height": height, "width": width, "codec": "h264", "pix_fmt": "yuv420p"}
            info |= {"fps": self._fps, "channels": 3, "is_depth_map": False}
            features[f"observation.images.{name}"] = {
                "dtype": "video",
                "shape": [height, width, 3],
                "names": ["height", "width", "channels"],
                "info": {f"video.{key}": value for key, value in info.items()}
                | {"has_audio": False},
            }
        return features

    def _tell(self) -> None:
        """Writes the tables of all episodes; info.json, which says how many there are, last."""
        tasks = self._tasks()
        index = {"task_index": np.arange(len(tasks)), "task": tasks}
        _write(self._path / "meta/tasks.parquet", pa.table(index).replace_schema_metadata(_PANDAS))
        stats = {key: self._all_stats(key) for key in self._features}
        write_atomically(self._path / "meta/stats.json", json.dumps(stats, indent=1).encode())
        info = {
            "codebase_version": "v3.0",
            "robot_type": self._robot,
            "total_episodes": len(self._episodes),
            "total_frames": self._episodes[-1]["dataset_to_index"],
            "total_tasks": len(tasks),
            "chunks_size": _CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA,
            "video_path": _VIDEO if self._sizes else None,
            "features": self._features,
        }
        write_atomically(self._path / "meta/info.json", json.dumps(info, indent=1).encode())

    def _all_stats(self, key: str) -> dict[str, Any]:
        """Of all episodes; quantiles are means of theirs."""
        told = {
            what: np.array([each[f"stats/{key}/{what}"] for each in self._episodes], np.float64)
            for what in ("min", "max", "mean", "std", "count", *_QUANTILES)
        }
        weight = told["count"].reshape(-1, *[1] * (told["mean"].ndim - 1))
        weight = weight / weight.sum()
        mean = (weight * told["mean"]).sum(0)
        spread = (weight * (told["std"] ** 2 + (told["mean"] - mean) ** 2)).sum(0)
        found = {
            "min": told["min"].min(0),
            "max": told["max"].max(0),
            "mean": mean,
            "std": np.sqrt(spread),
        }
        found |= {what: (weight * told[what]).sum(0) for what in _QUANTILES}
        plain = {what: value.tolist() for what, value in found.items()}
        return plain | {"count": [int(told["count"].sum())]}


class _Pixels:
    """Passes pictures on, and keeps some, evenly spread, for their statistics."""

    def __init__(self, pictures: Iterator[np.ndarray]) -> None:
        self._pictures = pictures
        self._kept: list[np.ndarray] = []
        self._step = 1

    def __iter__(self) -> Iterator[np.ndarray]:
        for number, picture in enumerate(self._pictures):
            if number % self._step == 0:
                self._kept.append(picture[::4, ::4])
            if len(self._kept) == _MOST_KEPT:
                self._kept = self._kept[::2]
                self._step *= 2
            yield picture

    def stats(self, length: int) -> dict[str, Any]:
        """Of channels in [0, 1], as [3, 1, 1]."""
        found = _stats(np.concatenate([each.reshape(-1, 3) for each in self._kept]) / 255.0)
        shaped = {
            what: np.reshape(found[what], (3, 1, 1)).tolist() for what in found.keys() - {"count"}
        }
        return shaped | {"count": [length]}


def _chunk(index: int) -> dict[str, int]:
    """Where the files of an episode lie."""
    return {"chunk_index": index // _CHUNK, "file_index": index % _CHUNK}


def _stats(values: np.ndarray) -> dict[str, list[Any]]:
    table = values.astype(np.float64).reshape(len(values), -1)
    found = {"min": table.min(0), "max": table.max(0), "mean": table.mean(0), "std": table.std(0)}
    found |= {what: np.quantile(table, share, axis=0) for what, share in _QUANTILES.items()}
    return {what: value.tolist() for what, value in found.items()} | {"count": [len(table)]}


def _column(values: np.ndarray) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _write(path: Path, table: pa.Table) -> None:
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    write_atomically(path, buffer.getvalue())


def _pandas_column(name: str, kind: str, numpy_kind: str) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": name,
        "pandas_type": kind,
        "numpy_type": numpy_kind,
        "metadata": None,
    }


_PANDAS = {
    b"pandas": json.dumps(
        {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [
                _pandas_column("task_index", "int64", "int64"),
                _pandas_column("task", "unicode", "object"),
            ],
        }
    ).encode()
}
"""Says that tasks are the table's index: so does the host's reader look them up."""


_GYM = 2
"""What robomimic calls environments of Gym."""
GYM_NAME = "cluttergen_jax.downstream.environments.robomimic:ClutterRobot-v0"
"""By which Gym finds the environment that robomimic makes."""
_PRESSED = {"compression": "gzip", "compression_opts": 4}


class RobomimicFolder(RecordFolder):
    """Recordings in robomimic's HDF5 (extra `record`): demo.hdf5, put together of a file for each episode.

    The episodes' own files, in `episodes`, are what an interrupted command continues.
    """

    def _import_extras(self) -> None:
        try:
            import h5py
        except ImportError as error:
            raise MissingExtraError("record", "writing HDF5") from error
        self._h5py = h5py

    def _resume(self) -> None:
        self._numbers: list[int] = []
        while (place := self._place(len(self._numbers))).is_file():
            with _reading(place), self._h5py.File(place) as file:
                self._numbers.append(int(file["demo"].attrs["number"]))

    def numbers(self) -> list[int]:
        return list(self._numbers)

    def _place(self, index: int) -> Path:
        return self._path / "episodes" / f"demo_{index}.hdf5"

    def add(self, recording: EpisodeRecording) -> None:
        length = len(recording)
        # All that robomimic's wrapper of Gym passes on is one row of numbers.
        flat = np.concatenate([recording.state, recording.objects], axis=1)
        is_last = np.arange(length) == length - 1
        with (
            file_whole(self._place(len(self._numbers))) as fresh,
            self._h5py.File(fresh, "w") as file,
        ):
            demo = file.create_group("demo")
            told = {"num_samples": length, "number": recording.number, "task": recording.task}
            ending = {"success": recording.is_success, "outcome": recording.outcome}
            demo.attrs.update(told | ending | {"start": recording.start, "fps": self._fps})
            demo["actions"] = recording.action
            demo["states"] = recording.simulation
            demo["dones"] = is_last.astype(np.int64)
            demo["rewards"] = recording.reward.astype(np.float64)
            demo["obs/flat"] = flat
            for name, (width, height) in self._sizes.items():
                shape = (length, height, width, 3)
                chunk = (1, height, width, 3)
                held = demo.create_dataset(
                    f"obs/{name}_image", shape, "u1", chunks=chunk, **_PRESSED
                )
                for frame, picture in enumerate(recording.pictures[name]()):
                    held[frame] = picture
        self._numbers.append(recording.number)

    def finish(self) -> None:
        """Puts all episodes into one file."""
        with file_whole(self._path / "demo.hdf5") as fresh, self._h5py.File(fresh, "w") as file:
            data = file.create_group("data")
            good = []
            total = 0
            for index in range(len(self._numbers)):
                with self._h5py.File(self._place(index)) as episode:
                    episode.copy("demo", data, f"demo_{index}")
                total += int(data[f"demo_{index}"].attrs["num_samples"])
                if data[f"demo_{index}"].attrs["success"]:
                    good.append(f"demo_{index}")
            env = {
                "env_name": GYM_NAME,
                "type": _GYM,
                "env_kwargs": {"environment": self._environment},
            }
            data.attrs.update({"total": total, "env_args": json.dumps(env)})
            file["mask/success"] = np.array(good, "S")
            file["mask/failure"] = np.array(
                [name for name in sorted(data, key=_demo_number) if name not in good], "S"
            )
        super().finish()


def _demo_number(name: str) -> int:
    return int(name.removeprefix("demo_"))


FORMATS: dict[RecordFormat, type[RecordFolder]] = {
    "lerobot": LeRobotFolder,
    "robomimic": RobomimicFolder,
}


@dataclass(eq=False)
class DemonstrationRecorder:
    """Records every episode once, as it is run, and those of which there are only rows by running them again.

    Args:
      folder: where. play: an episode's trace, run in the environment whose numbers are recorded; None of
        one that has no steps.
    """

    folder: RecordFolder
    play: Callable[[int, Trace], EpisodeRecording | None]

    def run(
        self, number: int, run: Callable[[int, Trace], Row], known: EpisodeRow | None = None
    ) -> Row:
        """Runs an episode and records it; one in which nothing moved has no steps, and is left out.

        Args:
          known: its row, if it was run before.

        Raises:
          BankError: it ends in another way than its row says; then it is not recorded.
        """
        trace = Trace(round(1 / (FPS * TIMESTEP)))
        row = run(number, trace)
        if known is not None:
            check_repeated(number, known, row)
        # A command that was killed between the recording and the row has it already.
        if trace.states and number not in self.folder.numbers():
            recording = self.play(number, trace)
            if recording is not None:
                self.folder.add(recording)
        return row

    def complete(self, rows: Sequence[Row], run: Callable[[int, Trace], Row]) -> None:
        """Records the episodes that were run before and have steps, unless they are recorded (`run`)."""
        known = set(self.folder.numbers())
        missing = [k for k, row in enumerate(rows) if k not in known and row.seconds > 0]
        with Progress("recording", len(missing), "episode") as progress:
            for number in missing:
                self.run(number, run, rows[number])
                progress.update()

    def finish(self) -> None:
        """Writes what is told of all episodes."""
        self.folder.finish()


class RecordAsked(Protocol):
    """Opens the recorder that a command was asked for, once its scenes are known; folder: where."""

    @property
    def folder(self) -> Path: ...

    def open(
        self, task: str, bank: str, robot: RobotDescription, recipe: Mapping[str, Any]
    ) -> DemonstrationRecorder:
        """A recorder into a folder, which may hold recordings of the same recipe.

        Args:
          task: of an environment. bank: whose scenes episodes begin in.

        Raises:
          BankError: the folder holds something else, or recordings of other settings.
          MissingExtraError: the format or videos need an extra that is not installed.
        """
