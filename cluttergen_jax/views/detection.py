"""Views as datasets for detectors: COCO, and YOLO as Ultralytics reads it.

    images/SPLIT/BANK-000003-free-0.png     colours of a view
    annotations/instances_SPLIT.json        COCO: images, objects that are seen, categories
    labels/SPLIT/BANK-000003-free-0.txt     YOLO: a line for each object that is seen
    data.yaml                               YOLO: folders of splits, names of classes
    shards/SPLIT-00-000003.json             what 64 scenes of bank 0 have in the files above, with digests

A category is a label; objects' names are attributes. What these formats have no place for, cameras and poses,
stands under keys of its own in COCO's files and in the shards.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from cluttergen_jax.config import DatasetForm
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.files import file_whole, inside, remove_partial, write_atomically
from cluttergen_jax.schema import (
    Record,
    SchemaError,
    checked_record,
    convert,
    digest_of,
    with_checksum,
)
from cluttergen_jax.sensing import View
from cluttergen_jax.views.images import png_of
from cluttergen_jax.views.maker import SeenScene
from cluttergen_jax.views.outlines import outline_of
from cluttergen_jax.views.shards import (
    ShardWriter,
    ViewSource,
    amodal_box,
    shard_name,
    visible_box,
)

DetectionForm = Literal["coco", "yolo", "yolo-seg"]
IMAGES = "images"
LABELS = "labels"
SHARDS = "shards"
ANNOTATIONS = "annotations"
_MOST_BANKS = 1000
_MOST_OBJECTS = 10_000
_VAL_INSTEAD = ("val", "test", "train")
"""What YOLO is told to validate on, the first that has views."""
_MEANT = (
    "bbox, area and segmentation: what is seen of an object; bbox_amodal and segmentation_amodal: its whole "
    "silhouette, the box beyond the picture's edge, too; visibility: the share of that which is seen. "
    "object: its place in the image's `objects`, whose poses are T_world_object, position in metres, then "
    "quaternion wxyz. K: pixels, the middle of the first one at (0.5, 0.5). T_world_camera: metres, x right, "
    "y down, z forward."
)


def check_detection(form: DatasetForm, num_banks: int) -> None:
    """Refuses what a form cannot hold.

    Raises:
      MissingExtraError: COCO without the extra `coco`.
      ConfigError: too many banks for numbers of images.
    """
    if form == "coco":
        try:
            import pycocotools.mask  # noqa: F401
        except ImportError as error:
            raise MissingExtraError("coco", "the form coco") from error
    if num_banks > _MOST_BANKS:
        raise ConfigError(
            f"{num_banks} banks with form {form!r}", f"{_MOST_BANKS} at most", "form='parquet'"
        )


@dataclass(frozen=True)
class DetectionFiles:
    """The files of a dataset for detectors.

    Attributes:
      out: its folder.
      categories: labels; a category's number is its place, from 1 in COCO and from 0 in YOLO.
    """

    out: Path
    form: DetectionForm
    categories: tuple[str, ...]

    def name_of(self, split: str, bank: int, shard: int) -> str:
        return f"{SHARDS}/{shard_name(split, bank, shard, 'json')}"

    def is_whole(self, name: str, num_views: int, digest: str | None) -> bool:
        try:
            data = (self.out / name).read_bytes()
            if digest is not None and digest_of(data) != digest:
                return False
            record = convert(checked_record(data), _ShardRecord)
            return len(record.images) == num_views and all(
                digest_of(inside(self.out, each).read_bytes()) == known
                for each, known in record.files.items()
            )
        except (OSError, SchemaError):
            return False

    def writer(self, name: str, split: str) -> ShardWriter:
        return _DetectionWriter(self.out, name, split, self.form, self.categories)

    def remove_partial(self, splits: Sequence[str]) -> None:
        inner = [f"{name}/{split}" for name in (IMAGES, LABELS) for split in splits]
        for folder in (self.out / name for name in (ANNOTATIONS, SHARDS, *inner)):
            if folder.is_dir():
                remove_partial(folder)

    def write_index(
        self, shards: Mapping[str, Sequence[str]], num_views: Mapping[str, int]
    ) -> None:
        """COCO's file of each split, or YOLO's data.yaml."""
        if self.form == "coco":
            for split, names in shards.items():
                records = [self.out / name for name in names]
                _write_instances(self.out, split, records, self.categories)
        else:
            text = _data_yaml(self.categories, num_views)
            write_atomically(self.out / "data.yaml", text.encode())


@dataclass
class _ShardRecord:
    """What a split of a shard has: digests of its files by name, and COCO's images and annotations."""

    files: dict[str, str] = field(default_factory=dict)
    images: list[Record] = field(default_factory=list)
    annotations: list[Record] = field(default_factory=list)


