"""Datasets of views on disk: shards that are whole or not there, and a record of how they were made.

    dataset.json                     how it was made, how many views each split has
    train-00-000003.parquet (.tar)   the views of a split of 64 scenes of bank 0

A shard holds the scenes of a split among 64 of a bank, perhaps none. `views.detection` has other files.

Parquet files say in their schema, under `huggingface`, what the library `datasets` makes of each column
(`views.features`), so that it gives images, and a hub shows them. In tar files depth is a PNG file called
`depth.png16`: decoders of the library WebDataset look at what is behind the last dot, and would make eight
bits of a `.png`.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import digest_of
from cluttergen_jax.sensing import Instance, View
from cluttergen_jax.stores import BlockStore
from cluttergen_jax.views.features import IMAGE, has_features_of, with_features
from cluttergen_jax.views.images import depth_png, label_image, png_of
from cluttergen_jax.views.maker import SeenScene

RowForm = Literal["parquet", "webdataset"]
ENDINGS: dict[RowForm, str] = {"parquet": "parquet", "webdataset": "tar"}
VIEWS = BlockStore("views", "dataset.json", "views of scenes", "cluttergen dataset")
"""Folders of datasets of views."""
_IMAGES = ("rgb", "depth", "label", "amodal")
SCENES_PER_SHARD = 64

_BOX = pa.list_(pa.list_(pa.int32(), 4))
SCHEMA = with_features(
    [
        ("bank", pa.string()),
        ("scene", pa.int32()),
        ("camera", pa.string()),
        ("width", pa.int32()),
        ("height", pa.int32()),
        ("K", pa.list_(pa.float64(), 9)),
        ("T_world_camera", pa.list_(pa.float64(), 16)),
        ("names", pa.list_(pa.string())),
        ("labels", pa.list_(pa.string())),
        ("poses", pa.list_(pa.list_(pa.float64(), 7))),
        ("visible", pa.list_(pa.float32())),
        ("box_visible", _BOX),
        ("box_amodal", _BOX),
        ("rgb", IMAGE),
        ("depth", IMAGE),
        ("label", IMAGE),
        ("amodal", pa.list_(IMAGE)),
    ]
)
"""A row for each view. K and T_world_camera row by row; poses T_world_object, metres, wxyz; boxes column,
row, width, height in pixels; images are PNG files, in `bytes`: `depth` in millimetres along the optical axis,
`label` 0 floor or nothing, 1 support, 2 + k object k; `amodal` each object's whole silhouette."""
DEPTH_NAME = "depth.png16"
"""The file of depth in a tar, behind the view's name and a dot."""


@dataclass(frozen=True)
class ViewSource:
    """Which view of a dataset one is.

    Attributes:
      bank: its name; bank_number: its place among the banks.
      camera: its name; camera_number: its place among the `num_cameras` cameras.
    """

    bank: str
    bank_number: int
    camera: str
    camera_number: int
    num_cameras: int


class ShardWriter(Protocol):
    """Writes the views of a split of a shard."""

    def add(self, view: View, scene: SeenScene, source: ViewSource) -> None:
        """Takes a view."""

    def finish(self) -> None:
        """Makes the shard whole."""


class ShardFiles(Protocol):
    """The files of a dataset in some form."""

    @property
    def out(self) -> Path:
        """The dataset's folder."""

    def name_of(self, split: str, bank: int, shard: int) -> str:
        """The file, in the dataset, that makes a split of a shard whole."""

    def is_whole(self, name: str, num_views: int, digest: str | None) -> bool:
        """Whether all files of a split of a shard are there as they were written, with so many views.

        Args:
          digest: of the file of that name, where it is known.
        """

    def writer(self, name: str, split: str) -> ShardWriter:
        """Writes a split of a shard."""

    def remove_partial(self, splits: Sequence[str]) -> None:
        """Removes what a maker that was killed left half written in folders of the dataset."""

    def write_index(
        self, shards: Mapping[str, Sequence[str]], num_views: Mapping[str, int]
    ) -> None:
        """Writes what belongs to all shards, once they are whole; names and numbers of views by split."""


@dataclass(frozen=True)
class RowFiles:
    """Files of rows, one for each split of a shard; they need nothing else."""

    out: Path
    form: RowForm

    def name_of(self, split: str, bank: int, shard: int) -> str:
        return shard_name(split, bank, shard, ENDINGS[self.form])

    def is_whole(self, name: str, num_views: int, digest: str | None) -> bool:
        return is_whole_shard(self.out / name, self.form, num_views, digest)

    def writer(self, name: str, split: str) -> ShardWriter:
        return _RowWriter(self.out / name, self.form)

    def remove_partial(self, splits: Sequence[str]) -> None:
        pass

    def write_index(
        self, shards: Mapping[str, Sequence[str]], num_views: Mapping[str, int]
    ) -> None:
        pass


