"""Images of views as files encode them: depth in whole steps, labels, masks, and all of a view at once."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence

import numpy as np
from PIL import Image

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.picture import distinct_colour
from cluttergen_jax.sensing import FIRST_OBJECT, FLOOR, SUPPORT, Camera, View

MILLIMETRE = 0.001
TENTH_OF_A_MILLIMETRE = 0.0001


def depth_levels(depth: np.ndarray, step: float) -> np.ndarray:
    """u16[H, W]: depths f[H, W] in metres as numbers of steps, rounded; 0 where nothing is or too far.

    Args:
      step: metres.
    """
    levels = np.where(np.isfinite(depth), np.round(depth / step), 0.0)
    return np.where(levels <= np.iinfo(np.uint16).max, levels, 0).astype(np.uint16)


def depth_png(depth: np.ndarray, step: float = MILLIMETRE) -> bytes:
    """A 16-bit grey PNG of `depth_levels`."""
    return png_of(depth_levels(depth, step))


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
    return _png(image)


def palette() -> np.ndarray:
    """uint8[256, 3]: black for the floor, grey for the support, distinct colours for objects."""
    colours = np.array(
        [(0.0, 0.0, 0.0), (0.55, 0.55, 0.55), *(distinct_colour(k)[:3] for k in range(254))]
    )
    return np.round(255 * colours).astype(np.uint8)


def label_image(label: np.ndarray, most: int) -> np.ndarray:
    """u8[H, W], or u16[H, W] where labels up to `most` need it."""
    return label.astype(np.uint8 if most < 256 else np.uint16)


def npz_of(view: View, names: Sequence[str], poses: np.ndarray) -> bytes:
    """All arrays of a view under their names, as compressed NumPy, readable without pickle.

    `rgb` is not there if no colours were drawn.

    Args:
      names: of the N objects. poses: f64[N, 7], T_world_object.
    """
    buffer = io.BytesIO()
    arrays = {
        "rgb": view.rgb,
        "depth": view.depth,
        "segmentation": label_image(view.label, FIRST_OBJECT + len(names)),
        "intrinsics": view.camera.K,
        "T_world_camera": view.camera.T_world_camera,
        "names": np.array(names),
        "poses": poses,
    }
    there = {name: each for name, each in arrays.items() if each is not None}
    np.savez_compressed(buffer, **there)  # type: ignore[arg-type]
    return buffer.getvalue()


def camera_json(camera: Camera, names: Sequence[str], poses: np.ndarray) -> bytes:
    """What the pixels of one view's PNG files mean: the camera, and the object of each label.

    Args:
      names: of the N objects. poses: f64[N, 7], T_world_object.
    """
    record = {
        **camera.record(),
        "depth_scale": MILLIMETRE,
        "labels": {"floor or nothing": FLOOR, "support": SUPPORT},
        "objects": [
            {"label": FIRST_OBJECT + index, "name": name, "pose": pose.tolist()}
            for index, (name, pose) in enumerate(zip(names, poses, strict=True))
        ],
        "units": "metres, pixels; depth times depth_scale: metres along the optical axis, 0: nothing",
        "frames": "camera: x right, y down, z forward; the middle of the pixel in row i, column j is "
        "(j + 0.5, i + 0.5); poses: T_world_object, position, then quaternion wxyz",
    }
    return json.dumps(record, indent=1).encode() + b"\n"


def png_of(image: np.ndarray) -> bytes:
    """An image as a PNG file: u8[H, W, 3] colours, u8[H, W] or u16[H, W] numbers, or bool[H, W]."""
    return _png(Image.fromarray(image))


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()
