"""Pairs to learn stable placement from on disk: their record, the rows of a block, and how they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import msgspec
import numpy as np
import pyarrow as pa

from cluttergen_jax.config import check_workers
from cluttergen_jax.downstream.noise import NOISE_OFF, NoiseConfig
from cluttergen_jax.downstream.placer.map_from_depth import (
    DepthView,
    QueryMaker,
    SceneCameras,
    SceneMaps,
    check_cameras,
    depth_of,
)
from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.downstream.samples import (
    FAR,
    MOST_PIXELS,
    SPLITS,
    SampleFormat,
    SampleSet,
    faults_of,
    lengths_of,
    numbers_of,
    read_columns,
)
from cluttergen_jax.downstream.words import MAX_PAIRS
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.generation import setup_of
from cluttergen_jax.geometry import product, rotation_matrix
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import Problem, Setup
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Bank
from cluttergen_jax.schema import Numbers, SchemaError, refuse
from cluttergen_jax.sensing import Camera


class PairSplit(msgspec.Struct):
    """How a split was made, as far as it is read."""

    num_pairs: Annotated[int, msgspec.Meta(ge=1, le=MAX_PAIRS)]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    camera: str
    recipe: dict[str, Any]


class PairRecord(msgspec.Struct):
    """What `pairs.json` holds."""

    assets: dict[str, Any]
    splits: dict[Literal["train", "val", "test"], PairSplit]


_NUMBERS = {
    "camera_K": Numbers("f8", ("pairs", 9), -1e5, 1e5),
    "T_region_camera": Numbers("f8", ("pairs", 16), -FAR, FAR),
    "width": Numbers("i4", ("pairs",), 1, MOST_PIXELS),
    "height": Numbers("i4", ("pairs",), 1, MOST_PIXELS),
    "standing_poses": Numbers("f4", (None, 7), -FAR, FAR),
    "target_pose": Numbers("f4", ("pairs", 7), -FAR, FAR),
    "candidate": Numbers("f4", (None, 4), -FAR, FAR),
    "candidate_source": Numbers("u1", (None,), 0, 2),
    "candidate_verdict": Numbers("u1", (None,), 0, max(Verdict)),
}
"""Of a block's columns."""


def check_rows(table: pa.Table) -> None:
    """Refuses rows of pairs that no `PairMaker` makes.

    Raises:
      SchemaError: a number is not finite or out of its range, or the parts of a row do not belong together.
    """
    found = read_columns(table, _NUMBERS)
    for name in ("scene", "slot", "object", "standing"):
        numbers_of(table, name)
    standing = numbers_of(table, "num_standing")
    pixels = found["width"].astype(np.int64) * found["height"]
    candidates = lengths_of(table, "candidate")
    lengths = {
        "standing": standing,
        "standing_poses": standing,
        "depth": 2 * pixels,
        "labels": pixels,
        "candidate": np.full(len(pixels), candidates[0]),
        "candidate_source": candidates,
        "candidate_verdict": candidates,
    }
    refuse(faults_of(table, lengths, found["standing_poses"], found["target_pose"]))
    for image, most in zip(table["labels"], (1 + standing).tolist(), strict=True):
        if np.frombuffer(image.as_buffer(), np.uint8).max(initial=0) > most:
            raise SchemaError(f"'labels' holds a label beyond {most}")


SCHEMA = pa.schema(
    [
        ("pair", pa.int32()),
        ("scene", pa.int32()),
        ("slot", pa.int32()),
        ("object", pa.string()),
        ("pool", pa.string()),
        ("num_standing", pa.int32()),
        ("camera_K", pa.list_(pa.float64(), 9)),
        ("T_region_camera", pa.list_(pa.float64(), 16)),
        ("width", pa.int32()),
        ("height", pa.int32()),
        ("depth", pa.binary()),
        ("labels", pa.binary()),
        ("standing", pa.list_(pa.string())),
        ("standing_poses", pa.list_(pa.list_(pa.float32(), 7))),
        ("target_pose", pa.list_(pa.float32(), 7)),
        ("candidate", pa.list_(pa.list_(pa.float32(), 4))),
        ("candidate_source", pa.list_(pa.uint8())),
        ("candidate_verdict", pa.list_(pa.uint8())),
    ]
)
"""Poses are T_region_object, position in metres and quaternion wxyz; candidates x, y, z in metres and yaw in
radians. Matrices stand row by row. Depth is u16 in millimetres along the optical axis, little-endian, row by
row, 0 where nothing is; labels are u8: 0 the floor, 1 the support, 2 + k the k-th standing object."""
PAIRS = SampleFormat("pairs", "pair", "cluttergen placer data", SCHEMA, 256, PairRecord, check_rows)


