"""What can be asked of an import, where nothing that imports is loaded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from cluttergen_jax.config import Quality
from cluttergen_jax.errors import ConfigError

MAX_TEXTURE = 1024
"""Pixels a side that an imported image has at most, unless asked."""
MAX_PART_VERTICES = 32
"""Vertices that a convex part has at most."""
ALARM_FACTOR = 3.0
"""What a file says twice may differ by this much: what is seen and what collides, mass and size."""
NUM_TRIALS = 256
"""Placements by which an object's solo stability is measured."""
MAX_SIZE = 0.60
"""Metres that the largest side of an object stays below: the shorter side of the usual table."""
MAX_MASS = 20.0
"""Kilograms that an object may weigh: what one lifts onto a table with two hands."""
SURFACE_AIR = 0.05
"""Metres of free air over a surface of furniture that counts: what is lower holds nothing."""
SURFACE_WIDTH = 0.05
"""Metres: the shorter side of the largest rectangle on the narrowest surface that counts. What is narrower,
and would still hold the smallest objects, is mostly the top of a rail."""
SURFACE_AREA = 0.005
"""Square metres, 5 cm x 10 cm, of the smallest surface that counts."""
NARROW_SURFACE = 0.15
"""Metres: furniture whose largest surface is narrower is mostly on its edge, or of another unit."""
TIME_LIMIT = 120.0
"""Seconds that the import of one object may take."""


@dataclass(frozen=True)
class DecompositionConfig:
    """CoACD's parameters, and when it is not needed.

    The default searches far less than CoACD's own (threshold 0.05, nodes 20, iterations 150, depth 3,
    resolution 2,000). Its parts that are far from the surface are halved, and the many parts merged: on
    scanned mugs and cans that leaves fewer parts than a long search, and takes a fraction of its time.

    Attributes:
      threshold: CoACD's concavity at which a part is convex enough.
      max_parts: convex parts at most; more are merged.
      resolution: samples by which concavity is measured.
      nodes: cutting planes that the tree search considers at a time.
      iterations: of the tree search.
      depth: how many cuts it looks ahead.
      seed: of CoACD's sampling.
      tries: other searches, as short, for what needs few parts and got too many or bad ones.
      simplify: how far the mesh may move to have fewer triangles, over its diagonal.
      quality: "standard", or "fine" for a longer search with half the threshold and more parts, which are
        nearer to the surface.
      exact: parts are looked for that fill the solid without gaps (`exact_parts`) before CoACD is asked.
      one_hull_volume: a solid that fills this share of its hull ...
      one_hull_deviation: ... and is nowhere farther from it than this, over the diagonal, gets one hull.
    """

    threshold: float = 0.06
    max_parts: int = 32
    resolution: int = 500
    nodes: int = 5
    iterations: int = 15
    depth: int = 1
    seed: int = 0
    tries: int = 3
    simplify: float = 0.004
    quality: Quality = "standard"
    exact: bool = True
    one_hull_volume: float = 0.8
    one_hull_deviation: float = 0.03

    def __post_init__(self) -> None:
        if not 0.01 <= self.threshold <= 1:
            raise ConfigError(f"threshold = {self.threshold}", "CoACD's range, 0.01 to 1")
        if self.quality not in get_args(Quality):
            raise ConfigError(f"quality {self.quality!r}", "standard or fine")
        if self.tries < 0:
            raise ConfigError(f"tries = {self.tries}", "0 or more")
        if not 1 <= self.max_parts <= 32:
            raise ConfigError(f"max_parts = {self.max_parts}", "1 to 32")

    @property
    def search(self) -> DecompositionConfig:
        """The parameters as they are used: those given, or for fine parts a longer search than that."""
        if self.quality == "standard":
            return self
        return replace(
            self,
            threshold=max(0.01, self.threshold / 2),
            resolution=2 * self.resolution,
            nodes=self.nodes + 1,
            iterations=2 * self.iterations,
            depth=self.depth + 1,
            simplify=self.simplify / 2,
            one_hull_deviation=self.one_hull_deviation / 2,
        )