@dataclass
class _DetectionWriter:
    """Writes images as they come, and the shard's record at the end."""

    out: Path
    name: str
    split: str
    form: DetectionForm
    categories: Sequence[str]
    record: _ShardRecord = field(default_factory=_ShardRecord)

    def add(self, view: View, scene: SeenScene, source: ViewSource) -> None:
        stem = f"{source.bank}-{scene.number:06d}-{source.camera}"
        image = _image_record(f"{stem}.png", view, scene, source)
        annotations = [
            self._annotation(image["id"], index, view, scene)
            for index, each in enumerate(view.instances)
            if each.visible.any()
        ]
        if self.form != "coco":
            # Before the image, which would count as one of nothing.
            lines = [self._line(each, view) for each in annotations]
            self._write(f"{LABELS}/{self.split}/{stem}.txt", "".join(lines).encode())
        self._write(f"{IMAGES}/{self.split}/{stem}.png", png_of(view.colours))
        self.record.images.append(image)
        self.record.annotations += annotations

    def finish(self) -> None:
        data = json.dumps(with_checksum(asdict(self.record))).encode() + b"\n"
        write_atomically(self.out / self.name, data)

    def _write(self, name: str, data: bytes) -> None:
        write_atomically(self.out / name, data)
        self.record.files[name] = digest_of(data)

    def _annotation(self, image_id: int, index: int, view: View, scene: SeenScene) -> Record:
        asset = scene.objects[index]
        seen = view.instances[index]
        record = {
            "id": image_id * _MOST_OBJECTS + index,
            "image_id": image_id,
            "category_id": self.categories.index(asset.label) + 1,
            "bbox": visible_box(seen.visible),
            "area": int(seen.visible.sum()),
            "iscrowd": 0,
            "bbox_amodal": amodal_box(seen),
            "visibility": seen.visible_share,
            "object": index,
            "attributes": {"name": asset.name, "synset": asset.synset},
        }
        if self.form == "coco":
            record["segmentation"] = run_lengths(seen.visible)
            record["segmentation_amodal"] = run_lengths(seen.mask)
        return record

    def _line(self, annotation: Record, view: View) -> str:
        """As Ultralytics has it: the class, and the box or the outline in shares of the picture's size."""
        size = np.array([view.camera.width, view.camera.height])
        if self.form == "yolo":
            left, top, width, height = annotation["bbox"]
            shares = np.array([left + width / 2, top + height / 2, width, height]) / np.tile(
                size, 2
            )
        else:
            shares = outline_of(view.instances[annotation["object"]].visible) / size
        numbers = " ".join(f"{share:.6f}" for share in shares.ravel().tolist())
        return f"{annotation['category_id'] - 1} {numbers}\n"


def image_id(scene: int, source: ViewSource) -> int:
    """COCO's number of a scene's view, 1 or more, which no other has and which growth does not change."""
    place = scene * _MOST_BANKS + source.bank_number
    return place * source.num_cameras + source.camera_number + 1


def _image_record(name: str, view: View, scene: SeenScene, source: ViewSource) -> Record:
    """A view as COCO has it, with its camera and all objects of its scene, whether they are seen or not."""
    return {
        "id": image_id(scene.number, source),
        "file_name": name,
        **view.camera.record(),
        "bank": source.bank,
        "scene": scene.number,
        "camera": source.camera,
        "objects": [
            {"name": own, "label": asset.label, "pose": pose.tolist()}
            for own, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True)
        ],
    }


def run_lengths(mask: np.ndarray) -> dict[str, Any]:
    """bool[H, W] as COCO's compressed run lengths, by COCO's own library."""
    from pycocotools import mask as coco

    found = coco.encode(np.asfortranarray(mask, np.uint8))
    return {"size": list(map(int, found["size"])), "counts": found["counts"].decode("ascii")}


def _write_instances(
    out: Path, split: str, shards: Sequence[Path], categories: Sequence[str]
) -> None:
    """COCO's file of a split, one shard in memory at a time."""
    listed = [
        {"id": number, "name": label, "supercategory": "object"}
        for number, label in enumerate(categories, 1)
    ]
    head = {
        "info": {"description": f"Views of simulated scenes, {split}", "extra_keys": _MEANT},
        "licenses": [],
        "categories": listed,
    }
    with (
        file_whole(out / ANNOTATIONS / f"instances_{split}.json") as fresh,
        fresh.open("w", encoding="utf-8") as file,
    ):
        file.write(json.dumps(head)[:-1])
        for key in ("images", "annotations"):
            file.write(f',\n"{key}": [')
            for number, entry in enumerate(_entries(shards, key)):
                file.write((",\n" if number else "\n") + json.dumps(entry))
            file.write("]")
        file.write("}\n")


def _entries(shards: Sequence[Path], key: str) -> Iterator[Record]:
    for path in shards:
        yield from checked_record(path.read_bytes())[key]


def validation_split(num_views: Mapping[str, int]) -> str:
    """On which split YOLO is told to validate: `val`, else one that has views."""
    return next((split for split in _VAL_INSTEAD if num_views.get(split)), "val")


def _data_yaml(categories: Sequence[str], num_views: Mapping[str, int]) -> str:
    folders = {
        split: f"{IMAGES}/{split}" if num_views.get(split) else None
        for split in ("train", "val", "test")
    }
    note = ""
    if folders["val"] is None:
        instead = validation_split(num_views)
        folders["val"] = folders[instead]
        note = f"# Ultralytics needs `val`; this dataset has none, so it is `{instead}`.\n"
    record = {**folders, "names": dict(enumerate(categories))}
    text = yaml.safe_dump(record, sort_keys=False, allow_unicode=True)
    return f"# Folders are relative to this file's, so that the dataset can be moved.\n{note}{text}"