class PairLabels(NamedTuple):
    """What is known of P pairs beside the queries: the truth, for learning and judging alone.

    Attributes:
      pair, scene, slot: i32[P]; num_standing: i32[P], objects that stand.
      object_index: i32[P], of the object to be placed, in the world of `PairSet.setup`.
      order: i32[P, N], the objects that stand, then the one to be placed, then -1.
      poses: f32[P, N, 7], T_region_object of those that stand; the identity elsewhere.
      target: f32[P, 7], T_region_object where the scene's own object rests.
      candidate: f32[P, 32, 4], x, y, z and yaw of T_region_object; source: u8[P, 32], of `pair_maker`.
      verdict: u8[P, 32], `types.Verdict` of each.
      unseen: f32[P], share of the region's cells in which something may be hidden from the query.
    """

    pair: np.ndarray
    scene: np.ndarray
    slot: np.ndarray
    num_standing: np.ndarray
    object_index: np.ndarray
    order: np.ndarray
    poses: np.ndarray
    target: np.ndarray
    candidate: np.ndarray
    source: np.ndarray
    verdict: np.ndarray
    unseen: np.ndarray


class PairSet(SampleSet):
    """A folder of pairs that is read. `record` is what `pairs.json` holds."""

    form = PAIRS

    def setup(self, split: str) -> Setup:
        """The world of a split, natively judged.

        Raises:
          ConfigError: there is no such split; BankError: an asset is missing or damaged.
        """
        recipe = self.split(split)["recipe"]
        assets = self.record["assets"]
        return setup_of(Bank(self.path, {"recipe": recipe, "assets": assets}), engine="native")


read_pairs = PairSet.read


PairFilter = Callable[[pa.Table], np.ndarray]
"""Says of some rows which are wanted, bool[R]."""


def load_queries(
    dataset: str | Path | PairSet,
    noise: NoiseConfig | Sequence[NoiseConfig] = NOISE_OFF,
    seed: int = 0,
    split: str = "train",
    num_pairs: int | None = None,
    num_threads: int = 0,
    num_cameras: int = 1,
    wanted: PairFilter | None = None,
) -> tuple[PlacementQuery, PairLabels]:
    """The queries of a split, NumPy arrays with a leading axis, and what is known beside them.

    Args:
      noise: of the depth camera, drawn here: another `seed` draws it anew, and each split has draws of its
        own; of several, pairs take turns.
      num_pairs: the first so many; all if None.
      num_threads: 0 takes every core.
      num_cameras: that look at each scene, their maps fused (`QueryMaker.see_all`). All but the first
        are drawn and looked through here; which they are is decided by the pairs' own seed.
      wanted: of these pairs, which are read; all if None.

    Raises:
      ConfigError: there is no such split, an argument is out of range, or no pair is wanted.
      BankError: a block or an asset is missing or damaged.
    """
    check_workers("num_threads", num_threads)
    pairs = dataset if isinstance(dataset, PairSet) else read_pairs(dataset)
    made = pairs.split(split)
    total = pairs.num_samples(split, num_pairs)
    check_cameras(num_cameras, made["camera"])
    problem = pairs.setup(split).problem
    names = {name: k for k, name in enumerate(problem.world.names)}
    noises = (noise,) if isinstance(noise, NoiseConfig) else tuple(noise)
    reader = _Reader(problem, made["camera"], made["seed"], num_cameras, SPLITS[split])
    queries: list[PlacementQuery] = []
    labels: list[PairLabels] = []
    with (
        ThreadPoolExecutor(num_threads or None) as pool,
        Progress(f"reading {split}", total, "pair") as progress,
    ):
        for rows in pairs.tables(split, total):
            chosen = rows if wanted is None else rows.filter(pa.array(wanted(rows)))
            if chosen.num_rows:
                part = labels_of(chosen, names, problem.rules.num_slots)
                noise_of_each = [noises[pair % len(noises)] for pair in part.pair]
                sights = list(
                    pool.map(reader.see, reader.scenes(chosen, part), noise_of_each, repeat(seed))
                )
                seen = zip(sights, part.object_index, strict=True)
                queries.append(
                    stack_queries([reader.maker.query(sight, index) for sight, index in seen])
                )
                unseen = np.array([sight.unseen for sight in sights], np.float32)
                labels.append(part._replace(unseen=unseen))
            progress.update(rows.num_rows)
    if not queries:
        raise ConfigError(
            f"no wanted pairs among {total} of {split!r} in {pairs.path}", "one or more"
        )
    return concatenate_queries(queries), PairLabels(
        *(np.concatenate(each) for each in zip(*labels, strict=True))
    )


def of_tenths(*tenths: int) -> PairFilter:
    """Pairs whose numbers end in one of these digits: pairs of a split stand in a drawn order."""
    return lambda table: np.isin(np.asarray(table["pair"]) % 10, tenths)


class _SeenScene(NamedTuple):
    """A pair as it is read: its image and camera, its number, and what stands, in the world."""

    view: DepthView
    pair: int
    poses: np.ndarray
    is_placed: np.ndarray


