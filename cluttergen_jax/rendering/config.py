"""What can be asked of a picture and of a film, where nothing that draws is imported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from cluttergen_jax.errors import ConfigError

MAX_FRAMES = 5000
Quality = Literal["draft", "fine"]


@dataclass(frozen=True)
class QualityConfig:
    """How pictures of a quality are drawn.

    Attributes:
      samples: pictures averaged into one, with light and pixels moved a little between them.
      smoothing: places of a pixel at which edges are drawn in each; 0 for one.
    """

    samples: int
    smoothing: int


QUALITIES: dict[Quality, QualityConfig] = {
    "draft": QualityConfig(1, 4),
    "fine": QualityConfig(10, 0),
}
"""A draft has sharp shadows and smooth edges; a fine picture soft shadows, for some five times the time."""
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
