"""Makes the picture of docs/guide/perception.md: python -m docs.make_perception (two minutes)."""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation

from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.perception.finder import SceneFinder, load_finder
from cluttergen_jax.downstream.perception.types import FIRST_OBJECT
from cluttergen_jax.rendering.sheet import contact_sheet
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.views.images import palette
from studies.perception.api import perception_data
from studies.perception.view_store import StoredView, simulate_camera

HERE = Path(__file__).parent / "images"
POOL = "household"
NUM_VIEWS = 16
SHOWN = (2, 8, 11, 14)
"""Views that were chosen by eye, for unlike cameras."""
NEAR = 0.5
FAR = 1.3


def silhouette(finder: SceneFinder, number: int, pose: np.ndarray, camera: Camera) -> np.ndarray:
    """bool[H, W]: where an object alone would be seen at a pose f64[7], T_world_object."""
    sensor = finder.estimator.model(number).sensor
    data = sensor.make_data()
    sensor.pose(data, pose[None])
    return np.isfinite(sensor.sense(data, camera).depth)


def row_of(finder: SceneFinder, stored: StoredView) -> list[np.ndarray]:
    """What a noisy camera sees (colours, depths), what the network says of it, and the poses that follow."""
    seen = simulate_camera(stored, REALSENSE, 0)
    look = finder.look(seen.rgb, seen.depth, seen.camera)
    found = finder([look])
    grey = np.clip((seen.depth - NEAR) / (FAR - NEAR), 0, 1)
    depth = np.where(np.isfinite(seen.depth), 255 * (1 - grey), 0)[..., None].repeat(3, -1)
    masks = np.where(
        (look.label >= FIRST_OBJECT)[..., None], palette()[look.label], 0.35 * seen.rgb
    )
    poses = 0.6 * seen.rgb
    for number in np.flatnonzero(found.seen):
        inside = silhouette(finder, number, found.pose[number], seen.camera)
        colour = palette()[FIRST_OBJECT + number]
        poses[binary_dilation(inside, iterations=2) & ~inside] = colour
    images = (seen.rgb, depth, masks, poses)
    return [image.astype(np.uint8) for image in images]


def main() -> None:
    """Views of scenes that training has not seen."""
    with tempfile.TemporaryDirectory() as folder:
        views = perception_data(folder, pool=POOL, num_views=NUM_VIEWS, split="test")
        finder = load_finder(POOL, views.objects, views.support)
        rows = [row_of(finder, stored) for stored in views.views("test") if stored.number in SHOWN]
    words = ("colours", "depths, nearer is brighter", "what the network sees", "poses found")
    sheet = contact_sheet([image for row in rows for image in row], words * len(rows), columns=4)
    few = Image.fromarray(sheet).quantize(256, dither=Image.Dither.NONE)
    few.save(HERE / "perception.png", optimize=True)


if __name__ == "__main__":
    main()
