"""Recordings as a LeRobot dataset, version 3.0: Parquet, MP4 (extra `video`), tables of episodes and tasks.

Every episode has files of its own, so that it appears whole or not at all, and what is there is never written
again but for the small tables that tell of all.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.downstream.robot.recording import FPS, RecordCameras, Recording, hold_folder
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.rendering import find_ffmpeg, save_film

_CHUNK = 1000
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_SAMPLED = 20
"""Every so manieth picture counts for the statistics of pixels."""
_POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]


class LeRobotFolder:
    """Such a dataset (`recording.RecordFolder`); cameras: that are recorded; told: see `hold_folder`.

    Raises:
      BankError: see `hold_folder`; or an episode is damaged.
      MissingExtraError: there are cameras, and no encoder of MP4.
    """

    def __init__(self, path: Path, cameras: RecordCameras, told: dict[str, Any]) -> None:
        if cameras.sizes:
            find_ffmpeg()
        self._path = path
        self._sizes = cameras.sizes
        self._lock = hold_folder(path, told)
        self._episodes: list[dict[str, Any]] = []
        self._features: dict[str, Any] = {}
        self._robot = ""
        while (place := self._place(_EPISODES, len(self._episodes))).is_file():
            try:
                self._episodes += pq.read_table(place).to_pylist()
            except (pa.ArrowException, OSError) as error:
                raise BankError(
                    f"{place}: damaged ({error})", "an episode", "another `record`"
                ) from error
        self._resume()

    def _resume(self) -> None:
        """Tells of an episode that was written by a process which was killed before it told."""
        place = self._path / "meta/info.json"
        if not place.is_file():
            # It was the first one, and is recorded again.
            self._episodes.clear()
            return
        try:
            info = json.loads(place.read_bytes())
            told = info["total_episodes"]
            self._features = info["features"]
            self._robot = info["robot_type"]
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise BankError(
                f"{place}: damaged ({error})", "a dataset", "another `record`"
            ) from error
        if told < len(self._episodes):
            self._tell()

    def numbers(self) -> list[int]:
        return [each["number"] for each in self._episodes]

    def add(self, recording: Recording) -> None:
        index = len(self._episodes)
        length = len(recording)
        first = self._episodes[-1]["dataset_to_index"] if index else 0
        tasks = list(
            dict.fromkeys([*(each["tasks"][0] for each in self._episodes), recording.task])
        )
        is_last = np.arange(length) == length - 1
        columns = {
            "observation.state": recording.state,
            "observation.tool_pose": recording.tool_pose,
            "observation.contact": recording.contact,
            "action": recording.action,
            "next.done": is_last,
            "next.success": is_last & recording.is_success,
            "timestamp": (np.arange(length) / FPS).astype(np.float32),
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
        }
        chunk = {"chunk_index": index // _CHUNK, "file_index": index % _CHUNK}
        row |= {
            f"{kind}/{name}": at for kind in ("data", "meta/episodes") for name, at in chunk.items()
        }
        for name in self._sizes:
            key = f"observation.images.{name}"
            counted = _Pixels(recording.pictures(name))
            save_film(counted, self._place(_VIDEO, index, key), FPS)
            row |= {f"videos/{key}/{what}": at for what, at in chunk.items()}
            row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": length / FPS}
            row |= {f"stats/{key}/{what}": value for what, value in counted.stats(length).items()}
        for key, values in columns.items():
            row |= {f"stats/{key}/{what}": value for what, value in _stats(values).items()}
        _write(
            self._place(_DATA, index),
            pa.table({key: _column(each) for key, each in columns.items()}),
        )
        _write(self._place(_EPISODES, index), pa.Table.from_pylist([row]))
        self._episodes.append(row)
        self._features = self._features_of(columns, recording.names)
        self._robot = recording.trace.robot.name
        self._tell()

    def finish(self) -> None:
        self._lock.release()

    def _place(self, form: str, index: int, key: str = "") -> Path:
        chunk = {"chunk_index": index // _CHUNK, "file_index": index % _CHUNK}
        return self._path / form.format(video_key=key, **chunk)

    def _features_of(self, columns: dict[str, np.ndarray], names: list[str]) -> dict[str, Any]:
        told = {"observation.state": names, "action": names, "observation.tool_pose": _POSE}
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
            info |= {"fps": FPS, "channels": 3, "is_depth_map": False}
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
        tasks = list(dict.fromkeys(each["tasks"][0] for each in self._episodes))
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
            "fps": FPS,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": _DATA,
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
    """Passes pictures on, and keeps some for their statistics."""

    def __init__(self, pictures: Iterator[np.ndarray]) -> None:
        self._pictures = pictures
        self._kept: list[np.ndarray] = []

    def __iter__(self) -> Iterator[np.ndarray]:
        for number, picture in enumerate(self._pictures):
            if number % _SAMPLED == 0:
                self._kept.append(picture[::4, ::4])
            yield picture

    def stats(self, length: int) -> dict[str, Any]:
        """Of channels in [0, 1], as [3, 1, 1]."""
        found = _stats(np.concatenate([each.reshape(-1, 3) for each in self._kept]) / 255.0)
        shaped = {
            what: np.reshape(found[what], (3, 1, 1)).tolist() for what in found.keys() - {"count"}
        }
        return shaped | {"count": [length]}


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
