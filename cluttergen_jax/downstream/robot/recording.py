"""Recordings of episodes: what the arm did, felt and was told at every frame, and what cameras saw."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, TypeVar, get_args

import mujoco
import numpy as np

from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import RecordFormat
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, wrist_camera
from cluttergen_jax.downstream.robot.model import PANDA
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.transforms import pose_of
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import check_folder, write_atomically
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.kept_folder import FolderLock, KeptFolder, check_recipe
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.gl import find_backend
from cluttergen_jax.rendering.lighting import add_lighting
from cluttergen_jax.rendering.renderer import open_renderer, set_range
from cluttergen_jax.schema import SchemaError, checked_record, with_checksum
from cluttergen_jax.sensing import Camera
from cluttergen_jax.sensing.camera_plan import CameraPlan, parse_cameras

FPS = 20
"""Frames per second of simulated time."""
RECORD = "recording.json"
"""How recordings were made, in their folder."""
THIRD, WRIST = "third", "wrist"
_EYE, _LOOKED_AT = (1.25, 0.6, 0.9), (-0.2, 0.0, 0.22)
"""Metres from the region's middle on the top, in the region's axes: the camera `third`, across the table."""
_REACH = 1.5


class EpisodeRow(Protocol):
    """What a recording has to know of an episode."""

    @property
    def outcome(self) -> str: ...
    @property
    def detail(self) -> str: ...
    @property
    def is_success(self) -> bool: ...


Row = TypeVar("Row", bound=EpisodeRow)


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode, T frames.

    Attributes:
      number: of the episode. task: what it was to do, in words. is_success: how it ended.
      trace: what was kept of it.
      cameras: by name; None is the one on the hand.
    """

    number: int
    task: str
    is_success: bool
    trace: Trace
    cameras: Mapping[str, Camera | None]

    def __len__(self) -> int:
        return len(self.trace.states)

    @property
    def names(self) -> list[str]:
        """Of the entries of `state` and `action`."""
        return [f"joint{k + 1}" for k in range(len(self.trace.arm.qpos))] + ["finger_opening"]

    @cached_property
    def qpos(self) -> np.ndarray:
        """f64[T, nq]: the whole simulation's."""
        return np.array(self.trace.states)

    @property
    def state(self) -> np.ndarray:
        """f32[T, J + 1]: radians of the joints, and metres of each finger from the middle."""
        arm = self.trace.arm
        fingers = self.qpos[:, arm.fingers].mean(1, keepdims=True)
        return np.concatenate([self.qpos[:, arm.qpos], fingers], axis=1).astype(np.float32)

    @property
    def action(self) -> np.ndarray:
        """f32[T, J + 1]: set-points that lead from a frame to the next, as `state`.

        That of the fingers is negative where they shall press on something.
        """
        arm = self.trace.arm
        told = np.array([*self.trace.controls[1:], self.trace.controls[-1]])
        return told[:, [*arm.ctrl, arm.grip]].astype(np.float32)

    @cached_property
    def _seen(self) -> tuple[np.ndarray, np.ndarray]:
        """f64[T, 4, 4], T_world_tool; bool[T], the hand touches something that is not the arm."""
        tools, touches = [], []
        arm, model = self.trace.arm, self._model
        is_hand = np.isin(np.arange(model.nbody), [arm.hand, *arm.finger_bodies])
        for data in self._states():
            mujoco.mj_collision(model, data)
            bodies = model.geom_bodyid[data.contact.geom[data.contact.dist <= 0]]
            touches.append(bool((is_hand[bodies] & ~arm.is_arm[bodies[:, ::-1]]).any()))
            tools.append(arm.tool(data))
        return np.array(tools), np.array(touches)

    @property
    def tool_pose(self) -> np.ndarray:
        """f32[T, 7]: T_world_tool, metres, wxyz."""
        return pose_of(self._seen[0]).astype(np.float32)

    @property
    def contact(self) -> np.ndarray:
        """bool[T]: the hand touches something."""
        return self._seen[1]

    @cached_property
    def _model(self) -> mujoco.MjModel:
        model = add_lighting(self.trace.spec).compile()
        # Shadows take six sevenths of the time of a picture without a GPU.
        model.light_castshadow[:] = False
        return model

    def _states(self) -> Iterator[mujoco.MjData]:
        data = mujoco.MjData(self._model)
        for state in self.qpos:
            data.qpos[:] = state
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            yield data

    def pictures(self, name: str) -> Iterator[np.ndarray]:
        """u8[H, W, 3] of every frame by a camera. Raises RendererError: nothing here can draw."""
        fixed, model = self.cameras[name], self._model
        width, height = SIZE if fixed is None else (fixed.width, fixed.height)
        middle = [*self.trace.scene.support.region.center, self.trace.scene.support.top]
        set_range(model, np.add(middle, _REACH * np.array([[-1], [1]])), CameraView(), width, height)
        with open_renderer(model, width, height) as renderer:
            for data in self._states():
                camera = wrist_camera(self.trace.arm.tool(data)) if fixed is None else fixed
                yield renderer.average(data, camera, 1, _REACH)