class _Reader:
    """Makes sights of the rows of one split.

    Args:
      problem: their world; camera, seed: that they were made with; num_cameras: that look at each.
      first_seed: of the split.
    """

    def __init__(
        self, problem: Problem, camera: str, seed: int, num_cameras: int, first_seed: int
    ) -> None:
        self.maker = QueryMaker(problem)
        self._num_cameras = num_cameras
        self._seed = seed
        self._first_seed = first_seed
        self._num_objects = len(problem.world.names)
        self._cameras = SceneCameras(problem, camera) if num_cameras > 1 else None

    def scenes(self, table: pa.Table, labels: PairLabels) -> Iterator[_SeenScene]:
        """What `see` needs of some rows."""
        for row, view in enumerate(images_of(table, self.maker.T_world_region)):
            standing = slice(0, int(labels.num_standing[row]))
            poses = np.zeros((self._num_objects, 7))
            is_placed = np.zeros(self._num_objects, bool)
            at = labels.order[row, standing]
            poses[at] = changed_frame(self.maker.T_world_region, labels.poses[row, standing])
            is_placed[at] = True
            yield _SeenScene(view, int(labels.pair[row]), poses, is_placed)

    def see(self, scene: _SeenScene, noise: NoiseConfig, seed: int) -> SceneMaps:
        """What a pair's cameras see with noise drawn for it."""
        views = [scene.view]
        if self._cameras is not None:
            place = (self._seed, scene.pair)
            views += self._cameras.further(scene.poses, scene.is_placed, place, self._num_cameras)
        rng = np.random.default_rng((self._first_seed + seed, scene.pair))
        return self.maker.see_all(views, noise, rng)


def stack_queries(queries: Sequence[PlacementQuery]) -> PlacementQuery:
    """Queries of one world as one, with a leading axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *queries)


def concatenate_queries(queries: Sequence[PlacementQuery]) -> PlacementQuery:
    """Batches of queries of one world as one batch."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *queries)


def labels_of(table: pa.Table, names: dict[str, int], num_slots: int) -> PairLabels:
    """The labels of some rows, but for what is unseen; names: the world's objects by their number.

    Raises:
      BankError: an object is not of that world.
    """
    columns = {name: table[name].to_pylist() for name in ("object", "standing", "standing_poses")}
    num_pairs = table.num_rows
    order = np.full((num_pairs, num_slots), -1, np.int32)
    poses = np.tile(np.eye(7, dtype=np.float32)[3], (num_pairs, num_slots, 1))
    try:
        for row, (name, standing, at) in enumerate(zip(*columns.values(), strict=True)):
            order[row, : len(standing) + 1] = [names[each] for each in (*standing, name)]
            if standing:
                poses[row, : len(standing)] = at
    except (KeyError, ValueError) as error:
        raise BankError(
            f"a pair names objects that its record does not ({error})", hint=PAIRS.again
        ) from error
    num_standing = np.array(table["num_standing"], np.int32)

    def numbers(name: str, kind: type) -> np.ndarray:
        return np.array(table[name].to_pylist(), kind)

    return PairLabels(
        pair=np.array(table["pair"], np.int32),
        scene=np.array(table["scene"], np.int32),
        slot=np.array(table["slot"], np.int32),
        num_standing=num_standing,
        object_index=order[np.arange(num_pairs), num_standing],
        order=order,
        poses=poses,
        target=numbers("target_pose", np.float32),
        candidate=numbers("candidate", np.float32),
        source=numbers("candidate_source", np.uint8),
        verdict=numbers("candidate_verdict", np.uint8),
        unseen=np.full(num_pairs, np.nan, np.float32),
    )


def images_of(table: pa.Table, T_world_region: np.ndarray) -> Iterator[DepthView]:
    """Each row's depth image, f32[H, W] in metres, inf where nothing is, and its camera in the world."""
    names = ("camera_K", "T_region_camera", "width", "height", "depth")
    for row in table.select(names).to_pylist():
        width = row["width"]
        height = row["height"]
        T = np.array(row["T_region_camera"]).reshape(4, 4)
        camera = Camera(width, height, np.array(row["camera_K"]).reshape(3, 3), T_world_region @ T)
        yield DepthView(depth_of(row["depth"], width, height), camera)


def changed_frame(T: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """f32[..., 7]: poses f[..., 7] of one frame as another sees them, which sees the first at T, f64[4, 4].

    T is a turn about z and a shift.
    """
    yaw = np.arctan2(T[1, 0], T[0, 0])
    turn = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    position = np.asarray(poses[..., :3], np.float64) @ rotation_matrix(turn).T + T[:3, 3]
    quaternion = product(
        np.broadcast_to(turn, (*poses.shape[:-1], 4)), np.asarray(poses[..., 3:], np.float64)
    )
    return np.concatenate([position, quaternion], axis=-1).astype(np.float32)
