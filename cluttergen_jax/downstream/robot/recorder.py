"""Recording of episodes as they are run, each once, into a folder of some format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, get_args

from cluttergen_jax.downstream.robot.lerobot_folder import LeRobotFolder
from cluttergen_jax.downstream.robot.model import TIMESTEP
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.outcome import EpisodeRow
from cluttergen_jax.downstream.robot.recording import FPS, RecordCameras, Recording
from cluttergen_jax.downstream.robot.robomimic_folder import RobomimicFolder
from cluttergen_jax.downstream.words import RecordFormat
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import find_backend

Row = TypeVar("Row", bound=EpisodeRow)


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
        self._folder = folder
        self._cameras = cameras
        self._seed = seed
        self._task = task

    def run(
        self, number: int, run: Callable[[int, Trace], Row], known: EpisodeRow | None = None
    ) -> Row:
        """Runs an episode and records it; one in which nothing moved has no frames, and is left out.

        Args:
          known: its row, if it was run before.

        Raises:
          BankError: it ends in another way than its row says; then it is not recorded.
        """
        trace = Trace(round(1 / (FPS * TIMESTEP)))
        row = run(number, trace)
        if known is not None and (row.outcome, row.detail) != (known.outcome, known.detail):
            raise BankError(
                f"episode {number} ended with {known.outcome!r}, and run again with {row.outcome!r}",
                "episodes that end as they did, as those of the same version and machine do",
                "another `out`",
            )
        # A command that was killed between the recording and the row has it already.
        if trace.states and number not in self._folder.numbers():
            cameras = self._cameras.place(trace.scene.support, (self._seed, number))
            self._folder.add(Recording(number, self._task(row), row.is_success, trace, cameras))
        return row

    def complete(self, rows: Sequence[Row], run: Callable[[int, Trace], Row]) -> None:
        """Records the episodes that were run before and have frames, unless they are recorded (`run`)."""
        known = set(self._folder.numbers())
        missing = [k for k, row in enumerate(rows) if k not in known and row.seconds > 0]
        with Progress("recording", len(missing), "episode") as progress:
            for number in missing:
                self.run(number, run, rows[number])
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
