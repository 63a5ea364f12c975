"""Frames on disk: one colour and depth image with its camera, as any program can write them.

rgb.png        8-bit colours
depth.npy      f32[H, W], metres along the optical axis, nan where nothing was measured
camera.json    width, height, K (3 x 3) and T_world_camera (4 x 4), as `render --depth` writes them
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from cluttergen_jax.downstream.perception.segment.segmenter import checked_images
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.sensing.camera import Camera

_NAMES = ("rgb.png", "depth.npy", "camera.json")


class Frame(NamedTuple):
    """A picture u8[H, W, 3], depths f32[H, W] in metres, nan where none, and the camera."""

    rgb: np.ndarray
    depth: np.ndarray
    camera: Camera


def write_frame(folder: str | Path, frame: Frame) -> None:
    """Stores a frame in a folder.

    Raises:
      ConfigError: the images are not the camera's.
    """
    rgb, depth = checked_images(*frame)
    picture, array = io.BytesIO(), io.BytesIO()
    Image.fromarray(rgb).save(picture, format="PNG")
    np.save(array, depth, allow_pickle=False)
    camera = frame.camera
    record = {
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "T_world_camera": camera.T_world_camera.tolist(),
    }
    told = (json.dumps(record, indent=1) + "\n").encode()
    for name, data in zip(_NAMES, (picture.getvalue(), array.getvalue(), told), strict=True):
        write_atomically(Path(folder) / name, data)


def read_frame(folder: str | Path) -> Frame:
    """A frame from a folder.

    Raises:
      BankError: a file is missing or damaged. ConfigError: the images are not the camera's.
    """
    paths = [Path(folder) / name for name in _NAMES]
    try:
        with Image.open(paths[0]) as image:
            rgb = np.asarray(image.convert("RGB"))
        depth = np.load(paths[1], allow_pickle=False)
        told = json.loads(paths[2].read_bytes())
        size = int(told["width"]), int(told["height"])
        camera = Camera(*size, np.array(told["K"], float), np.array(told["T_world_camera"], float))
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise BankError(
            f"{folder} holds no frame that can be read ({type(error).__name__}: {error})",
            ", ".join(_NAMES),
            "files as `downstream.perception.frames` describes them",
        ) from error
    return Frame(*checked_images(rgb, depth, camera), camera)
