"""Makes two pictures of docs/guide/clutter.md: python docs/make_crowds.py (some ten minutes on two cores).

Crowds from apart to heap in five pools, and the same pools with `natural` beside without.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image, ImageDraw, ImageFont

import cluttergen_jax as cg
from cluttergen_jax.files import file_whole
from cluttergen_jax.rendering import CameraView

HERE = Path(__file__).parent / "images"
POOLS = ("dining", "kitchen", "household", "office", "study")
CROWDS = (0.0, 0.25, 0.5, 0.75, 1.0)
SUPPORT = "table-0.60x0.70"
NUM_OBJECTS = 10
# Scenes tried for each picture; pixels of a picture, of the titles' edges and between pictures.
TRIED = 4
VIEW = CameraView(azimuth=112.0, elevation=-38.0)
CELL = (300, 225)
EDGE = (30, 26)
GAP = 6
QUALITY = 85
INK = (40, 44, 52)


def find_successes(pool: str, number: int, **options: Any) -> list[cg.Scene]:
    """The first scenes of seed 0 that stand."""
    sample = cg.make_sampler(pool=pool, support=SUPPORT, num_objects=NUM_OBJECTS, **options)
    keys = jax.random.split(jax.random.key(0), TRIED)
    scenes = jax.device_get(jax.jit(jax.vmap(sample))(keys))
    indices = np.flatnonzero(scenes.is_success)[:number]
    return [sample.scene(scenes, int(index)) for index in indices]


def draw(scene: cg.Scene) -> np.ndarray:
    """A finished scene, drawn close, from the seat's side."""
    return np.asarray(scene.picture(view=VIEW, size=CELL))


def titled_sheet(
    rows: Sequence[Sequence[cg.Scene]], row_titles: Sequence[str], column_titles: Sequence[str]
) -> Image.Image:
    """Pictures of scenes with a title over each column and, turned, beside each row."""
    step_x = CELL[0] + GAP
    step_y = CELL[1] + GAP
    size = EDGE[0] + len(column_titles) * step_x, EDGE[1] + len(rows) * step_y
    sheet = Image.new("RGB", size, (255, 255, 255))
    font = ImageFont.load_default(size=16)
    for column, title in enumerate(column_titles):
        middle = EDGE[0] + column * step_x + CELL[0] // 2, EDGE[1] // 2
        ImageDraw.Draw(sheet).text(middle, title, fill=INK, font=font, anchor="mm")
    for row, (scenes, title) in enumerate(zip(rows, row_titles, strict=True)):
        strip = Image.new("RGB", (CELL[1], EDGE[0]), (255, 255, 255))
        middle = CELL[1] // 2, EDGE[0] // 2
        ImageDraw.Draw(strip).text(middle, title, fill=INK, font=font, anchor="mm")
        sheet.paste(strip.rotate(90, expand=True), (0, EDGE[1] + row * step_y))
        for column, scene in enumerate(scenes):
            place = EDGE[0] + column * step_x, EDGE[1] + row * step_y
            sheet.paste(Image.fromarray(draw(scene)), place)
    return sheet


def save_jpeg(sheet: Image.Image, path: Path) -> None:
    """Writes the file whole or not at all."""
    with file_whole(path) as fresh:
        sheet.save(fresh, format="JPEG", quality=QUALITY)


def main() -> None:
    """Draws both."""
    crowds = [
        [scene for crowd in CROWDS for scene in find_successes(pool, 1, crowd=crowd)]
        for pool in POOLS
    ]
    columns = [f"crowd {crowd:g}" for crowd in CROWDS]
    save_jpeg(titled_sheet(crowds, POOLS, columns), HERE / "crowds.jpg")
    natural = [
        [
            scene
            for is_natural in (False, True)
            for scene in find_successes(pool, 2, natural=is_natural)
        ]
        for pool in POOLS
    ]
    columns = ["as usual", "as usual", "natural", "natural"]
    save_jpeg(titled_sheet(natural, POOLS, columns), HERE / "natural.jpg")


if __name__ == "__main__":
    main()
