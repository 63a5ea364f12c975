"""Films on disk, whole or not at all: GIF always, MP4 with the extra `video` or the system's ffmpeg."""

from __future__ import annotations

import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image

from cluttergen_jax.config import FilmFormat
from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.files import file_whole

FILM_FORMATS = get_args(FilmFormat)


def check_format(name: str) -> None:
    """Refuses a film format before any picture is drawn.

    Raises:
      ConfigError: there is no such format.
      MissingExtraError: "mp4" without an encoder.
    """
    if name not in FILM_FORMATS:
        raise ConfigError(f"film format {name!r}", ", ".join(FILM_FORMATS), "gif")
    if name == "mp4":
        find_ffmpeg()


def find_ffmpeg() -> str:
    """The encoder that the extra `video` brings, or the system's own.

    Raises:
      MissingExtraError: there is neither.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        found = shutil.which("ffmpeg")
        if found is None:
            raise MissingExtraError("video", "writing MP4 (GIF needs no extra)") from error
        return found
    return imageio_ffmpeg.get_ffmpeg_exe()


def save_film(frames: Iterable[np.ndarray], path: Path, fps: float) -> Path:
    """Writes uint8[H, W, 3] frames to a .gif or .mp4 file.

    Raises:
      ConfigError: another ending, no frames, or a rate that the format cannot hold.
      MissingExtraError: .mp4 without an encoder.
    """
    name = path.suffix.removeprefix(".")
    check_format(name)
    write: Callable[[Iterable[np.ndarray], Path, float], None] = (
        _write_gif if name == "gif" else _write_mp4
    )
    with file_whole(path) as fresh:
        write(frames, fresh, fps)
    return path


def _write_gif(frames: Iterable[np.ndarray], path: Path, fps: float) -> None:
    if fps > 50:
        raise ConfigError(
            f"a GIF of {fps:g} frames per second", "50 at most", "fps=20, or film='mp4'"
        )
    images = [Image.fromarray(frame) for frame in frames]
    if not images:
        raise ConfigError("a film without frames", "at least one")
    palette = _common_palette(images)
    # Without dithering nothing crawls from frame to frame, and what stands still costs no bytes.
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    # A frame lasts whole hundredths of a second: those of the whole film are kept on average.
    ends = np.round(100 * np.arange(len(small) + 1) / fps).astype(int)
    lasting = (10 * np.diff(ends)).tolist()
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=lasting, loop=0, optimize=False
    )


def _common_palette(images: list[Image.Image]) -> Image.Image:
    """One palette of 256 colours for the whole film, from a dozen of its frames."""
    chosen = images[:: max(1, len(images) // 12)]
    width, height = chosen[0].size
    wall = Image.new("RGB", (width, height * len(chosen)))
    for number, image in enumerate(chosen):
        wall.paste(image, (0, number * height))
    return wall.quantize(256, method=Image.Quantize.MEDIANCUT)


def _write_mp4(frames: Iterable[np.ndarray], path: Path, fps: float) -> None:
    """Feeds raw pictures to ffmpeg: H.264 that every player and every paper's supplement can show."""
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        raise ConfigError("a film without frames", "at least one")
    # H.264 stores colours for blocks of two by two pixels.
    height = first.shape[0] // 2 * 2
    width = first.shape[1] // 2 * 2
    command = [find_ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264"]
    command += ["-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        try:
            for frame in itertools.chain([first], pictures):
                encoder.stdin.write(np.ascontiguousarray(frame[:height, :width]).tobytes())
            encoder.stdin.close()
        except BrokenPipeError:
            # Its own message, which is read below, says why.
            pass
        except BaseException:
            encoder.kill()
            raise
        message = encoder.stderr.read().decode(errors="replace").strip()
    if encoder.returncode:
        reason = message.splitlines()[-1] if message else f"code {encoder.returncode}"
        raise ClutterGenError(f"{path.name} could not be encoded: {reason}", hint="film='gif'")
