"""Views of perception data: draws scene, camera, arm and appearance of each, and makes blocks of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cluttergen_jax.downstream.bank_scenes import StableScenes
from cluttergen_jax.downstream.perception.views.stage import Kind, Stage, draw_camera, open_stage
from cluttergen_jax.downstream.perception.views.store import (
    SCHEMA,
    VIEWS,
    StoredView,
    ViewSet,
    row_of,
)
from cluttergen_jax.downstream.robot.cameras import SIZE
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.variation import TEXTURES_OF
from cluttergen_jax.scene.bank import Bank
from cluttergen_jax.sensing import Camera
from cluttergen_jax.statistics import is_of_share

_ROBOT = 0.6
"""Share of pairs of the robot's cameras."""
_ROBOTS: tuple[Kind, Kind] = ("overhead", "wrist")
# Cameras that are drawn until so large a share of the objects is in the picture.
_CAMERAS = 8
_SEEN = 0.4

VIEWS_A_SCENE = 4
"""Views of each scene, at two moments of its filling; where there are too few scenes they are used again."""


@dataclass(frozen=True)
class PerceptionViewConfig:
    """What views are made of.

    Attributes:
      seed: of all that is drawn. arm: share of the views with the arm in them, in [0, 1].
    """

    seed: int = 0
    arm: float = 1 / 3

    def __post_init__(self) -> None:
        if not 0 <= self.arm <= 1:
            raise ConfigError(f"arm = {self.arm}", "a share from 0 to 1", "arm=0")


class PerceptionViews:
    """Draws views of scenes on a stage; view i is the same however many are made.

    Args:
      scenes: of each bank; all of the same objects and support. stage: see `open_stage`.
      split: whose textures are drawn.
    """

    def __init__(
        self,
        scenes: Sequence[StableScenes],
        stage: Stage,
        config: PerceptionViewConfig,
        split: str,
        support: Any,
        num_objects: int,
    ) -> None:
        self._scenes = tuple(scenes)
        self._stage = stage
        self._config = config
        self._textures = TEXTURES_OF[split]
        self._support = support
        self._num_objects = num_objects

    def view(self, number: int) -> dict[str, object]:
        """A row of `store.SCHEMA`; views 2 i and 2 i + 1 show the same moment, in different light.

        Six in ten pairs are of the robot's cameras, the one over the table and the one on the hand.
        """
        pair, place = divmod(number, 2)
        rng = np.random.default_rng((self._config.seed, pair, 3))
        stage = self._stage
        support = self._support
        turn, bank = divmod(pair, len(self._scenes))
        scenes = self._scenes[bank]
        row = scenes.row(turn // (VIEWS_A_SCENE // 2))
        placed = scenes.objects[row][scenes.objects[row] >= 0]
        # What was placed first stands without what came later, not the other way round.
        placed = placed[: 1 + int(len(placed) * np.sqrt(rng.uniform()))]
        poses = np.zeros((self._num_objects, 7))
        poses[placed] = scenes.poses[row, : len(placed)]
        stage.place(poses, np.isin(np.arange(self._num_objects), placed))
        # Not used since shares are exact; what is drawn after them stays as it was.
        rng.uniform(size=2)
        is_robot = self.is_robots(pair)
        has_arm = self.has_arm(pair)
        tool = stage.move_arm(support.top, rng if has_arm else None)
        kind = _ROBOTS[place] if is_robot else "free"
        rng = np.random.default_rng((self._config.seed, number, 4))
        texture = stage.dress(rng, self._textures)
        seen = stage.picture(self._camera(kind, poses[placed], tool, rng))
        stored = StoredView(number, seen, placed, poses[placed], scenes.method, has_arm)
        return row_of(stored, int(scenes.number[row]), texture)

    def is_robots(self, pair: int) -> bool:
        """Whether a pair of views is of the robot's cameras."""
        return self._is_of_share(pair, _ROBOT, 0)

    def has_arm(self, pair: int) -> bool:
        """Whether a pair of views has the arm in it."""
        return self._is_of_share(pair, self._config.arm, 1)

    def _is_of_share(self, pair: int, share: float, which: int) -> bool:
        """Exact shares of the pairs of each bank, and so of all, for any number of views."""
        turn, bank = divmod(pair, len(self._scenes))
        start = np.random.default_rng((self._config.seed, which, 5)).uniform()
        return is_of_share(turn, share, (start + bank / len(self._scenes)) % 1)

    def _camera(
        self, kind: Kind, poses: np.ndarray, tool: np.ndarray | None, rng: np.random.Generator
    ) -> Camera:
        """A camera that has some of the objects in its picture, if one is found soon."""
        for _ in range(_CAMERAS):
            camera = draw_camera(kind, self._support, tool, rng)
            pixels, depth = camera.project(poses[:, :3])
            is_inside = (
                (pixels > 0).all(1) & (pixels < [camera.width, camera.height]).all(1) & (depth > 0)
            )
            if is_inside.mean() >= _SEEN:
                break
        return camera


def write_views(
    out: str | Path,
    banks: Mapping[str, Bank],
    split: str,
    num_views: int,
    config: PerceptionViewConfig,
    overwrite: bool = False,
) -> ViewSet:
    """The views of one split in a folder, begun or continued; see `cluttergen_jax.perception_data`."""
    path = Path(out)
    first = next(iter(banks.values()))
    scenes = [StableScenes.read(bank) for bank in banks.values()]
    names = [str(name) for name in first.record["recipe"]["names"]]
    made = {
        "seed": config.seed,
        "arm": config.arm,
        # Versions before drew for each pair by itself whether it has the arm, and shares came out by chance.
        "shares_are": "exact",
        "block_size": VIEWS.block_size,
        "size": list(SIZE),
        "views_a_scene": VIEWS_A_SCENE,
        "textures": list(TEXTURES_OF[split]),
        "recipes": [bank.record["recipe"] for bank in banks.values()],
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco")},
    }

    def fill(record: dict[str, Any], missing: dict[int, int]) -> None:
        if not missing:
            return
        views = ViewSet(path, record)
        total = record["splits"][split][VIEWS.number]
        with (
            Progress(f"views of {split}", total, "view", total - sum(missing.values())) as progress,
            open_stage(views.objects, views.support, config.arm > 0) as stage,
        ):
            drawn = PerceptionViews(scenes, stage, config, split, views.support, len(views.objects))
            for block, number in missing.items():
                rows = []
                for view in range(block * VIEWS.block_size, block * VIEWS.block_size + number):
                    rows.append(drawn.view(view))
                    progress.update(1)
                VIEWS.write_block(path, split, block, pa.Table.from_pylist(rows, schema=SCHEMA))

    shared = {"assets": first.record["assets"], "names": names}
    return ViewSet(path, VIEWS.write(path, first, shared, split, made, num_views, overwrite, fill))
