"""Frames on disk: one colour and depth image with its camera, as any program can write them.

rgb.png        8-bit colours
depth.npy      f32[H, W], metres along the optical axis, nan where nothing was measured
camera.json    width, height, K (3 x 3) and T_world_camera (4 x 4), as `render --depth` writes them
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from PIL import Image

from cluttergen_jax.downstream.perception.types import check_images
from cluttergen_jax.errors import BankError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import checked_record, convert, digest_of, refuse, with_checksum
from cluttergen_jax.sensing import Camera

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
    rgb, depth = check_images(*frame)
    picture = io.BytesIO()
    Image.fromarray(rgb).save(picture, format="PNG")
    array = io.BytesIO()
    np.save(array, depth, allow_pickle=False)
    files = {"rgb.png": digest_of(picture.getvalue()), "depth.npy": digest_of(array.getvalue())}
    told = (
        json.dumps(with_checksum({**frame.camera.record(), "checksums": files}), indent=1) + "\n"
    ).encode()
    for name, data in zip(_NAMES, (picture.getvalue(), array.getvalue(), told), strict=True):
        write_atomically(Path(folder) / name, data)


_Side = Annotated[int, msgspec.Meta(ge=1, le=16_384)]
_Row3 = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]


class _Camera(msgspec.Struct):
    """What `camera.json` holds."""

    width: _Side
    height: _Side
    K: tuple[_Row3, _Row3, _Row3]
    T_world_camera: tuple[_Row4, _Row4, _Row4, _Row4]


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
        told = checked_record(paths[2].read_bytes())
        files = convert(told.get("checksums", {}), dict[Literal["rgb.png", "depth.npy"], str])
        changed = [
            name
            for name, digest in files.items()
            if digest_of((Path(folder) / name).read_bytes()) != digest
        ]
        refuse([f"{name} is not what it was" for name in changed])
        found = convert(told, _Camera)
        camera = Camera(
            found.width, found.height, np.array(found.K), np.array(found.T_world_camera)
        )
    except Exception as error:  # Damaged headers make NumPy and Pillow raise whatever they like.
        raise BankError(
            f"{folder} holds no frame that can be read ({type(error).__name__}: {error})",
            ", ".join(_NAMES),
            "files as `downstream.perception.frames` describes them",
        ) from error
    return Frame(*check_images(rgb, depth, camera), camera)
