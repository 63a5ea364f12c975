"""Pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from cluttergen_jax.assets.scene_cloud import ply_of, scene_points
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.generation.sources import BankSource, open_source
from cluttergen_jax.placement.rollout.replay import Replay
from cluttergen_jax.progress import tracked
from cluttergen_jax.rendering.assets import render_scene
from cluttergen_jax.rendering.config import CameraView, FilmConfig
from cluttergen_jax.rendering.figure import closed_loop_figure
from cluttergen_jax.rendering.film import replay, replay_frames, turntable
from cluttergen_jax.rendering.gl import find_backend
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.rendering.sensors import depth_png, npz_of, segmentation_png, sense
from cluttergen_jax.rendering.sheet import contact_sheet, save_png
from cluttergen_jax.rendering.video import check_format, save_film
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.scene.bank.reference import missing_text

_SHEET = 12
_FINE, _QUICK = 32, 10
_LARGE, _SMALL, _CELL = (1280, 960), (640, 480), (480, 360)
_Make = Callable[[Path], Iterable[Path]]
_Failure = tuple[str, ClutterGenError]


@dataclass(frozen=True)
class RenderReport:
    """What `render` made.

    Attributes:
      paths: the files.
      failures: what could not be made, and why.
    """

    paths: tuple[Path, ...]
    failures: tuple[_Failure, ...]


def render(
    source: str | Path,
    out: str | Path = Path("out/pictures"),
    *,
    scenes: Sequence[int] | Literal["all"] | None = None,
    picture: bool = True,
    sheet: bool = False,
    turntable: bool = False,
    replay: bool = False,
    figure: bool = False,
    depth: bool = False,
    segmentation: bool = False,
    points: bool = False,
    size: tuple[int, int] | None = None,
    view: CameraView | None = None,
    whole: bool = False,
    hulls: bool = False,
    samples: int | None = None,
    film: str = "gif",
    pace: FilmConfig | None = None,
    columns: int = 4,
) -> RenderReport:
    """Draws scenes: pictures, films, contact sheets and measurements (`cluttergen render`).

    Args:
      source: as of `view`.
      out: the folder for what is made; files are named after the scene.
      scenes: numbers, or "all"; the first that stands if not given (12 of them on a sheet).
      picture: draw a PNG of each scene.
      sheet: all scenes on one contact sheet, sheet.png.
      turntable: a film once around the scene.
      replay: a film of the placement as it happened, failed attempts in red.
      figure: the closed-loop figure: an object's failed attempts ringed in red, until it stands.
      depth: a 16-bit PNG in millimetres along the optical axis (0: nothing there), and the NPZ file.
      segmentation: an indexed PNG: 0 floor or nothing, 1 support, 2 + k object k; and the NPZ file.
      points: a PLY point cloud of all surfaces: metres, world frame, colours, labels as above.
      size: of pictures, width and height in pixels; (1280, 960), and (640, 480) for films, if not given.
      view: from which side the scene is seen; `CameraView()` if not given.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
      samples: pictures averaged into one, for soft light; 32, and 10 for films, if not given.
      film: "gif", or "mp4" (extra `video`).
      pace: how fast films run; `FilmConfig()` if not given.
      columns: of the contact sheet.

    Raises:
      PoolError, BankError, AssetError: there is no such source, no such scene, or none that stands.
      ConfigError: a setting is out of range.
      ClutterGenError: nothing can be drawn on this machine.
    """
    given = dict(locals())
    given |= {"out": Path(out), "view": view or CameraView(), "pace": pace or FilmConfig()}
    return Rendering(**given | {"source": str(source)}).make()


@dataclass(frozen=True)
class Rendering:
    """What is drawn, and how; the fields are arguments of `render`."""

    source: str
    out: Path
    scenes: Sequence[int] | Literal["all"] | None
    picture: bool
    sheet: bool
    turntable: bool
    replay: bool
    figure: bool
    depth: bool
    segmentation: bool
    points: bool
    size: tuple[int, int] | None
    view: CameraView
    whole: bool
    hulls: bool
    samples: int | None
    film: str
    pace: FilmConfig
    columns: int

    def make(self) -> RenderReport:
        """Makes everything that is asked for."""
        if self.turntable or self.replay:
            check_format(self.film)
        sizes = {size: self._picture(size, _QUICK) for size in (_LARGE, _SMALL, _CELL)}
        source, own = open_source(self.source)
        numbers = chosen_numbers(source, own, self.scenes, _SHEET if self.sheet else 1)
        if self.picture or self.sheet or self.turntable or self.replay or self.figure or self._is_sensed:
            find_backend()
        made: list[Path] = []
        failures: list[_Failure] = []
        for number in numbers:
            failures += self._make(source, number, sizes[_SMALL], made)
        if self.sheet:
            made.append(save_png(self._sheet(source, numbers), self.out / "sheet.png"))
        return RenderReport(tuple(made), tuple(failures))

    @property
    def _is_sensed(self) -> bool:
        return self.depth or self.segmentation

    def _picture(self, size: tuple[int, int], samples: int) -> PictureConfig:
        width, height = self.size or size
        samples = samples if self.samples is None else self.samples
        return PictureConfig(width, height, samples, self.view, self.whole, self.hulls)

    def _make(
        self, source: SceneSource, number: int, small: PictureConfig, made: list[Path]
    ) -> Iterator[_Failure]:
        """Makes everything that is asked for of one scene; what cannot be made costs nothing else."""
        stem = self.out / (f"{number:06d}" if isinstance(source, BankSource) else _stem(source, number))
        attempted = None
        if self.replay or self.figure:
            try:
                attempted = source.recorded(number)
            except ClutterGenError as error:
                yield f"{stem.name}, its attempts", error
        try:
            recording = attempted or source.still(number)
        except ClutterGenError as error:
            yield stem.name, error
            return
        for ending, make in self._products(recording, attempted is not None, small):
            try:
                made.extend(make(_named(stem, ending)))
            except ClutterGenError as error:
                yield stem.name + ending, error

    def _products(
        self, recording: Replay, has_attempts: bool, small: PictureConfig
    ) -> Iterator[tuple[str, _Make]]:
        """The endings of the files that are asked for, and how each is made."""
        large = self._picture(_LARGE, _FINE)
        if self.picture and not (self.sheet and not self.scenes):
            yield ".png", lambda path: [save_png(drawn(recording, large), path)]
        if self.figure and has_attempts:
            yield "-figure.png", lambda path: [save_png(closed_loop_figure(recording, picture=large), path)]
        if self._is_sensed:
            yield "-sensors.npz", lambda path: self._sensed(recording, path, large)
        if self.points:
            yield "-points.ply", lambda path: [_written(path, _cloud(recording))]
        if self.turntable:
            count = max(2, round(self.pace.fps * self.pace.seconds))
            turns = turntable(recording, self.pace, small)
            yield f"-turntable.{self.film}", lambda path: [self._filmed(turns, count, path)]
        if self.replay and has_attempts:
            steps = replay(recording, self.pace, small)
            length = len(replay_frames(recording, self.pace))
            yield f"-replay.{self.film}", lambda path: [self._filmed(steps, length, path)]

    def _sensed(self, recording: Replay, path: Path, picture: PictureConfig) -> Iterator[Path]:
        placed = recording.placed
        names = [recording.names[index] for index in placed]
        sensed = sense(_placed(recording), names, recording.poses[placed], recording.support, picture)
        stem = path.with_name(path.name.removesuffix("-sensors.npz"))
        if self.depth:
            yield _written(_named(stem, "-depth.png"), depth_png(sensed.depth))
        if self.segmentation:
            yield _written(_named(stem, "-segmentation.png"), segmentation_png(sensed.segmentation))
        yield _written(path, npz_of(sensed))

    def _filmed(self, frames: Iterable[np.ndarray], count: int, path: Path) -> Path:
        shown = tracked(frames, path.name, count, "frame")
        return save_film(shown, path, self.pace.fps)

    def _sheet(self, source: SceneSource, numbers: list[int]) -> np.ndarray:
        picture = self._picture(_CELL, _QUICK if len(numbers) > _SHEET else _FINE)
        recordings = [source.still(number) for number in numbers]
        shown = tracked(recordings, "sheet.png", len(recordings), "picture")
        images = [drawn(recording, picture) for recording in shown]
        captions = [
            f"{number:06d}" + ("" if recording.is_success else f" (failed: {recording.verdict})")
            for number, recording in zip(numbers, recordings, strict=True)
        ]
        return contact_sheet(images, captions, self.columns)


def chosen_numbers(
    source: SceneSource, own: int | None, asked: Sequence[int] | Literal["all"] | None, count: int
) -> list[int]:
    """Which scenes: those asked for, else the first `count` that stand.

    Raises:
      ConfigError: two answers to one question.
      BankError: scenes were asked for that are not there; or no scene of the bank stands.
    """
    if own is not None:
        if asked is not None:
            raise ConfigError("`scenes` beside a single scene", "one of the two")
        asked = [own]
    if asked is not None and asked != "all":
        if said := missing_text(asked, source.numbers):
            raise BankError(f"{source.name}: {said}", "scenes that are there", "leaving the others out")
        return list(asked)
    if not isinstance(source, BankSource):
        return list(source.numbers[:count])
    good = source.successes if asked is None else source.numbers
    if not good:
        raise BankError(
            f"{source.name}: none of its {len(source.numbers)} scenes stands",
            "`scenes` with the number of a failed one",
        )
    return list(good if asked == "all" else good[:count])


def drawn(recording: Replay, picture: PictureConfig) -> np.ndarray:
    """uint8[height, width, 3]: the finished scene."""
    return render_scene(
        _placed(recording),
        recording.poses[recording.placed],
        recording.support,
        camera=picture.view,
        close=not picture.whole,
        width=picture.width,
        height=picture.height,
        hulls=picture.hulls,
        samples=picture.samples,
    )


def _placed(recording: Replay) -> list:
    return [recording.objects[index] for index in recording.placed]


def _cloud(recording: Replay) -> bytes:
    poses = recording.poses[recording.placed]
    return ply_of(scene_points(_placed(recording), poses, recording.support))


def _named(stem: Path, ending: str) -> Path:
    return stem.with_name(stem.name + ending)


def _stem(source: SceneSource, number: int) -> str:
    name = re.sub(r"[^\w.+-]+", "-", source.name)
    return name if len(source.numbers) == 1 else f"{name}-{number:06d}"


def _written(path: Path, data: bytes) -> Path:
    write_atomically(path, data)
    return path
