"""Makes the pictures of the README and the gallery: python docs/make_images.py (minutes on two cores)."""

from pathlib import Path

import jax
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support, list_supports
from cluttergen_jax.rendering.assets import object_sheet, render_scene
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

HERE = Path(__file__).parent / "images"
POOLS = ("dining", "study", "office", "kitchen", "household")
SCENES = (
    ("dining", "table", 10, None),
    ("study", "drawer_desk", 10, None),
    ("kitchen", "trestle_table", 10, "stack=3"),
    ("office", "l_desk", 10, None),
    ("household", "round_table", 10, "stack=2"),
    ("all", "table-0.60x0.70", 30, None),
)


def draw(pool: str, support: str, num_objects: int, clutter: str | None) -> np.ndarray:
    """The first success of seed 0 by the default method, drawn close."""
    sample = cg.make_sampler(pool, support, num_objects, clutter=clutter)
    keys = jax.random.split(jax.random.key(0), 8)
    scenes = jax.device_get(jax.jit(jax.vmap(sample))(keys))
    place = int(np.flatnonzero(scenes.is_success)[0])
    scene = sample.scene(scenes, place)
    return render_scene(
        scene.objects, scene.poses, scene.support, close=True, width=720, height=540, samples=64
    )


def draw_support(name: str) -> np.ndarray:
    """A support alone."""
    return render_scene([], np.zeros((0, 7)), find_support(name), width=480, height=360, samples=16)


def main() -> None:
    """Draws every picture."""
    captions = [
        ", ".join(filter(None, (f"{pool}: {n} objects on {support}", clutter)))
        for pool, support, n, clutter in SCENES
    ]
    save_png(contact_sheet([draw(*scene) for scene in SCENES], captions, columns=3), HERE / "scenes.png")
    for pool in POOLS:
        save_png(object_sheet(find_pool(pool).objects, columns=5), HERE / f"{pool}.png")
    supports = sorted(list_supports())
    drawn = [draw_support(name) for name in supports]
    save_png(contact_sheet(drawn, supports, columns=4), HERE / "supports.png")


if __name__ == "__main__":
    main()
