"""What can be asked of a picture and of a film, where nothing that draws is imported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cluttergen_jax.errors import ConfigError

MAX_FRAMES = 5000
Quality = Literal["draft", "fine", "photo"]


@dataclass(frozen=True)
class QualityConfig:
    """How pictures of a quality are drawn.

    Attributes:
      samples: pictures averaged into one, with light and pixels moved a little between them.
      smoothing: places of a pixel at which edges are drawn in each; 0 for one.
      is_photo: path tracing, `samples` being paths for each pixel.
    """

    samples: int
    smoothing: int
    is_photo: bool = False


QUALITIES: dict[Quality, QualityConfig] = {
    "draft": QualityConfig(1, 4),
    "fine": QualityConfig(32, 0),
    "photo": QualityConfig(12, 0, is_photo=True),
}
"""A draft has sharp shadows and smooth edges; a fine picture soft shadows, for some ten times the time; a
photo is traced along paths of light, for some hundred times the time."""


@dataclass(frozen=True)
class PhotoConfig:
    """What a photo, a picture of quality "photo", may have besides.

    Attributes:
      is_transparent: its floor, walls and sky are left out, and are clear in the picture.
      background: what is there instead: a colour, by name or as "#rrggbb", or the file of an image.
      f_number: of the lens, such as 2.8, focused on the middle of the scene; the smaller, the less is sharp
        before and behind it. None makes all sharp.

    Raises:
      ConfigError: both of the first two, or an f-number that is none.
    """

    is_transparent: bool = False
    background: str = ""
    f_number: float | None = None

    def __post_init__(self) -> None:
        is_number = isinstance(self.f_number, int | float) and 0.5 <= self.f_number <= 100
        if self.f_number is not None and not is_number:
            raise ConfigError(
                f"depth_of_field = {self.f_number!r}", "an f-number, 0.5 to 100", "2.8"
            )
        if self.is_transparent and self.background:
            raise ConfigError("transparent with a background", "one of the two")

    @property
    def is_cut_out(self) -> bool:
        """Whether floor, walls and sky are left out."""
        return self.is_transparent or bool(self.background)


_VIEW_LIMITS = {
    "azimuth": (-3600, 3600, " degrees"),
    "elevation": (-90, 90, " degrees"),
    "field_of_view": (1, 120, " degrees"),
    "margin": (0, 0.45, ""),
}


@dataclass(frozen=True)
class CameraView:
    """From which side a scene is seen.

    Attributes:
      azimuth: degrees; 0 looks along +x, 90 along +y.
      elevation: degrees; -90 looks straight down.
      field_of_view: degrees, vertical; small ones flatten perspective.
      margin: share of the picture left free at each edge, in [0, 0.45].
    """

    azimuth: float = 125.0
    elevation: float = -28.0
    field_of_view: float = 30.0
    margin: float = 0.06

    def __post_init__(self) -> None:
        for name, (least, most, unit) in _VIEW_LIMITS.items():
            if not least <= getattr(self, name) <= most:
                raise ConfigError(
                    f"CameraView.{name} = {getattr(self, name)}", f"{least:g} to {most:g}{unit}"
                )


@dataclass(frozen=True)
class FilmConfig:
    """How fast a film runs.

    Attributes:
      fps: frames per second.
      seconds: the longest that it takes; what would last longer is shown faster.
      slowdown: how many times slower than in reality objects settle, where there is time.
      lift: metres above its release from which an object is lowered (for the eye: that was not simulated).
      captions: write into the picture what is tried and how it ends.
    """

    fps: float = 20.0
    seconds: float = 12.0
    slowdown: float = 4.0
    lift: float = 0.12
    captions: bool = True

    def __post_init__(self) -> None:
        for name in ("fps", "seconds", "slowdown"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} = {getattr(self, name)}", "a finite number above zero")
        if self.fps * self.seconds > MAX_FRAMES:
            raise ConfigError(
                f"a film of {self.fps * self.seconds:.0f} frames",
                f"{MAX_FRAMES} at most",
                "fewer `seconds`",
            )
