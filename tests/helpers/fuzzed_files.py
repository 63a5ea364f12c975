"""Sound files of every kind that the package reads as its own, small, each with the reader of it.

What readers return here is plain: two equal values are equal in every bit.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.downstream.perception.finder import Certainty, read_certainty
from cluttergen_jax.downstream.perception.frames import Frame, read_frame, write_frame
from cluttergen_jax.downstream.placer.pairs import PAIRS, SCHEMA, labels_of, read_pairs
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps, read_grasps, write_grasps
from cluttergen_jax.errors import PoolError
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.learning.policies.guided import NUM_FEATURES
from cluttergen_jax.learning.training.guided import Examples
from cluttergen_jax.learning.training.guided import _read as read_attempts
from cluttergen_jax.learning.training.guided import _write as write_attempts
from cluttergen_jax.sensing.camera import Camera, intrinsics
from cluttergen_jax.stores import RowStore
from studies.perception.evaluate import write_certainty
from studies.perception.view_store import SCHEMA as VIEW_SCHEMA
from studies.perception.view_store import VIEWS, read_views
from tests.helpers.records import unsigned
from tests.helpers.worlds import trio

EYE = np.eye(4).ravel().tolist()
STANDS = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]
CAMERA = Camera(4, 3, intrinsics(4, 3, 5.0), np.eye(4))
NAMES = ("box", "tall", "flat")


def plain(value: Any) -> Any:
    """A value in which arrays are their types, shapes and bytes."""
    if isinstance(value, pa.Table):
        return value.to_pylist()
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if dataclasses.is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in dataclasses.fields(value)}
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    if isinstance(value, str | bytes | int | float | bool) or value is None:
        return repr(value)
    array = np.asarray(value)
    return (str(array.dtype), array.shape, array.tobytes())


def pairs_of(number: int = 3) -> list[dict[str, Any]]:
    """Rows of pairs; pair k has k objects standing."""
    pixels = CAMERA.width * CAMERA.height
    return [
        {
            "pair": k, "scene": k, "slot": k, "object": NAMES[k], "pool": "trio", "num_standing": k,
            "camera_K": CAMERA.K.ravel().tolist(), "T_region_camera": EYE,
            "width": CAMERA.width, "height": CAMERA.height,
            "depth": np.arange(pixels, dtype="<u2").tobytes(), "labels": bytes([k % 2] * pixels),
            "standing": list(NAMES[:k]), "standing_poses": [STANDS] * k, "target_pose": STANDS,
            "candidate": [[0.1 * k, 0.0, 0.2, 1.0]] * 4, "candidate_source": [0, 1, 1, 2],
            "candidate_verdict": [0, 1, 2, 0],
        }
        for k in range(number)
    ]  # fmt: skip


def write_pairs(folder: Path, rows: list[dict[str, Any]] | None = None) -> None:
    """A folder of pairs, without assets."""
    rows = pairs_of() if rows is None else rows
    folder.mkdir(parents=True, exist_ok=True)
    split = {"num_pairs": len(rows), "seed": 0, "camera": "free", "recipe": {"pool": "trio"}}
    record = {"format": 1, "kind": "pairs", "assets": {"objects": {}}, "splits": {"train": split}}
    PAIRS.store.write_record(folder, record)
    PAIRS.write_block(folder, "train", 0, pa.Table.from_pylist(rows, schema=SCHEMA))


def load_pairs(folder: Path) -> Any:
    """What is read of pairs, but for what needs their assets."""
    pairs = read_pairs(folder)
    tables = list(pairs.tables("train"))
    numbers = {name: k for k, name in enumerate(NAMES)}
    labels = [labels_of(table, numbers, len(NAMES)) for table in tables]
    told = {name: pairs.split("train")[name] for name in ("num_pairs", "seed", "camera", "recipe")}
    return plain([told, tables, labels])


def write_views(folder: Path) -> None:
    """A folder of views, without assets."""
    folder.mkdir(parents=True, exist_ok=True)
    split = {"num_views": 2, "recipes": [{"pool": "trio"}]}
    record = {"format": 1, "kind": "views", "assets": {"objects": {}}, "names": list(NAMES)}
    VIEWS.store.write_record(folder, {**record, "splits": {"train": split}})
    pixels = CAMERA.width * CAMERA.height
    rows = [
        {
            "view": k, "scene": k, "method": "clear", "texture": 1, "has_arm": False,
            "camera_K": CAMERA.K.ravel().tolist(), "T_world_camera": EYE,
            "width": CAMERA.width, "height": CAMERA.height, "rgb": bytes(range(3 * pixels)),
            "depth": np.arange(pixels, dtype="<u2").tobytes(), "label": bytes([2 + k] * pixels),
            "objects": [k], "poses": [STANDS],
        }
        for k in range(2)
    ]  # fmt: skip
    VIEWS.write_block(folder, "train", 0, pa.Table.from_pylist(rows, schema=VIEW_SCHEMA))


def load_views(folder: Path) -> Any:
    """Names, how the split was made, and all views."""
    views = read_views(folder)
    made = {name: views.split("train")[name] for name in ("num_views", "recipes")}
    return plain([views.names, made, list(views.views("train"))])


GRASPS = Grasps(
    name=trio()[0].name,
    hash="",
    pose=np.array([STANDS] * 3),
    width=np.array([0.02, 0.03, 0.04]),
    shift=np.array([0.001, 0.0, 0.002]),
    slip=np.array([0.001, 0.0, 0.002]),
    turn=np.array([0.1, 0.0, 0.2]),
    margin=np.array([4.0, 3.0, 2.0]),
    is_low=np.array([True, True, False]),
    num_tested=12,
    held=np.array([STANDS] * 3),
)


def grasps(folder: Path) -> None:
    """The grasps of an object."""
    from cluttergen_jax.assets.object_files import object_hash

    asset = trio()[0]
    write_grasps(folder / "grasps.parquet", [dataclasses.replace(GRASPS, hash=object_hash(asset))])


def load_grasps(folder: Path) -> Any:
    """Those, or that there are none of this version."""
    found = read_grasps(folder / "grasps.parquet", trio()[0])
    if found is None:
        raise PoolError("grasps of another version")
    return plain(found)


ROW = EpisodeResult("success", "", "mug", 7, 0.001, 0.01, 0.0, 1e-4, 0, 12.0, 1.0)


def rows_file(folder: Path) -> RowStore[EpisodeResult]:
    """A file of rows."""
    return RowStore(
        folder / "episodes.jsonl", {"seed": 0, "pool": "trio"}, EpisodeResult, "robot place"
    )


def write_rows(folder: Path) -> None:
    """Three rows, with the grasps that they were made with."""
    file = rows_file(folder)
    file.note_grasps({"mug": "a digest"})
    file.write([dataclasses.replace(ROW, seconds=float(k), error=float("nan")) for k in range(3)])


def store(folder: Path) -> None:
    """A row of an evaluation, and its scenes."""
    scenes = {"poses": np.arange(12.0).reshape(3, 4), "is_success": np.array([True, False])}
    Store(folder).write("a row", "key", {"figures": {"success": 0.5, "trials": 12}}, scenes)


def load_store(folder: Path) -> Any:
    """The row's figures and scenes; a damaged file is set aside there, and counts as refused here."""
    with tempfile.TemporaryDirectory() as copy:
        shutil.copytree(folder, copy, dirs_exist_ok=True)
        kept = Store(Path(copy), show=lambda text: None)
        row = kept.read("a row", "key")
        arrays = kept.read_arrays("a row", "key")
    if row is None or arrays is None:
        raise PoolError("a file that was set aside")
    return plain([row["figures"], arrays])


