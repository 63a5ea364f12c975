"""Recordings in robomimic's HDF5 (extra `record`): demo.hdf5, put together of a file for each episode.

The episodes' own files, in `episodes`, are what an interrupted command continues.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.robot.recording import FPS, RecordCameras, Recording, hold_folder
from cluttergen_jax.errors import BankError, MissingExtraError
from cluttergen_jax.files import file_whole

_GYM = 2
"""What robomimic calls environments of Gymnasium."""
_PRESSED = {"compression": "gzip", "compression_opts": 4}


class RobomimicFolder:
    """Such a folder (`recording.RecordFolder`); cameras: that are recorded; told: see `hold_folder`.

    Raises:
      BankError: see `hold_folder`; or an episode is damaged.
      MissingExtraError: h5py is not installed.
    """

    def __init__(self, path: Path, cameras: RecordCameras, told: dict[str, Any]) -> None:
        try:
            import h5py
        except ImportError as error:
            raise MissingExtraError("record", "writing HDF5") from error
        self._h5py = h5py
        self._path = path
        self._sizes = cameras.sizes
        self._lock = hold_folder(path, told)
        self._numbers: list[int] = []
        while (place := self._place(len(self._numbers))).is_file():
            try:
                with h5py.File(place) as file:
                    self._numbers.append(int(file["demo"].attrs["number"]))
            except (OSError, KeyError) as error:
                raise BankError(
                    f"{place}: damaged ({error})", "an episode", "another `record`"
                ) from error

    def numbers(self) -> list[int]:
        return list(self._numbers)

    def _place(self, index: int) -> Path:
        return self._path / "episodes" / f"demo_{index}.hdf5"

    def add(self, recording: Recording) -> None:
        length = len(recording)
        obs = {}
        obs["robot0_joint_pos"] = recording.state[:, :-1]
        obs["robot0_gripper_qpos"] = recording.state[:, -1:]
        # Quaternions as robosuite has them: x, y, z, w.
        turn = recording.tool_pose[:, [4, 5, 6, 3]]
        obs["robot0_eef_pos"] = recording.tool_pose[:, :3]
        obs["robot0_eef_quat"] = turn
        obs["robot0_contact"] = recording.contact[:, None].astype(np.float32)
        is_last = np.arange(length) == length - 1
        with (
            file_whole(self._place(len(self._numbers))) as fresh,
            self._h5py.File(fresh, "w") as file,
        ):
            demo = file.create_group("demo")
            told = {"num_samples": length, "number": recording.number, "task": recording.task}
            demo.attrs.update(told | {"success": recording.is_success, "fps": FPS})
            demo["actions"] = recording.action
            demo["states"] = recording.qpos
            demo["dones"] = is_last.astype(np.int64)
            demo["rewards"] = (is_last & recording.is_success).astype(np.float64)
            for name, values in obs.items():
                demo[f"obs/{name}"] = values
            for name, (width, height) in self._sizes.items():
                shape = (length, height, width, 3)
                chunk = (1, height, width, 3)
                held = demo.create_dataset(
                    f"obs/{name}_image", shape, "u1", chunks=chunk, **_PRESSED
                )
                for frame, picture in enumerate(recording.pictures(name)):
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
            env = {"env_name": "cluttergen", "type": _GYM, "env_kwargs": {}}
            data.attrs.update({"total": total, "env_args": json.dumps(env)})
            file["mask/success"] = np.array(good, "S")
        self._lock.release()
