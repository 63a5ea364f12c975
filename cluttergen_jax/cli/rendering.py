"""From the options of `cluttergen render` to pictures, films, contact sheets and measurements."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.scene_cloud import ply_of, scene_points
from cluttergen_jax.bank.reference import missing_text
from cluttergen_jax.cli.parse import parse_numbers
from cluttergen_jax.cli.render import Render
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.placement.recording import Recording
from cluttergen_jax.progress import tracked
from cluttergen_jax.render.assets import render_scene
from cluttergen_jax.render.figure import closed_loop_figure
from cluttergen_jax.render.film import replay, replay_frames, turntable
from cluttergen_jax.render.gl import find_backend
from cluttergen_jax.render.scene_renderer import PictureConfig
from cluttergen_jax.render.sensors import depth_png, npz_of, segmentation_png, sense
from cluttergen_jax.render.sheet import contact_sheet, save_png
from cluttergen_jax.render.video import check_format, save_film
from cluttergen_jax.sources import BankSource, open_source
from cluttergen_jax.viewer.source import Source

_SHEET = 12
_FINE, _QUICK = 32, 10
_LARGE, _SMALL, _CELL = (1280, 960), (640, 480), (480, 360)
_Make = Callable[[Path], Iterable[Path]]
_Failure = tuple[str, ClutterGenError]


class Rendering(Render):
    """The options, and what is made of them."""

    def make(self) -> int:
        """Makes everything that is asked for; the exit status."""
        if self.turntable or self.replay:
            check_format(self.film)
        sizes = {size: self._picture(size, _QUICK) for size in (_LARGE, _SMALL, _CELL)}
        source, own = open_source(self.source)
        numbers = chosen_numbers(source, own, self.scenes, _SHEET if self.sheet else 1)
        if self.picture or self.sheet or self.turntable or self.replay or self.figure or self._is_sensed:
            find_backend()
        failures: list[_Failure] = []
        for number in numbers:
            failures += self._make(source, number, sizes[_SMALL])
        if self.sheet:
            print(save_png(self._sheet(source, numbers), self.out / "sheet.png"))
        if failures:
            print(failures_text(failures), file=sys.stderr)
        return 1 if failures else 0

    @property
    def _is_sensed(self) -> bool:
        return self.depth or self.segmentation

    def _picture(self, size: tuple[int, int], samples: int) -> PictureConfig:
        width, height = parse_size(self.size) if self.size else size
        samples = samples if self.samples is None else self.samples
        return PictureConfig(width, height, samples, self.view, self.whole, self.hulls)

    def _make(self, source: Source, number: int, small: PictureConfig) -> Iterator[_Failure]:
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
                for path in make(_named(stem, ending)):
                    print(path)
            except ClutterGenError as error:
                yield stem.name + ending, error

    def _products(
        self, recording: Recording, has_attempts: bool, small: PictureConfig
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

    def _sensed(self, recording: Recording, path: Path, picture: PictureConfig) -> Iterator[Path]:
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

    def _sheet(self, source: Source, numbers: list[int]) -> np.ndarray:
        picture = self._picture(_CELL, _QUICK if len(numbers) > _SHEET else _FINE)
        recordings = [source.still(number) for number in numbers]
        shown = tracked(recordings, "sheet.png", len(recordings), "picture")
        images = [drawn(recording, picture) for recording in shown]
        captions = [
            f"{number:06d}" + ("" if recording.is_success else f" (failed: {recording.verdict})")
            for number, recording in zip(numbers, recordings, strict=True)
        ]
        return contact_sheet(images, captions, self.columns)


def parse_size(text: str) -> tuple[int, int]:
    """Pixels of WIDTHxHEIGHT.

    Raises:
      ConfigError: it is something else.
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise ConfigError(f"--size {text!r}", "WIDTHxHEIGHT in pixels, such as 1280x960")
    return int(match[1]), int(match[2])


def chosen_numbers(source: Source, own: int | None, text: str | None, count: int) -> list[int]:
    """Which scenes: those asked for, else the first `count` that stand.

    Raises:
      ConfigError: two answers to one question.
      BankError: scenes were asked for that are not there; or no scene of the bank stands.
    """
    if own is not None and text is not None:
        raise ConfigError(f"--scenes {text} beside a single scene", "one of the two")
    asked = parse_numbers(text) if own is None else [own]
    if asked is not None:
        if said := missing_text(asked, source.numbers):
            raise BankError(f"{source.name}: {said}", "scenes that are there", "leaving the others out")
        return asked
    if not isinstance(source, BankSource):
        return list(source.numbers[:count])
    good = source.successes if text is None else source.numbers
    if not good:
        raise BankError(
            f"{source.name}: none of its {len(source.numbers)} scenes stands",
            "--scenes NUMBER of a failed one",
        )
    return list(good if text is not None else good[:count])


def failures_text(failures: Sequence[_Failure]) -> str:
    """What could not be made and why, a line each; what to try, once."""
    lines = [f"error: {len(failures)} could not be made, the rest was:"]
    lines += [f"  {name}: {error.given}" for name, error in failures]
    hints = dict.fromkeys(error.hint for _, error in failures if error.hint)
    return "\n".join([*lines, *(f"Try: {hint}." for hint in hints)])


def drawn(recording: Recording, picture: PictureConfig) -> np.ndarray:
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


def _placed(recording: Recording) -> list:
    return [recording.objects[index] for index in recording.placed]


def _cloud(recording: Recording) -> bytes:
    poses = recording.poses[recording.placed]
    return ply_of(scene_points(_placed(recording), poses, recording.support))


def _named(stem: Path, ending: str) -> Path:
    return stem.with_name(stem.name + ending)


def _stem(source: Source, number: int) -> str:
    name = re.sub(r"[^\w.+-]+", "-", source.name)
    return name if len(source.numbers) == 1 else f"{name}-{number:06d}"


def _written(path: Path, data: bytes) -> Path:
    write_atomically(path, data)
    return path
