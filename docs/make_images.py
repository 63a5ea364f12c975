"""Makes the pictures of the README and the gallery: python docs/make_images.py (minutes on two cores)."""

from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support, list_supports
from cluttergen_jax.files import file_whole
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.rendering.assets import close_points, object_sheet, render_scene, scene_spec
from cluttergen_jax.rendering.film import save_film
from cluttergen_jax.rendering.gl import gl_context
from cluttergen_jax.rendering.picture import render_model
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
CAPTIONS = [
    ", ".join(filter(None, (f"{pool}: {number} objects on {support}", clutter)))
    for pool, support, number, clutter in SCENES
]
FILM_CAPTIONS = [f"{pool}: {number} objects" for pool, _, number, _ in SCENES]
# Of the film: pixels of a scene, steps in which it is filled, frames a second, frames of rest at the end.
FILM_SIZE = (264, 198)
FILM_STEPS = 10
FILM_FPS = 5
FILM_END = 12


def first_success(pool: str, support: str, num_objects: int, clutter: str | None) -> cg.Scene:
    """The first success of seed 0 by the default method."""
    sample = cg.make_sampler(pool=pool, support=support, num_objects=num_objects, clutter=clutter)
    keys = jax.random.split(jax.random.key(0), 8)
    scenes = jax.device_get(jax.jit(jax.vmap(sample))(keys))
    return sample.scene(scenes, int(np.flatnonzero(scenes.is_success)[0]))


def draw(scene: cg.Scene) -> np.ndarray:
    """A finished scene as a photo."""
    return np.asarray(scene.picture(quality="photo", size=(720, 540)))


def draw_support(name: str) -> np.ndarray:
    """A support alone."""
    return render_scene([], np.zeros((0, 7)), find_support(name), width=480, height=360, samples=16)


def from_below(scene: cg.Scene) -> np.ndarray:
    """i32[K]: the objects in order of their slots, but none before what it lies on."""
    lowest = [
        min(transform_points(pose, part.vertices)[:, 2].min() for part in asset.parts)
        for asset, pose in zip(scene.objects, scene.poses, strict=True)
    ]
    return np.argsort(np.round(lowest, 2), kind="stable")


def filling(scene: cg.Scene) -> Iterator[np.ndarray]:
    """Frames of a finished scene that appears object by object, each first seen above its place."""
    width, height = FILM_SIZE
    spec, qpos = scene_spec(scene.objects, scene.poses, scene.support)
    focus = close_points(scene.objects, scene.poses, scene.support)
    model = spec.compile()
    order = from_below(scene)
    names = [f"{index:02d}-{asset.name}" for index, asset in enumerate(scene.objects)]
    for shown in np.array_split(order, FILM_STEPS):
        last = int(np.flatnonzero(order == shown[-1])[0]) + 1
        lifted = qpos.reshape(-1, 7).copy()
        lifted[shown, 2] += 0.06
        for poses in (lifted.ravel(), qpos):
            show = ["support", *(names[index] for index in order[:last])]
            yield render_model(
                model, poses, width=width, height=height, show=show, focus=focus, samples=24
            )


def main() -> None:
    """Draws every picture."""
    scenes = [first_success(*scene) for scene in SCENES]
    with gl_context(*FILM_SIZE):
        steps = zip(*map(filling, scenes), strict=True)
        frames = [contact_sheet(images, FILM_CAPTIONS, columns=3) for images in steps]
    save_film([*frames, *frames[-1:] * FILM_END], HERE / "filling.gif", FILM_FPS)
    sheet = contact_sheet([draw(scene) for scene in scenes], CAPTIONS, columns=3)
    with file_whole(HERE / "scenes.jpg") as fresh:
        Image.fromarray(sheet).save(fresh, "JPEG", quality=85)
    for pool in POOLS:
        save_png(object_sheet(find_pool(pool).objects, columns=5), HERE / f"{pool}.png")
    supports = sorted(list_supports())
    drawn = [draw_support(name) for name in supports]
    save_png(contact_sheet(drawn, supports, columns=7), HERE / "supports.png")


if __name__ == "__main__":
    main()
