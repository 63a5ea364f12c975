"""`cluttergen render`: pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.parse import keywords, parse_numbers, parse_size
from cluttergen_jax.config import FilmFormat
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.rendering.config import CameraView, FilmConfig


@dataclass(frozen=True)
class Render:
    """Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure.

    Example: `cluttergen render out --sheet --turntable`

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
    view: CameraView = field(default_factory=CameraView)
    whole: bool = False
    hulls: bool = False
    samples: int | None = None
    film: FilmFormat = "gif"
    pace: FilmConfig = field(default_factory=FilmConfig)
    columns: int = 4

    def run(self) -> int:
        """Runs the command; the exit status, 1 if something could not be made."""
        from cluttergen_jax.generation.sources.rendering import render

        numbers = "all" if self.scenes and self.scenes.strip() == "all" else parse_numbers(self.scenes)
        size = None if self.size is None else parse_size(self.size)
        report = render(**keywords(self) | {"scenes": numbers, "size": size})
        for path in report.paths:
            print(path)
        if report.failures:
            print(with_flags(failures_text(report.failures), Render), file=sys.stderr)
        return 1 if report.failures else 0


def failures_text(failures: Sequence[tuple[str, ClutterGenError]]) -> str:
    """What could not be made and why, a line each; what to try, once."""
    lines = [f"error: {len(failures)} could not be made, the rest was:"]
    lines += [f"  {name}: {error.given}" for name, error in failures]
    hints = dict.fromkeys(error.hint for _, error in failures if error.hint)
    return "\n".join([*lines, *(f"Try: {hint}." for hint in hints)])