def _third_camera(support: SupportAsset) -> Camera:
    region = support.region
    eye, target = (
        [*(rotate_in_plane(np.array(each[:2]), region.yaw) + region.center), support.top + each[2]]
        for each in (_EYE, _LOOKED_AT)
    )
    return Camera.looking(np.array(eye), np.array(target), *SIZE, FOCAL)


@dataclass(frozen=True)
class RecordCameras:
    """Cameras that are recorded.

    Attributes:
      own: whether the cameras `third` (across the table) and `wrist` are among them, in their order.
      plans: the others; those that do not stand at a fixed place are drawn for each episode.
    """

    own: tuple[str, ...]
    plans: tuple[CameraPlan, ...]

    @staticmethod
    def of(asked: Sequence[str | Path]) -> RecordCameras:
        """By name, or files (`parse_cameras`). Raises ConfigError: there is no such camera."""
        if isinstance(asked, str | Path):
            raise ConfigError(f"record_cameras = {asked!r}", "a sequence of names", f"({str(asked)!r},)")
        names = [str(each) for each in asked]
        plans: list[CameraPlan] = []
        for name in names:
            if name not in (THIRD, WRIST):
                plans += parse_cameras([name], None if name.endswith(".json") else SIZE)
        found = RecordCameras(tuple(name for name in names if name in (THIRD, WRIST)), tuple(plans))
        known = list(found.sizes)
        if len(known) < len(found.own) + len(plans):
            raise ConfigError(f"record_cameras = {names}", "each name once")
        return found

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Width and height by name, pixels."""
        return dict.fromkeys(self.own, SIZE) | {plan.name: plan.size for plan in self.plans}

    def place(self, support: SupportAsset, seed: tuple[int, int]) -> dict[str, Camera | None]:
        """The cameras of an episode; None is the one on the hand."""
        rng = np.random.default_rng(seed)
        found: dict[str, Camera | None] = {
            name: None if name == WRIST else _third_camera(support) for name in self.own
        }
        return found | {plan.name: plan.draw(support, rng) for plan in self.plans}


def hold_folder(path: Path, told: Mapping[str, Any]) -> FolderLock:
    """Holds a folder of recordings, which is made if need be.

    Args:
      told: what makes recordings comparable.

    Raises:
      BankError: it holds something else or recordings of other settings, or another process writes there.
    """
    place = path / RECORD
    kept = KeptFolder(
        path, lambda each: (each / RECORD).is_file(), "{path} holds {other}, no recordings", lambda _: False
    )
    lock = kept.lock()
    try:
        if place.is_file():
            known = checked_record(place.read_bytes())
            check_recipe(path, "recordings made", told, known, "another `record`")
        else:
            write_atomically(place, json.dumps(with_checksum(told), indent=1).encode())
    except SchemaError as error:
        lock.release()
        raise BankError(f"{place}: damaged ({error})", "recordings", "another `record`") from error
    except BaseException:
        lock.release()
        raise
    return lock


class RecordFolder(Protocol):
    """A folder of recordings in some format, which an interrupted command continues."""

    def numbers(self) -> list[int]:
        """Of the episodes that are recorded, in their order."""

    def add(self, recording: Recording) -> None:
        """Writes an episode, whole or not at all."""

    def finish(self) -> None:
        """Writes what is told of all episodes."""


class Recorder:
    """Records every episode once, as it is run, and those of which there are only rows by running them again.

    Args:
      folder: where; cameras: by which.
      seed: of cameras that are drawn. task: what an episode was to do, of its row.
    """

    def __init__(
        self, folder: RecordFolder, cameras: RecordCameras, seed: int, task: Callable[[Any], str]
    ) -> None:
        self._folder, self._cameras, self._seed, self._task = folder, cameras, seed, task

    def run(self, number: int, run: Callable[[int, Trace], Row]) -> Row:
        """Runs an episode and records it; one in which nothing moved has no frames, and is left out."""
        trace = Trace(round(1 / (FPS * PANDA.timestep)))
        row = run(number, trace)
        if trace.states:
            cameras = self._cameras.place(trace.scene.support, (self._seed, number))
            self._folder.add(Recording(number, self._task(row), row.is_success, trace, cameras))
        return row

    def complete(self, rows: Sequence[Row], run: Callable[[int, Trace], Row]) -> None:
        """Records the episodes that were run before, unless they are recorded.

        Raises:
          BankError: one ends in another way than its row says.
        """
        known = set(self._folder.numbers())
        missing = [number for number in range(len(rows)) if number not in known]
        with Progress("recording", len(missing), "episode") as progress:
            for number in missing:
                found, row = self.run(number, run), rows[number]
                if (found.outcome, found.detail) != (row.outcome, row.detail):
                    raise BankError(
                        f"episode {number} ended with {row.outcome!r}, and run again with {found.outcome!r}",
                        "episodes that end as they did, as those of the same version and machine do",
                        "another `out`",
                    )
                progress.update()

    def finish(self) -> None:
        """Writes what is told of all episodes."""
        self._folder.finish()


@dataclass(frozen=True)
class RecordAsked:
    """What is recorded where; folder, form and cameras: as given.

    Raises:
      ConfigError: there is no such format or camera.
      RendererError: there are cameras, and nothing here can draw.
    """

    folder: Path
    form: RecordFormat
    cameras: RecordCameras

    @staticmethod
    def of(
        folder: str | Path | None, form: RecordFormat, cameras: Sequence[str | Path]
    ) -> RecordAsked | None:
        """None where no folder is given."""
        if form not in get_args(RecordFormat):
            raise ConfigError(f"record_format = {form!r}", ", ".join(get_args(RecordFormat)))
        asked = RecordCameras.of(cameras)
        if folder is None:
            return None
        check_folder(folder, "record")
        if asked.sizes:
            find_backend()
        return RecordAsked(Path(folder), form, asked)


def open_recorder(
    asked: RecordAsked, recipe: Mapping[str, Any], seed: int, task: Callable[[Any], str]
) -> Recorder:
    """A recorder into a folder, which may hold recordings of the same recipe.

    Raises:
      BankError: the folder holds something else, or recordings of other settings.
      MissingExtraError: the format or videos need an extra that is not installed.
    """
    from cluttergen_jax.downstream.robot.lerobot_folder import LeRobotFolder
    from cluttergen_jax.downstream.robot.robomimic_folder import RobomimicFolder

    cameras = asked.cameras
    told = {
        "format": asked.form,
        "fps": FPS,
        "cameras": repr(cameras),
        "seed": seed,
        "episodes": dict(recipe),
    }
    kind = LeRobotFolder if asked.form == "lerobot" else RobomimicFolder
    return Recorder(kind(asked.folder, cameras, told), cameras, seed, task)
