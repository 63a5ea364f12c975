"""What a camera would measure of a scene: depth and which object each pixel shows, in files that say so."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.picture import distinct_colour
from cluttergen_jax.rendering.scene_renderer import (
    PictureConfig,
    RenderStyle,
    scene_camera,
    scene_renderer,
)
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FIRST_OBJECT, FLOOR, SUPPORT, RaySensor, sensed_model


@dataclass(frozen=True, eq=False)
class Sensed:
    """One view of a scene. H rows, W columns, N objects; `names` are theirs.

    Attributes:
      rgb: uint8[H, W, 3]; None where nothing was drawn.
      depth: f32[H, W], metres along the optical axis (not along the ray); inf where nothing is within 20 m.
      segmentation: u8[H, W] or u16[H, W], labels as in `sensing.rays`: 0 floor or nothing, 1 support, then
        object k of the scene as 2 + k.
      camera: where it was seen from.
      poses: f64[N, 7], T_world_object, metres, wxyz.
    """

    rgb: np.ndarray | None
    depth: np.ndarray
    segmentation: np.ndarray
    camera: Camera
    names: tuple[str, ...]
    poses: np.ndarray


def sense(
    objects: Sequence[ObjectAsset],
    names: Sequence[str],
    poses: np.ndarray,
    support: SupportAsset,
    picture: PictureConfig | None = None,
    is_drawn: bool = True,
    camera: Camera | None = None,
) -> Sensed:
    """Depth and segmentation of a scene from one place, by rays, and its colours.

    Args:
      is_drawn: draw the colours, which needs OpenGL; all else needs none.
      camera: that sees it; the picture's view if None.

    Raises:
      RendererError: colours are wanted, and nothing here can draw.
    """
    picture = picture or PictureConfig()
    poses = np.asarray(poses, np.float64).reshape(-1, 7)
    points = close_points(objects, poses, support)
    camera = camera or scene_camera(objects, support, points, picture)
    rgb = None
    if is_drawn:
        with scene_renderer(objects, support, points, picture) as renderer:
            renderer.camera = camera
            rgb = renderer.picture([RenderStyle(pose) for pose in poses])
    sensor = RaySensor(sensed_model(objects, support), surfaces=not picture.hulls)
    data = sensor.make_data()
    sensor.pose(data, poses)
    image = sensor.sense(data, camera)
    labels = image.label.astype(np.uint8 if len(objects) < 254 else np.uint16)
    return Sensed(rgb, image.depth, labels, camera, tuple(names), poses)


def depth_png(depth: np.ndarray, step: float = 0.001) -> bytes:
    """A 16-bit grey PNG in millimetres, rounded; 0 where nothing is or beyond 65.535 m.

    Args:
      step: metres that each grey level stands for, if not a millimetre.
    """
    levels = np.where(np.isfinite(depth), np.round(depth / step), 0.0)
    return png_of(Image.fromarray(np.where(levels <= 65535, levels, 0).astype(np.uint16)))


def segmentation_png(labels: np.ndarray) -> bytes:
    """A PNG whose pixel values are the labels and whose palette gives each its own colour.

    Raises:
      ConfigError: labels above 255, which a palette cannot hold.
    """
    if labels.max(initial=0) > 255:
        raise ConfigError(
            f"a segmentation PNG of {labels.max() + 1} labels", "256 at most", "the NPZ file"
        )
    image = Image.fromarray(labels.astype(np.uint8), mode="P")
    image.putpalette(palette().ravel().tolist())
    return png_of(image)


def palette() -> np.ndarray:
    """uint8[256, 3]: black for the floor, grey for the support, distinct colours for objects."""
    colours = np.array(
        [(0.0, 0.0, 0.0), (0.55, 0.55, 0.55), *(distinct_colour(k)[:3] for k in range(254))]
    )
    return np.round(255 * colours).astype(np.uint8)


def npz_of(sensed: Sensed) -> bytes:
    """All arrays of one view under their names, as compressed NumPy, readable without pickle.

    `rgb` is not there if no colours were drawn.
    """
    buffer = io.BytesIO()
    arrays = {
        "rgb": sensed.rgb,
        "depth": sensed.depth,
        "segmentation": sensed.segmentation,
        "intrinsics": sensed.camera.K,
        "T_world_camera": sensed.camera.T_world_camera,
        "names": np.array(sensed.names),
        "poses": sensed.poses,
    }
    there = {name: each for name, each in arrays.items() if each is not None}
    np.savez_compressed(buffer, **there)  # type: ignore[arg-type]
    return buffer.getvalue()


def camera_json(sensed: Sensed) -> bytes:
    """What the pixels of one view's PNG files mean: the camera, and the object of each label."""
    record = {
        "width": sensed.camera.width,
        "height": sensed.camera.height,
        "K": sensed.camera.K.tolist(),
        "T_world_camera": sensed.camera.T_world_camera.tolist(),
        "depth_scale": 0.001,
        "labels": {"floor or nothing": FLOOR, "support": SUPPORT},
        "objects": [
            {"label": FIRST_OBJECT + index, "name": name, "pose": pose.tolist()}
            for index, (name, pose) in enumerate(zip(sensed.names, sensed.poses, strict=True))
        ],
        "units": "metres, pixels; depth times depth_scale: metres along the optical axis, 0: nothing",
        "frames": "camera: x right, y down, z forward; the middle of the pixel in row i, column j is "
        "(j + 0.5, i + 0.5); poses: T_world_object, position, then quaternion wxyz",
    }
    return json.dumps(record, indent=1).encode() + b"\n"


def png_of(image: Image.Image) -> bytes:
    """An image as a PNG file."""
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()
