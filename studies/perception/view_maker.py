"""Views of perception data: objects, a table and the arm on a stage, seen by cameras that are drawn.

Scene, camera, arm and appearance of each view are drawn; blocks of them are made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets import VISUAL_GROUP, ObjectAsset, SupportAsset
from cluttergen_jax.config import Variation
from cluttergen_jax.downstream.bank_scenes import StableScenes
from cluttergen_jax.downstream.perception.types import ARM, BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, above, wrist_camera
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.model import Robot, with_robot
from cluttergen_jax.downstream.transforms import rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import HIDDEN_GROUP, TEXTURES_OF, PictureConfig, add_lighting
from cluttergen_jax.scene import Bank, Scene
from cluttergen_jax.sensing import Camera, View, free
from cluttergen_jax.statistics import is_of_share
from cluttergen_jax.views import ViewMaker
from studies.perception.view_store import (
    SCHEMA,
    VIEWS,
    StoredView,
    ViewSet,
    row_of,
)

Kind = Literal["free", "overhead", "wrist"]
"""Of cameras."""
_TILT = np.radians(4.0)
_SHIFT = 0.03


def draw_camera(
    kind: Kind, support: SupportAsset, tool: np.ndarray | None, rng: np.random.Generator
) -> Camera:
    """A camera for a view: around the table, nearly overhead, or as the one on the hand.

    Args:
      tool: f64[4, 4], T_world_tool, where the arm is in the view; None if there is none.
    """
    if kind == "free":
        return free(support, rng, *SIZE, FOCAL)
    if kind == "overhead":
        return _shake(above(support), rng)
    return wrist_camera(_draw_tool(support, rng) if tool is None else tool)


def _shake(camera: Camera, rng: np.random.Generator) -> Camera:
    """The camera moved and turned by a little."""
    T = camera.T_world_camera.copy()
    T[:3, 3] += rng.uniform(-_SHIFT, _SHIFT, 3)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0, _TILT, 3)).as_matrix() @ T[:3, :3]
    return replace(camera, T_world_camera=T)


def _draw_tool(support: SupportAsset, rng: np.random.Generator) -> np.ndarray:
    """f64[4, 4]: a hand that looks down on the region from 30 to 60 cm, tilted by up to a few degrees."""
    half = 0.6 * np.asarray(support.region.half_extents)
    place = np.array([*support.region.center, support.top])
    place += [*rng.uniform(-half, half), rng.uniform(0.3, 0.6)]
    turn = Rotation.from_euler("zx", [rng.uniform(0, 2 * np.pi), np.pi])
    tilt = Rotation.from_rotvec(rng.normal(0, np.radians(6.0), 3))
    return rigid((tilt * turn).as_matrix(), place)


_PARKED = 60.0
"""Metres from the table, where objects are before they are placed."""
_REACH = 1.5
_LOW = 0.25
"""Metres over the table that the tool stays, so that the arm meets no object."""
_ARM_SPREAD = 0.25
_ARM_TRIES = 20
_SHADOWS = 1024
"""Pixels of a lamp's shadows; the usual 2,048 take most of a small picture's time."""


class Stage:
    """See `open_stage`."""

    def __init__(
        self,
        maker: ViewMaker,
        objects: Sequence[ObjectAsset],
        support: SupportAsset,
        has_arm: bool,
    ) -> None:
        self._maker = maker
        self._objects = tuple(objects)
        self._support = support
        self.place(np.zeros((len(objects), 7)), np.zeros(len(objects), bool))
        renderer = maker.renderer
        renderer.reach = _REACH
        self._data = renderer.data
        self._model = renderer.model_renderer.model
        self._arm = Robot.of(self._model) if has_arm else None
        is_arm = np.zeros(self._model.ngeom, bool)
        if self._arm is not None:
            is_arm = self._arm.is_arm[self._model.geom_bodyid]
        self._arm_geoms = is_arm & (self._model.geom_group == VISUAL_GROUP)
        is_object = renderer.labels >= FIRST_OBJECT
        renderer.labels = np.where(is_arm, ARM, np.where(is_object, renderer.labels, BACKGROUND))

    def place(self, poses: np.ndarray, is_placed: np.ndarray) -> None:
        """Puts the objects where they stand.

        Args:
          poses: f[K, 7], T_world_object; is_placed: bool[K], the others are not there.
        """
        self._maker.place(self._objects, poses, self._support, is_placed)

    def dress(self, rng: np.random.Generator, textures: Sequence[int]) -> int:
        """See `ViewMaker.dress`."""
        return self._maker.dress(rng, textures)

    def move_arm(self, top: float, rng: np.random.Generator | None) -> np.ndarray | None:
        """Shows the arm, somewhere about its home and well over the table; T_world_tool f64[4, 4].

        Args:
          top: the height of the table. rng: None hides the arm, and there is no tool.
        """
        is_hidden = rng is None
        self._model.geom_group[self._arm_geoms] = HIDDEN_GROUP if is_hidden else VISUAL_GROUP
        self._model.site_group[:] = HIDDEN_GROUP if is_hidden else 0
        if self._arm is None or rng is None:
            return None
        home = np.array(find_robot().arm.home)
        for _ in range(_ARM_TRIES):
            joints = np.clip(
                home + rng.normal(0, _ARM_SPREAD, len(home)), self._arm.low, self._arm.high
            )
            self._data.qpos[self._arm.qpos] = joints
            self._data.qpos[self._arm.fingers] = rng.uniform(0.0, 0.04)
            mujoco.mj_kinematics(self._model, self._data)
            if self._arm.tool(self._data)[2, 3] > top + _LOW:
                break
        return self._arm.tool(self._data)

    def picture(self, camera: Camera) -> View:
        """What a camera of `cameras.SIZE` sees now; labels u8[H, W], see `types`."""
        view = self._maker.see(camera)
        return replace(view, label=view.label.astype(np.uint8))


@contextmanager
def open_stage(
    objects: Sequence[ObjectAsset], support: SupportAsset, has_arm: bool
) -> Iterator[Stage]:
    """A stage.

    Args:
      has_arm: the arm can be shown.

    Raises:
      MissingExtraError: the arm is wanted and the extra `robot` is not installed.
      RendererError: nothing here can draw.
    """
    with ViewMaker(
        PictureConfig(*SIZE, samples=1),
        vary=get_args(Variation),
        around=_REACH * np.array([[-1, -1, 0], [1, 1, 1]]),
        spec_of=partial(_stage_spec, has_arm),
        is_measured_by_gl=True,
    ) as maker:
        yield Stage(maker, objects, support, has_arm)


def _stage_spec(
    has_arm: bool, objects: Sequence[ObjectAsset], support: SupportAsset
) -> mujoco.MjSpec:
    names = tuple(asset.name for asset in objects)
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(names), 1))
    poses[:, 0] = _PARKED + np.arange(len(names))
    scene = Scene(names, tuple(objects), poses, support)
    spec = with_robot(scene) if has_arm else scene.to_mjspec()
    add_lighting(spec).visual.quality.shadowsize = _SHADOWS
    return spec


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
    """The views of one split in a folder, begun or continued; see `api.perception_data`."""
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
