"""Scenes of a source added to a BOP dataset: each once, under a number of its own, seen in one way."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import TracebackType

import numpy as np

from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.config import PixelOrigin
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import remove_partial
from cluttergen_jax.kept_folder import FolderLock
from cluttergen_jax.placement.rollout.replay import Replay
from cluttergen_jax.views.bop import CAMERA, BopDataset
from cluttergen_jax.views.bop_split import SPLIT, BopSplit, Place, SceneOrigin
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.sensing.camera import REALSENSE_FOCAL, REALSENSE_SIZE, Camera, free
from cluttergen_jax.sensing.camera_plan import CameraPlan


@dataclass(frozen=True)
class BopConfig:
    """How scenes are seen in a dataset, and where they go.

    Attributes:
      views: cameras that look at each scene; seed: of where they stand.
      split: the folder of the scenes in the dataset.
      pixel_origin: see `BopDataset`.
      cameras: those that look at each scene; None for `views` of them at places that are drawn.
    """

    views: int = 4
    seed: int = 0
    split: str = SPLIT
    pixel_origin: PixelOrigin = "center"
    cameras: tuple[CameraPlan, ...] | None = None


class BopScenes:
    """Holds a dataset against other writers while scenes are added to it.

    Args:
      folder: the dataset's, there or not.
      source: what to call the bank.
      picture: size, samples and look.
      is_drawn: draw colours.

    Raises:
      BankError: another process is writing the dataset.
      ConfigError: no name of a split, scenes of unknown origin in it, or a dataset of another camera.
    """

    def __init__(
        self, folder: Path, source: str, config: BopConfig, picture: PictureConfig, is_drawn: bool
    ) -> None:
        self._config = config
        self._picture = picture
        self._is_drawn = is_drawn
        self._source = source
        self._dataset = BopDataset(folder, config.split, config.pixel_origin)
        self._split = BopSplit(folder, config.split)
        self._places: dict[int, tuple[Place, SceneOrigin]] = {}
        # The same objects and support come in many scenes.
        self._hash = lru_cache(maxsize=None)(object_hash)
        self._support_hash = lru_cache(maxsize=None)(support_hash)
        self._check_camera()

    def __enter__(self) -> BopScenes:
        folder = self._dataset.folder
        folder.mkdir(parents=True, exist_ok=True)
        # What another process has begun between our looking at it and our holding it.
        self._lock = FolderLock(folder, check=self._check_camera)
        if self._split.folder.is_dir():
            remove_partial(self._split.folder)
        # What another process has added between our reading it and our holding it.
        self._split = BopSplit(folder, self._config.split)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._lock.release()

    def plan(self, recordings: Iterable[tuple[int, Replay]]) -> None:
        """Gives each scene its number, before any is drawn.

        Raises:
          ConfigError: one of them is there, seen otherwise.
        """
        for number, recording in recordings:
            origin = self._origin(recording, number)
            self._places[number] = self._split.place(origin), origin

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say of scenes that need not be drawn."""
        num_there = sum(place.is_there for place, _ in self._places.values())
        if not num_there:
            return ()
        return (f"{num_there} of {len(self._places)} scenes are in {self._split.folder} already",)

    def add(self, recording: Replay, number: int) -> list[Path]:
        """Adds a planned scene, seen from places drawn for its number; the folder, unless it is there."""
        place, origin = self._places[number]
        if place.is_there:
            return []
        placed = recording.placed
        objects = [recording.objects[index] for index in placed]
        cameras = self._cameras(recording, number)
        poses = recording.poses[placed]
        support = recording.support
        added = self._dataset.add(
            place.number, objects, poses, support, cameras, self._picture, origin, self._is_drawn
        )
        return [added]

    def _cameras(self, recording: Replay, number: int) -> list[Camera]:
        width = self._picture.width
        height = self._picture.height
        focal = REALSENSE_FOCAL * width / REALSENSE_SIZE[0]
        rng = np.random.default_rng([self._config.seed, number])
        support = replace(recording.support, region=recording.region)
        if self._config.cameras is not None:
            return [plan.draw(support, rng) for plan in self._config.cameras]
        return [free(support, rng, width, height, focal) for _ in range(self._config.views)]

    def _origin(self, recording: Replay, number: int) -> SceneOrigin:
        placed = recording.placed
        what = {
            "number": number,
            "objects": [self._hash(recording.objects[index]) for index in placed],
            "poses": np.asarray(recording.poses[placed], np.float64).tolist(),
            "support": self._support_hash(recording.support),
            "region": asdict(recording.region),
        }
        digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()
        picture = self._picture
        settings: dict[str, int | bool | str] = {
            "views": self._config.views,
            "seed": self._config.seed,
            "size": f"{picture.width}x{picture.height}",
            "samples": picture.samples,
            "hulls": picture.hulls,
            "pixel_origin": self._config.pixel_origin,
            "smoothing": picture.smoothing,
        }
        if self._config.cameras is not None:
            names = ", ".join(plan.name for plan in self._config.cameras)
            plans = hashlib.sha256(repr(self._config.cameras).encode()).hexdigest()
            settings["cameras"] = f"{names} ({plans[:8]})"
        return SceneOrigin(self._source, number, digest, settings, self._is_drawn)

    def _check_camera(self) -> None:
        """One dataset, one camera: its camera.json says which."""
        path = self._dataset.folder / CAMERA
        cameras = self._config.cameras
        if cameras is not None and len({plan.size for plan in cameras}) > 1:
            raise ConfigError(
                "cameras of different sizes in a BOP dataset",
                "pictures of one size",
                "`size` for all of them",
            )
        # Cameras of one's own may differ in what they see; each view's intrinsics are beside it.
        if cameras is not None or not path.is_file():
            return
        width = self._picture.width
        height = self._picture.height
        focal = REALSENSE_FOCAL * width / REALSENSE_SIZE[0]
        asked = self._dataset.sensor(Camera.looking(np.zeros(3), np.ones(3), width, height, focal))
        there = json.loads(path.read_bytes())
        if differing := [name for name, value in asked.items() if there.get(name) != value]:
            had = ", ".join(f"{name} {there.get(name)}" for name in differing)
            wanted = ", ".join(f"{name} {asked[name]}" for name in differing)
            raise ConfigError(
                f"{path} says {had}, and asked for is {wanted}",
                "one `size` and one `pixel_origin` in a dataset",
                "those of the dataset, or another `out`",
            )