@dataclass
class _RowWriter:
    path: Path
    form: RowForm
    rows: list[dict[str, Any]] = field(default_factory=list)

    def add(self, view: View, scene: SeenScene, source: ViewSource) -> None:
        # Compressed at once: what a camera sees is some megabytes.
        self.rows.append(row_of(view, scene, source.bank, source.camera))

    def finish(self) -> None:
        write_atomically(self.path, encode_rows(self.rows, self.form))


def shard_name(split: str, bank: int, shard: int, ending: str) -> str:
    """The file of a split's views of a shard of scenes."""
    return f"{split}-{bank:02d}-{shard:06d}.{ending}"


def row_of(view: View, scene: SeenScene, bank: str, camera: str) -> dict[str, Any]:
    """A view of a scene as a row of `SCHEMA`: images as bytes of PNG files, numbers as lists.

    Args:
      bank, camera: their names.
    """
    seen_from = view.camera
    return {
        "bank": bank,
        "scene": scene.number,
        "camera": camera,
        "width": seen_from.width,
        "height": seen_from.height,
        "K": seen_from.K.ravel().tolist(),
        "T_world_camera": seen_from.T_world_camera.ravel().tolist(),
        "names": list(scene.names),
        "labels": [asset.label for asset in scene.objects],
        "poses": scene.poses.tolist(),
        "visible": [each.visible_share for each in view.instances],
        "box_visible": [visible_box(each.visible) for each in view.instances],
        "box_amodal": [amodal_box(each) for each in view.instances],
        "rgb": None if view.rgb is None else png_of(view.rgb),
        "depth": depth_png(view.depth),
        "label": png_of(label_image(view.label, view.label.max())),
        "amodal": [png_of(each.mask) for each in view.instances],
    }


def visible_box(mask: np.ndarray) -> list[int]:
    """First column and row, width and height, pixels; zeros where nothing is."""
    rows = np.flatnonzero(mask.any(1))
    columns = np.flatnonzero(mask.any(0))
    if not len(rows):
        return [0, 0, 0, 0]
    return [int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]


def amodal_box(each: Instance) -> list[int]:
    """The same of its whole silhouette, what lies beyond the picture's edge included."""
    if each.box is None:
        return [0, 0, 0, 0]
    left, right, upper, lower = each.box
    return [left, upper, right - left + 1, lower - upper + 1]


def encode_rows(rows: Sequence[dict[str, Any]], form: RowForm) -> bytes:
    """The views of one shard as a file, a row of `row_of` each."""
    if form == "parquet":
        buffer = io.BytesIO()
        table = pa.Table.from_pylist([_with_images(row) for row in rows], schema=SCHEMA)
        # Images are compressed already.
        pq.write_table(
            table, buffer, compression="none", write_page_checksum=True, row_group_size=16
        )
        return buffer.getvalue()
    return _tar(rows)


def _with_images(row: dict[str, Any]) -> dict[str, Any]:
    """A row with its images as `datasets` stores them."""
    images = {name: _image(row[name]) for name in ("rgb", "depth", "label")}
    return row | images | {"amodal": [_image(mask) for mask in row["amodal"]]}


def _image(data: bytes | None) -> dict[str, Any] | None:
    return None if data is None else {"bytes": data, "path": None}


def _tar(rows: Sequence[dict[str, Any]]) -> bytes:
    """A tar file as the library WebDataset reads it: files of one view share all before the first dot."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as tar:

        def add(name: str, data: bytes) -> None:
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))

        for row in rows:
            key = f"{row['bank']}-{row['scene']:06d}-{row['camera']}".replace(".", "_")
            images = {
                name: row[name] for name in ("rgb", "depth", "label") if row[name] is not None
            }
            images |= {f"amodal-{place:03d}": mask for place, mask in enumerate(row["amodal"])}
            rest = {name: value for name, value in row.items() if name not in _IMAGES}
            for name, data in images.items():
                add(f"{key}.{DEPTH_NAME if name == 'depth' else f'{name}.png'}", data)
            add(f"{key}.json", json.dumps(rest).encode())
    return buffer.getvalue()


def is_whole_shard(path: Path, form: RowForm, num_views: int, digest: str | None) -> bool:
    """Whether a shard is there as it was written, with so many views.

    One that an earlier version wrote is not: its images were no images to other programs.

    Args:
      digest: of the file, where it is known.
    """
    try:
        if digest is not None and digest_of(path.read_bytes()) != digest:
            return False
        if form == "parquet":
            with pq.ParquetFile(path) as file:
                is_ours = has_features_of(file.schema_arrow, SCHEMA)
                return is_ours and file.metadata.num_rows == num_views
        with tarfile.open(path) as tar:
            names = tar.getnames()
        counted = [sum(name.endswith(end) for name in names) for end in (".json", DEPTH_NAME)]
        return counted == [num_views, num_views]
    except (OSError, pa.ArrowException, tarfile.TarError):
        return False
