"""`cluttergen render`: pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from cluttergen_jax.assets.scene_cloud import ply_of, scene_points
from cluttergen_jax.bank.disk import write_atomically
from cluttergen_jax.cli.parse import parse_numbers
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.recording import Recording
from cluttergen_jax.render.assets import render_scene
from cluttergen_jax.render.camera import View
from cluttergen_jax.render.figure import closed_loop_figure
from cluttergen_jax.render.film import FilmConfig, replay, replay_frames, turntable
from cluttergen_jax.render.gl import find_backend
from cluttergen_jax.render.sensors import depth_png, npz_of, segmentation_png, sense
from cluttergen_jax.render.sheet import contact_sheet, save_png
from cluttergen_jax.render.stage import Shooting
from cluttergen_jax.render.video import check_format, save_film
from cluttergen_jax.sources import BankSource, open_source
from cluttergen_jax.viewer.source import Source

_SHEET = 12
_FINE, _QUICK = 32, 10
_LARGE, _SMALL, _CELL = (1280, 960), (640, 480), (480, 360)


@dataclass(frozen=True)
class Render:
    """Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure.

    Attributes:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes.
      out: the folder for what is made; files are named after the scene.
      scenes: numbers such as 0,3,7 or 0-9; the first that stands if not given (12 of them on a sheet).
      picture: draw a PNG of each scene (--no-picture to skip).
      sheet: all scenes on one contact sheet, sheet.png.
      turntable: a film once around the scene.
      replay: a film of the placement as it happened, failed attempts in red.
      figure: the closed-loop figure: an object's failed attempts ringed in red, until it stands.
      depth: a 16-bit PNG in millimetres along the optical axis (0: nothing there), and the NPZ file.
      segmentation: an indexed PNG: 0 floor or nothing, 1 support, 2 + k object k; and the NPZ file.
      points: a PLY point cloud of all surfaces: metres, world frame, colours, labels as above.
      size: of pictures, WIDTHxHEIGHT in pixels; 1280x960, and 640x480 for films, if not given.
      view: from which side the scene is seen.
      whole: show the whole support instead of the objects and the region alone.
      hulls: draw the collision parts instead of the surfaces.
      samples: pictures averaged into one, for soft light; 32, and 10 for films, if not given.
      film: gif, or mp4 (extra video).
      pace: how fast films run.
      columns: of the contact sheet.
    """

    source: tyro.conf.Positional[str]
    out: Path = Path("out/pictures")
    scenes: str | None = None
    picture: bool = True
    sheet: bool = False
    turntable: bool = False
    replay: bool = False
    figure: bool = False
    depth: bool = False
    segmentation: bool = False
    points: bool = False
    size: str | None = None
    view: View = field(default_factory=View)
    whole: bool = False
    hulls: bool = False
    samples: int | None = None
    film: str = "gif"
    pace: FilmConfig = field(default_factory=FilmConfig)
    columns: int = 4

    def run(self) -> int:
        """Runs the command; the exit status."""
        if self.turntable or self.replay:
            check_format(self.film)
        sizes = {size: self._shooting(size, _QUICK) for size in (_LARGE, _SMALL, _CELL)}
        source, own = open_source(self.source)
        numbers = chosen_numbers(source, own, self.scenes, _SHEET if self.sheet else 1)
        if self.picture or self.sheet or self.turntable or self.replay or self.figure or self._is_sensed:
            find_backend()
        for number in numbers:
            recording = source.recorded(number) if self.replay or self.figure else source.still(number)
            stem = self.out / (f"{number:06d}" if isinstance(source, BankSource) else _stem(source, number))
            for path in self._make(recording, stem, sizes[_SMALL]):
                print(path)
        if self.sheet:
            print(save_png(self._sheet(source, numbers), self.out / "sheet.png"))
        return 0

    @property
    def _is_sensed(self) -> bool:
        return self.depth or self.segmentation

    def _shooting(self, size: tuple[int, int], samples: int) -> Shooting:
        width, height = parse_size(self.size) if self.size else size
        samples = samples if self.samples is None else self.samples
        return Shooting(width, height, samples, self.view, self.whole, self.hulls)

    def _make(self, recording: Recording, stem: Path, small: Shooting) -> Iterator[Path]:
        """Everything that is asked for of one scene."""
        large = self._shooting(_LARGE, _FINE)
        if self.picture and not (self.sheet and not self.scenes):
            yield save_png(drawn(recording, large), _named(stem, ".png"))
        if self.figure:
            yield save_png(closed_loop_figure(recording, shooting=large), _named(stem, "-figure.png"))
        if self._is_sensed:
            yield from self._sensed(recording, stem, large)
        if self.points:
            cloud = scene_points(_placed(recording), recording.poses[recording.placed], recording.support)
            yield _written(_named(stem, "-points.ply"), ply_of(cloud))
        if self.turntable:
            count = max(2, round(self.pace.fps * self.pace.seconds))
            yield self._filmed(turntable(recording, self.pace, small), count, _named(stem, "-turntable"))
        if self.replay:
            count = len(replay_frames(recording, self.pace))
            yield self._filmed(replay(recording, self.pace, small), count, _named(stem, "-replay"))

    def _sensed(self, recording: Recording, stem: Path, shooting: Shooting) -> Iterator[Path]:
        placed = recording.placed
        names = [recording.names[index] for index in placed]
        sensed = sense(_placed(recording), names, recording.poses[placed], recording.support, shooting)
        if self.depth:
            yield _written(_named(stem, "-depth.png"), depth_png(sensed.depth))
        if self.segmentation:
            yield _written(_named(stem, "-segmentation.png"), segmentation_png(sensed.segmentation))
        yield _written(_named(stem, "-sensors.npz"), npz_of(sensed))

    def _filmed(self, frames: Iterable[np.ndarray], count: int, path: Path) -> Path:
        shown = tqdm(frames, total=count, unit="frame", desc=path.name, disable=None, leave=False)
        return save_film(shown, path.with_name(f"{path.name}.{self.film}"), self.pace.fps)

    def _sheet(self, source: Source, numbers: list[int]) -> np.ndarray:
        shooting = self._shooting(_CELL, _QUICK if len(numbers) > _SHEET else _FINE)
        bar = tqdm(numbers, unit="picture", desc="sheet.png", disable=None, leave=False)
        recordings = [source.still(number) for number in numbers]
        images = [drawn(recording, shooting) for recording, _ in zip(recordings, bar, strict=True)]
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
      BankError: no scene of the bank stands, and none was asked for.
    """
    if own is not None:
        if text is not None:
            raise ConfigError(f"--scenes {text} beside a single scene", "one of the two")
        return [own]
    asked = parse_numbers(text)
    if asked is not None:
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


def drawn(recording: Recording, shooting: Shooting) -> np.ndarray:
    """uint8[height, width, 3]: the finished scene."""
    return render_scene(
        _placed(recording),
        recording.poses[recording.placed],
        recording.support,
        camera=shooting.view,
        close=not shooting.whole,
        width=shooting.width,
        height=shooting.height,
        hulls=shooting.hulls,
        samples=shooting.samples,
    )


def _placed(recording: Recording) -> list:
    return [recording.objects[index] for index in recording.placed]


def _named(stem: Path, ending: str) -> Path:
    return stem.with_name(stem.name + ending)


def _stem(source: Source, number: int) -> str:
    name = re.sub(r"[^\w.+-]+", "-", source.name)
    return name if len(source.numbers) == 1 else f"{name}-{number:06d}"


def _written(path: Path, data: bytes) -> Path:
    write_atomically(path, data)
    return path
