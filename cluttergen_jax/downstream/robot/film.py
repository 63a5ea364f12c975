"""Films of episodes: the first success and the first failure of each kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Generic, TypeVar

import mujoco
import numpy as np

from cluttergen_jax.config import FilmFormat
from cluttergen_jax.downstream.robot.model import TIMESTEP, Robot
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.robot.outcome import EpisodeRow, check_repeated, ending_of
from cluttergen_jax.files import inside
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import (
    GREEN,
    KEY_LIGHT,
    CameraView,
    add_lighting,
    check_format,
    find_backend,
    fit_camera,
    open_renderer,
    save_film,
    set_range,
    with_caption,
    with_frame,
)

RowT = TypeVar("RowT", bound=EpisodeRow)

FILMS = "films"
FPS = 10
"""Frames per second: 10 hundredths of a second each, which GIF can tell."""
EVERY = round(1 / (2 * FPS * TIMESTEP))
"""Steps from one state that is kept to the next."""
# A film is as fast as it takes to last so long, but never faster than so many times reality.
_SECONDS = 8.0
_FASTEST = 8.0

_HELD = 1.0
"""Seconds for which the end is shown."""
_WIDTH = 480
_HEIGHT = 360
_FINE = 2
"""Drawn so many times larger, then reduced."""
# Degrees, of the camera: from across the table, towards the arm.
_AZIMUTH = 205.0
_ELEVATION = -32.0

_FAILED = (0.86, 0.10, 0.12)
"""The colour of a frame around an end that was none."""
# Metres around the middles of the arm's links, and over the region, that are in the picture.
_ARM_WIDTH = 0.08
_ROOM = 0.1


def check_films(film: FilmFormat) -> None:
    """Refuses films that cannot be, before any episode is run.

    Raises:
      ConfigError: there is no such format.
      MissingExtraError: "mp4" without an encoder.
      RendererError: nothing here can draw.
    """
    check_format(film)
    find_backend()


class Films(Generic[RowT]):
    """Films of the first episode of each outcome, drawn from traces that are kept while it runs.

    Args:
      run: runs an episode by its number, and fills a trace of every `EVERY` steps.
      folder: for the films, OUTCOME-NUMBER.gif or .mp4. film: which of the two. title: of all of them.
    """

    def __init__(
        self, run: Callable[[int, Trace], RowT], folder: Path, film: FilmFormat, title: str
    ) -> None:
        self._run = run
        self._folder = folder
        self._film = film
        self._title = title
        self._kept: dict[str, tuple[int, Trace]] = {}

    def run(self, number: int, trace: Trace | None = None) -> RowT:
        """Runs an episode, and keeps its trace if none ended like this before."""
        trace = Trace(EVERY) if trace is None else trace
        row = self._run(number, trace)
        self._kept.setdefault(row.outcome, (number, trace))
        return row

    def draw(
        self, rows: Sequence[RowT], again: Callable[[int, Trace], RowT] | None = None
    ) -> list[Path]:
        """Films the first of each outcome; those that are there already are left as they are.

        Args:
          rows: of all episodes, by number.
          again: runs one that ran in an earlier process once more; as all others if not given.

        Returns:
          The films that were made.

        Raises:
          BankError: an episode that was run again ended in another way.
          RendererError: nothing here can draw.
          MissingExtraError: "mp4" without an encoder.
        """
        firsts: dict[str, int] = {}
        for number, row in enumerate(rows):
            firsts.setdefault(row.outcome, number)
        paths = {
            number: inside(self._folder, f"{outcome.replace(' ', '-')}-{number}.{self._film}")
            for outcome, number in firsts.items()
        }
        missing = {number: path for number, path in paths.items() if not path.exists()}
        with Progress("films", len(missing), "film") as progress:
            for number, path in missing.items():
                row = rows[number]
                trace = self._trace_of(number, row, again or self._run)
                save_film(episode_frames(trace, f"{self._title}, episode {number}", row), path, FPS)
                progress.update()
        return list(missing.values())

    def _trace_of(self, number: int, row: RowT, again: Callable[[int, Trace], RowT]) -> Trace:
        kept, trace = self._kept.get(row.outcome, (-1, None))
        if kept == number and trace is not None:
            return trace
        trace = Trace(EVERY)
        check_repeated(number, row, again(number, trace))
        return trace


def episode_frames(trace: Trace, title: str, row: EpisodeRow) -> Iterator[np.ndarray]:
    """Pictures u8[360, 480, 3] of an episode, with what the hand holds, the time, and at last the outcome."""
    model = add_lighting(trace.spec_on_pedestals()).compile()
    # Each shadow costs more than all else of a picture without a GPU.
    model.light_castshadow[:] = False
    model.light_castshadow[model.light(KEY_LIGHT).id] = True
    data = mujoco.MjData(model)
    width = _FINE * _WIDTH
    height = _FINE * _HEIGHT
    step = model.opt.timestep * trace.every
    speed = float(np.clip(len(trace.states) * step / _SECONDS, 1.0, _FASTEST))
    shown = np.arange(0, len(trace.states), speed / (FPS * step)).astype(int)
    azimuth = _AZIMUTH + float(np.degrees(trace.scene.support.region.yaw))
    view = CameraView(azimuth=azimuth, elevation=_ELEVATION)
    # The lamps stand to the camera as they do in pictures of scenes.
    light_yaw = float(np.radians(azimuth - CameraView().azimuth))
    content = _content(trace, model, data)
    reach = set_range(model, content, view, width, height)
    camera = fit_camera(content, view, width, height)
    with open_renderer(model, width, height) as renderer:

        def frame_of(
            state: np.ndarray, text: str, rgb: tuple[float, float, float] | None = None
        ) -> np.ndarray:
            data.qpos[:] = state
            mujoco.mj_kinematics(model, data)
            large = renderer.average(data, camera, 1, reach, light_yaw=light_yaw)
            small = large.reshape(_HEIGHT, _FINE, _WIDTH, _FINE, 3).mean((1, 3))
            image = with_caption(small.astype(np.uint8), text, rgb)
            return image if rgb is None else with_frame(image, rgb)

        for number in shown:
            held = trace.held[number]
            moved = f": {trace.scene.names[held]} in hand" if held >= 0 else ""
            yield frame_of(trace.states[number], f"{title}{moved}, {(number + 1) * step:.1f} s")
        text = f"{title}: {ending_of(row)}, {row.seconds:.1f} s"
        last = frame_of(trace.data.qpos, text, GREEN if row.is_success else _FAILED)
        yield from [last] * round(_HELD * FPS)


def _content(trace: Trace, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """f64[P, 3]: boxes around the arm's links at all times, the objects at the start, and the region."""
    support = trace.scene.support
    corners = [
        np.column_stack([support.region.corners, np.full(4, support.top + z)]) for z in (0.0, _ROOM)
    ]
    points = [*corners, trace.scene.poses[:, :3]]
    is_arm = Robot.of(model, trace.robot).is_arm
    for state in [*trace.states, trace.data.qpos]:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        points += [data.xpos[is_arm] - _ARM_WIDTH, data.xpos[is_arm] + _ARM_WIDTH]
    return np.concatenate(points)
