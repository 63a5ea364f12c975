"""Makes the picture of docs/guide/cameras.md: python docs/make_cameras.py (a minute on two cores)."""

from pathlib import Path

import jax
import matplotlib
import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.rendering.sheet import contact_sheet, save_png
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.partial import Grid, PartialMap, level_camera
from cluttergen_jax.sensing.rays import RaySensor, sensed_model
from cluttergen_jax.views.images import palette

HERE = Path(__file__).parent / "images"
WIDTH = 640
HEIGHT = 480
NEAR = 0.5
FAR = 1.6


def coloured(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """uint8[..., 3]: a colour map; black where there is no number."""
    colours = matplotlib.colormaps["viridis"]((values - low) / (high - low))[..., :3]
    return np.where(np.isfinite(values)[..., None], 255 * colours, 0).astype(np.uint8)


def from_above(values: np.ndarray) -> np.ndarray:
    """uint8[HEIGHT, WIDTH, 3]: a height map, y up, on white; colours from 0 to 25 cm."""
    colours = coloured(values[1:-1, 1:-1].T[::-1], 0.0, 0.25)
    scale = HEIGHT // len(colours)
    large = colours.repeat(scale, 0).repeat(scale, 1)
    sheet = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    top = (HEIGHT - large.shape[0]) // 2
    left = (WIDTH - large.shape[1]) // 2
    sheet[top : top + large.shape[0], left : left + large.shape[1]] = large
    return sheet


def main() -> None:
    """One household scene: colours, labels, depth without and with noise, what is known of the heights."""
    sample = cg.make_sampler(pool="household", support="table", num_objects=10)
    scenes = jax.device_get(jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), 8)))
    scene = sample.scene(scenes, int(np.flatnonzero(scenes.is_success)[0]))
    middle = np.array([0.0, 0.0, scene.support.top])
    camera = Camera.looking(middle + np.array([-0.35, -0.85, 0.6]), middle, WIDTH, HEIGHT, 615.0)
    sensor = RaySensor(sensed_model(scene.objects, scene.support))
    data = sensor.make_data()
    sensor.pose(data, scene.poses)
    image = sensor.sense(data, camera)
    depth, stated = noisy(image.depth, camera, REALSENSE, np.random.default_rng(0))
    grid = Grid.of(scene.support, 0.15)
    seen = PartialMap.of(depth, level_camera(depth, stated, grid), grid, median=3)
    picture = PictureConfig(width=WIDTH, height=HEIGHT)
    points = close_points(scene.objects, scene.poses, scene.support)
    with open_scene_renderer(scene.objects, scene.support, points, picture) as renderer:
        renderer.camera = camera
        colours = renderer.picture([RenderStyle(pose) for pose in scene.poses])
    views = {
        "colours": colours,
        "labels": palette()[image.label],
        "depth": coloured(np.where(np.isinf(image.depth), np.nan, image.depth), NEAR, FAR),
        "depth with noise": coloured(np.where(np.isinf(depth), np.nan, depth), NEAR, FAR),
        "partial map: height (camera below)": from_above(seen.height),
        "partial map: ceiling": from_above(seen.ceiling),
    }
    sheet = Image.fromarray(contact_sheet(list(views.values()), list(views), columns=3))
    sheet.thumbnail((1200, 1200), Image.Resampling.LANCZOS)
    save_png(np.asarray(sheet), HERE / "cameras.png")


if __name__ == "__main__":
    main()
