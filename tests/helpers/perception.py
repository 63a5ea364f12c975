"""Views made by rays for tests of perception: coloured boxes on the paper's table, no display needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.downstream.perception.types import BACKGROUND, FIRST_OBJECT, Segmentation
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, above
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.sensing import View, rays
from cluttergen_jax.sensing.camera import Camera, free
from studies.perception.view_store import StoredView
from tests.helpers.placing import with_surface
from tests.helpers.worlds import box

TABLE = cuboid_table()
OBJECTS = tuple(
    with_surface(box(name, half))
    for name, half in (
        ("red", (0.03, 0.05, 0.04)),
        ("green", (0.02, 0.04, 0.07)),
        ("blue", (0.05, 0.03, 0.02)),
    )
)
COLOURS = np.array(
    [[150, 120, 90], [128, 128, 128], [220, 40, 40], [40, 200, 60], [50, 60, 220]], np.uint8
)


def standing(*places: tuple[float, float, float]) -> np.ndarray:
    """f64[n, 7]: the first objects at x, y and yaw."""
    return np.array(
        [
            [x, y, TABLE.top + asset.half_extents[2], *yaw_quaternion(yaw)]
            for asset, (x, y, yaw) in zip(OBJECTS, places, strict=False)
        ]
    )


POSES = standing((-0.1, 0.05, 0.4), (0.08, -0.1, 1.2), (0.05, 0.15, 2.5))


def overhead() -> Camera:
    return above(TABLE)


def view_of(
    poses: np.ndarray, camera: Camera, number: int = 0, objects: Sequence[ObjectAsset] = OBJECTS
) -> StoredView:
    """What a camera sees of the first objects at f[n, 7], exactly."""
    count = len(poses)
    sensor = rays.RaySensor(rays.sensed_model(objects[:count], TABLE))
    data = sensor.make_data()
    sensor.pose(data, poses)
    image = sensor.sense(data, camera)
    label = np.where(
        image.label >= rays.FIRST_OBJECT, image.label - rays.FIRST_OBJECT + FIRST_OBJECT, BACKGROUND
    ).astype(np.uint8)
    return StoredView(
        number,
        View(image.depth, label, camera, COLOURS[label]),
        np.arange(count),
        poses,
        "made up",
        False,
    )


def drawn_view(number: int) -> StoredView:
    """Three boxes somewhere, seen from somewhere; the same for the same number."""
    rng = np.random.default_rng(number)
    xy = np.array([[-0.12, -0.1], [0.12, -0.05], [0.0, 0.15]]) + rng.uniform(-0.05, 0.05, (3, 2))
    poses = standing(*((x, y, rng.uniform(0, 6)) for x, y in xy))
    return view_of(poses, free(TABLE, rng, *SIZE, FOCAL), number)


class ByColour:
    """A segmenter that knows the boxes by the colours that `view_of` gives them."""

    names = tuple(asset.name for asset in OBJECTS)

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray, camera: Camera, among: Sequence[str] | None = None
    ) -> Segmentation:
        distance = np.abs(rgb[:, :, None].astype(int) - COLOURS).sum(-1)
        return Segmentation(self.names, distance.argmin(-1).astype(np.uint8))