def attempts(folder: Path) -> None:
    """Attempts that the network of `guided` learns from."""
    names = ("stands", "is_robust", "knows_robust", "disturbs", "is_on")
    flags = dict.fromkeys(names, np.array([True, False]))
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {"shift": np.float32([0.01, 0.1]), "margin": np.float32([0.0, -0.1])}
    write_attempts(
        folder / "attempts.npz",
        Examples(features=np.ones((2, NUM_FEATURES), np.float32), **flags, **numbers),
    )


def frame(folder: Path) -> None:
    """A picture with its camera."""
    depth = np.linspace(0.5, 0.9, 12, dtype=np.float32).reshape(3, 4)
    write_frame(folder, Frame(np.arange(36, dtype=np.uint8).reshape(3, 4, 3), depth, CAMERA))


def without_seal(make: Callable[[Path], None], name: str) -> Callable[[Path], None]:
    """The same folder as an older version would have left it: without any checksum in that file."""

    def made(folder: Path) -> None:
        make(folder)
        file = folder / name
        if file.suffix == ".parquet":
            metadata = pq.read_schema(file).metadata
            table = pq.read_table(file).replace_schema_metadata(metadata)
            pq.write_table(table, file, compression="none")
        else:
            file.write_text(json.dumps(unsigned(json.loads(file.read_text()))))

    return made


OWN: dict[str, tuple[Callable[[Path], None], str, Callable[[Path], Any]]] = {
    "pairs_record": (write_pairs, "pairs.json", load_pairs),
    "pairs_block": (write_pairs, "train-000000.parquet", load_pairs),
    "views_record": (write_views, "views.json", load_views),
    "views_block": (write_views, "train-000000.parquet", load_views),
    "grasps": (grasps, "grasps.parquet", load_grasps),
    "rows": (write_rows, "episodes.jsonl", lambda folder: plain(rows_file(folder).read(3))),
    "store_row": (store, "a-row-key.json", load_store),
    "store_scenes": (store, "a-row-key.npz", load_store),
    "attempts": (
        attempts,
        "attempts.npz",
        lambda folder: plain(read_attempts(folder / "attempts.npz")),
    ),
    "certainty": (
        lambda folder: write_certainty(folder, Certainty()),
        "certainty.json",
        lambda folder: plain(read_certainty(folder)),
    ),
    "frame_camera": (frame, "camera.json", lambda folder: plain(read_frame(folder))),
    "frame_depth": (frame, "depth.npy", lambda folder: plain(read_frame(folder))),
}
"""Each: what makes a sound folder, the file in it that is mutated, and what reads the folder."""
