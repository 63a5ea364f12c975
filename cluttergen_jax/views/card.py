"""The card of a dataset of views: a README that a hub reads, with splits, features and the assets' terms."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.scene import assets_section, front_matter, write_unless_own
from cluttergen_jax.scene.bank import Bank
from cluttergen_jax.tables import markdown_table
from cluttergen_jax.views.features import card_features
from cluttergen_jax.views.shards import DEPTH_NAME, ENDINGS, SCHEMA, RowForm

_TASKS = ("object-detection", "image-segmentation", "depth-estimation", "robotics")
_TAGS = ("robotics", "clutter", "depth", "instance-segmentation", "pose-estimation")
_COLUMNS = {
    "bank": "the bank whose scene it is",
    "scene": "its number in the bank",
    "camera": "the camera's name",
    "width": "pixels",
    "height": "pixels",
    "K": "3 x 3, row by row; (0, 0) is the corner of the first pixel",
    "T_world_camera": "4 x 4, row by row, metres; x right, y down, z forward",
    "names": "of the objects; mug#2 is the second mug",
    "labels": "what each is, in words",
    "poses": "T_world_object, metres, quaternion wxyz; z up, origin on the floor below the support",
    "visible": "the share of each object's silhouette that is seen",
    "box_visible": "column, row, width, height in pixels of what is seen; zeros where nothing is",
    "box_amodal": "the same of the whole silhouette, beyond the picture too",
    "rgb": "colours; null where none were drawn",
    "depth": "16 bits, millimetres along the optical axis; 0: nothing",
    "label": "0 floor or nothing, 1 support, 2 + k object k",
    "amodal": "the whole silhouette of each object",
}
_DATASETS = """```python
from datasets import load_dataset

view = load_dataset("parquet", data_files={"{split}": "{split}-*.parquet"})["{split}"][0]
view["rgb"], view["depth"]  # PIL images; depth in millimetres
```"""
_WEBDATASET = """```python
import io
import numpy as np, webdataset as wds
from PIL import Image

for view in wds.WebDataset("{first}", shardshuffle=False).decode("pil"):
    depth = np.asarray(Image.open(io.BytesIO(view["{depth}"]))) / 1000  # metres
    view["rgb.png"], view["json"]["poses"]
```

Depth has a name that decoders leave alone: they would make eight bits of it."""


def write_views_card(
    out: Path, form: RowForm, num_views: Mapping[str, int], banks: Sequence[Bank]
) -> Path | None:
    """Writes the card, unless the user has a README of their own there; returns its path if written.

    Args:
      num_views: by split. banks: whose scenes are seen.

    Raises:
      BankError: an asset of a bank is damaged.
    """
    return write_unless_own(out, lambda: _text(out, form, num_views, banks))


def _text(out: Path, form: RowForm, num_views: Mapping[str, int], banks: Sequence[Bank]) -> str:
    assets: dict[str, ObjectAsset] = {}
    for bank in banks:
        assets |= {name: bank.object(name) for name in sorted(bank.assets["objects"])}
    supports = {bank.support.name: bank.support for bank in banks}
    licences = [each.provenance.licence for each in assets.values()]
    licences += [each.provenance.licence for each in supports.values()]
    splits = {split: number for split, number in num_views.items() if number}
    ending = ENDINGS[form]
    files = [{"split": split, "path": f"{split}-[0-9]*.{ending}"} for split in splits]
    head = front_matter(
        licences,
        _TAGS,
        "views of cluttered tabletop scenes",
        json.dumps(files),
        [f"task_categories: [{', '.join(_TASKS)}]", *_info(out, form, splits)],
    )
    told = ", ".join(f"{number} of {split}" for split, number in splits.items())
    first = next(iter(splits))
    example = _DATASETS if form == "parquet" else _WEBDATASET
    shard = min(each.name for each in out.glob(f"{first}-[0-9]*.{ending}"))
    for word, value in (("split", first), ("first", shard), ("depth", DEPTH_NAME)):
        example = example.replace(f"{{{word}}}", value)
    rows = [(f"`{name}`", f"`{_type(name)}`", about) for name, about in _COLUMNS.items()]
    sections = [
        head,
        f"# {out.resolve().name}\n\nWhat cameras see of simulated scenes in which objects lie still: {told} "
        f"views, of {', '.join(bank.path.resolve().name for bank in banks)}. `dataset.json` says how they "
        "were made.",
        example,
        "\n".join(["## Columns", "", markdown_table(("column", "type", "meaning"), rows)]),
        *(
            assets_section(list(assets.values()) if place == 0 else [], support)
            for place, support in enumerate(supports.values())
        ),
    ]
    return "\n\n".join(sections) + "\n"


def _type(name: str) -> str:
    """A column's type in words."""
    (found,) = (each for each in card_features(SCHEMA) if each["name"] == name)
    return _type_of(found)


def _type_of(feature: Any) -> str:
    """Of a feature as the card lists it."""
    if isinstance(feature, str):
        return feature
    if "dtype" in feature:
        return str(feature["dtype"])
    inner = _type_of(feature["sequence"])
    return f"{feature['length']} {inner}" if "length" in feature else f"list of {inner}"


def _info(out: Path, form: RowForm, splits: Mapping[str, int]) -> list[str]:
    """What the hub's library is told of features and splits; of tar files it finds out the first itself."""
    if form != "parquet":
        return []
    sizes = {
        split: sum(each.stat().st_size for each in out.glob(f"{split}-[0-9]*.{ENDINGS[form]}"))
        for split in splits
    }
    told: dict[str, Any] = {
        "features": card_features(SCHEMA),
        "splits": [
            {"name": split, "num_bytes": sizes[split], "num_examples": number}
            for split, number in splits.items()
        ],
        "download_size": sum(sizes.values()),
        "dataset_size": sum(sizes.values()),
    }
    # JSON is YAML, on one line.
    return [f"dataset_info: {json.dumps(told)}"]
