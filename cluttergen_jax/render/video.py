"""Films on disk: GIF always, MP4 with the extra `video`. Files appear whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.render.files import written_whole

FORMATS = ("gif", "mp4")


def check_format(name: str) -> None:
    """Refuses a film format before any picture is drawn.

    Raises:
      ConfigError: there is no such format.
      MissingExtraError: "mp4" without the extra `video`.
    """
    if name not in FORMATS:
        raise ConfigError(f"film format {name!r}", ", ".join(FORMATS), "gif")
    if name == "mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError as error:
            raise MissingExtraError("video", "writing MP4 (GIF needs no extra)") from error


def save_film(frames: Iterable[np.ndarray], path: Path, fps: float) -> Path:
    """Writes uint8[H, W, 3] frames to a .gif or .mp4 file.

    Raises:
      ConfigError: another ending, no frames, or a rate that the format cannot hold.
      MissingExtraError: .mp4 without the extra `video`.
    """
    name = path.suffix.removeprefix(".")
    check_format(name)
    write: Callable[[Iterable[np.ndarray], Path, float], None] = _write_gif if name == "gif" else _write_mp4
    with written_whole(path) as fresh:
        write(frames, fresh, fps)
    return path


def _write_gif(frames: Iterable[np.ndarray], path: Path, fps: float) -> None:
    hundredths = round(100 / fps)
    if hundredths < 2:
        raise ConfigError(f"a GIF of {fps:g} frames per second", "50 at most", "--fps 20, or --format mp4")
    images = [Image.fromarray(frame) for frame in frames]
    if not images:
        raise ConfigError("a film without frames", "at least one")
    palette = _common_palette(images)
    # Without dithering nothing crawls from frame to frame, and what stands still costs no bytes.
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=10 * hundredths, loop=0, optimize=False
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
    import imageio_ffmpeg

    writer = None
    try:
        for frame in frames:
            # H.264 stores colours for blocks of two by two pixels.
            even = np.ascontiguousarray(frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2])
            if writer is None:
                height, width, _ = even.shape
                writer = imageio_ffmpeg.write_frames(
                    str(path),
                    (width, height),
                    fps=fps,
                    codec="libx264",
                    quality=None,
                    bitrate=None,
                    macro_block_size=2,
                    output_params=["-crf", "18", "-movflags", "+faststart"],
                    ffmpeg_log_level="error",
                )
                writer.send(None)
            writer.send(even)
    except OSError as error:
        raise ClutterGenError(f"{path.name} could not be encoded ({error})", hint="--format gif") from error
    finally:
        if writer is not None:
            writer.close()
    if writer is None:
        raise ConfigError("a film without frames", "at least one")
