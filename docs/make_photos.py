"""Makes the README's first picture and those of a guide: python -m docs.make_photos [FOLDER] (15 minutes).

Banks are made in FOLDER (out/photos), unless they are there; the textured set is imported as the pool
`printed`, unless there is one. Needs the extra `photo`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import list_pools
from cluttergen_jax.files import file_whole
from cluttergen_jax.rendering import contact_sheet
from cluttergen_jax.rendering.look import embedded_looks
from docs.make_textured import write

HERE = Path(__file__).parent / "images"
QUALITY = 88
LARGE = (960, 720)
CELL = (480, 360)
MIXED = {"pool": "all", "num_objects": 14, "natural": True, "crowd": 0.4}
"""The scene of most pictures."""
PAIRS: dict[str, tuple[str, dict[str, Any]]] = {
    "dining: glass": ("studio", {"pool": "dining", "natural": True}),
    "kitchen: steel": ("marble_bar", {"pool": "kitchen", "num_objects": 8, "crowd": 0.5}),
    "office, in a bin": ("workshop", {"pool": "office", "support": "bin", "method": "pile"}),
    "study, in a bookcase": (
        "study_night",
        {"pool": "study", "support": "bookcase", "surface": "all"},
    ),
    "an imported set with textures": (
        "kitchen_day",
        {"pool": "printed", "num_objects": 12, "natural": True},
    ),
    "three pools": ("linen", MIXED),
}
"""Caption, look and scene of each pair of `pairs.jpg`."""
WALL: tuple[tuple[str, dict[str, Any]], ...] = (
    ("kitchen_day", {"pool": "dining", "natural": True, "crowd": 0.5}),
    ("office", {"pool": "office", "natural": True, "crowd": 0.5}),
    ("marble_bar", {"pool": "kitchen", "natural": True, "crowd": 0.5}),
    ("study_night", {"pool": "study", "natural": True, "crowd": 0.5}),
    ("linen", {"pool": "household", "crowd": 0.75}),
    ("terrazzo", {"pool": "all", "num_objects": 24, "crowd": 0.5}),
)
"""Look and scene of each picture of the README's first one."""


def bank_of(folder: Path, **options: Any) -> Path:
    """A bank with one good scene of these options in `folder`, made if it is not there."""
    if not (folder / "bank.json").is_file():
        cg.generate(out=folder, num_scenes=2, render=False, seed=5, **options)
    return folder


def draw(bank: Path, folder: Path, **options: Any) -> np.ndarray:
    """The first scene of a bank that stands, drawn with `cluttergen_jax.render`'s options."""
    report = cg.render(bank, folder, **options)
    (path,) = report.paths
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def save(image: np.ndarray, name: str) -> None:
    """Writes a picture of the documentation."""
    with file_whole(HERE / name) as fresh:
        Image.fromarray(image).save(fresh, "JPEG", quality=QUALITY)
    print(HERE / name)


def main(out: Path) -> None:
    """Makes all of them."""
    if "printed" not in list_pools():
        write(out / "meshes")
        cg.import_pool(out / "meshes", "printed")
    mixed = bank_of(out / "mixed", **MIXED)
    wall = [
        draw(
            bank_of(out / f"wall-{number}", **options),
            out / "wall",
            quality="photo",
            look=look,
            size=CELL,
        )
        for number, (look, options) in enumerate(WALL)
    ]
    rows = [np.concatenate(wall[k : k + 3], axis=1) for k in (0, 3)]
    save(np.concatenate(rows), "wall.jpg")
    both = [
        draw(mixed, out / quality, quality=quality, look="kitchen_day", size=LARGE)
        for quality in ("fine", "photo")
    ]
    save(np.concatenate(both, axis=1), "photo.jpg")
    looks = [
        draw(mixed, out / "looks" / name, quality="photo", look=name, size=CELL)
        for name in embedded_looks()
    ]
    save(contact_sheet(looks, list(embedded_looks()), 4), "looks.jpg")
    images = []
    captions = []
    for number, (caption, (look, options)) in enumerate(PAIRS.items()):
        bank = bank_of(out / f"pair-{number}", **options)
        for quality in ("fine", "photo"):
            images.append(draw(bank, out / quality, quality=quality, look=look, size=CELL))
            captions.append(f"{caption} ({quality})")
    save(contact_sheet(images, captions, 4), "pairs.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/photos"))
