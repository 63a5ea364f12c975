"""Films: who stands where in each frame, shot as they are asked for, and written whole or not at all.

GIF always, MP4 with the extra `video` or the system's ffmpeg. OpenGL is needed once a film is shot.
"""

from __future__ import annotations

import itertools
import math
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image

from cluttergen_jax.config import FilmFormat
from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.files import file_whole
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.config import FilmConfig
from cluttergen_jax.rendering.figure import GREEN, trails_of
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import (
    RED,
    PictureConfig,
    RenderStyle,
    open_scene_renderer,
    turntable_points,
)
from cluttergen_jax.rendering.seat_mark import seat_mark
from cluttergen_jax.rendering.sheet import with_caption
from cluttergen_jax.sensing.camera import Camera

_TINT = 0.72
_GATHER = "gather"
_GATHERED = "physics draws all together (straight paths: the real ones are not recorded)"


@dataclass(frozen=True, eq=False)
class FilmFrame:
    """One picture of a film: a style per object of the world (None: not there), lines, and words."""

    styles: tuple[RenderStyle | None, ...]
    trails: tuple[Trail, ...] = ()
    caption: str = ""
    dot: tuple[float, float, float] | None = None


def _segments(attempt: Attempt, timestep: float, config: FilmConfig) -> dict[str, float]:
    """The stretches of an attempt by kind, and how long they last, in seconds."""
    begin = {"approach": 0.3, "settle": config.slowdown * attempt.num_steps * timestep}
    if not attempt.is_stable:
        return begin | {"shown": 0.3, "fade": 0.35}
    end = {"rest": 0.15}
    return (
        begin | end | ({} if attempt.gathered is None else {_GATHER: 1.2, f"rest {_GATHER}": 0.3})
    )


def replay_frames(recording: Replay, config: FilmConfig | None = None) -> list[FilmFrame]:
    """The placement as it happened: each attempt in turn, failed ones turning red and fading away.

    From release to the attempt's end the frames show the simulator's own trajectory. Objects that are drawn
    together afterwards glide straight to where that left them, as the caption says.

    Raises:
      ConfigError: the recording's attempts are not known.
    """
    config = config or FilmConfig()
    if not recording.attempts:
        raise ConfigError(
            f"{recording.title}: how its objects were placed is not known",
            "a scene of a bank whose recipe is whole",
            "the bank's folder instead of a single file",
        )
    segments = [_segments(each, recording.timestep, config) for each in recording.attempts]
    natural = sum(sum(each.values()) for each in segments)
    hold = min(1.5, 0.2 * config.seconds)
    speedup = max(1.0, natural / max(config.seconds - hold, 1e-6))
    frames: list[FilmFrame] = []
    clock = 0.0
    for place, of_attempt in enumerate(segments):
        for kind, seconds in of_attempt.items():
            # Rounding the clock, not each segment, keeps the film as long as it was meant to be.
            first = round(clock * config.fps)
            clock = clock + seconds / speedup
            count = round(clock * config.fps) - first
            for number in range(count):
                frames.append(_frame(recording, place, kind, (number + 1) / count, config))
    last = _standing(recording, recording.poses, recording.is_placed)
    end = FilmFrame(last, (), *(_ending(recording) if config.captions else ("", None)))
    return [*frames, *[end] * max(1, round(hold * config.fps))]


def _standing(
    recording: Replay, poses: np.ndarray, is_placed: np.ndarray
) -> tuple[RenderStyle | None, ...]:
    return tuple(
        RenderStyle(poses[i]) if is_placed[i] else None for i in range(len(recording.objects))
    )


def _frame(
    recording: Replay, place: int, kind: str, progress: float, config: FilmConfig
) -> FilmFrame:
    attempt = recording.attempts[place]
    if kind.endswith(_GATHER):
        share = progress * progress * (3 - 2 * progress) if kind == _GATHER else 1.0
        is_there = attempt.is_placed.copy()
        is_there[attempt.object_index] = True
        return FilmFrame(
            _standing(recording, attempt.poses_gathering(share), is_there),
            (),
            *((_GATHERED, None) if config.captions else ("", None)),
        )
    styles = list(_standing(recording, attempt.poses, attempt.is_placed))
    row = {"approach": 0, "settle": round(progress * attempt.num_steps)}.get(
        kind, attempt.num_steps
    )
    pose = attempt.trajectory[row, :7].astype(np.float64)
    alpha = 1.0
    strength = 0.0
    trails: tuple[Trail, ...] = ()
    if kind == "approach":
        pose[2] += config.lift * (1.0 - progress) ** 2
        alpha = min(1.0, 2 * progress)
    elif not attempt.is_stable:
        alpha = 1.0 - progress if kind == "fade" else 1.0
        strength = _TINT * (progress if kind == "settle" else 1.0)
        trails = trails_of(attempt, row, alpha)
    elif kind == "rest":
        styles = list(_standing(recording, attempt.settled, attempt.is_placed))
        pose = attempt.settled[attempt.object_index]
    styles[attempt.object_index] = RenderStyle(pose, alpha, RED, strength)
    words = _words(recording, place, kind) if config.captions else ("", None)
    return FilmFrame(tuple(styles), trails, *words)


def _words(
    recording: Replay, place: int, kind: str
) -> tuple[str, tuple[float, float, float] | None]:
    attempt = recording.attempts[place]
    asset = recording.objects[attempt.object_index]
    text = f"{asset.label or asset.name}, attempt {attempt.ordinal}"
    if kind in ("approach", "settle"):
        taken = len(recording.taken_away(place))
        return text + (f" ({taken} taken away)" if taken else ""), None
    return (
        (f"{text}: stands", GREEN)
        if attempt.is_stable
        else (f"{text}: {attempt.verdict.sentence}", RED)
    )


def _ending(recording: Replay) -> tuple[str, tuple[float, float, float]]:
    placed = len(recording.placed)
    tried = len(recording.attempts)
    text = f"{placed} objects, {tried} attempts"
    if recording.is_success:
        return f"{text}: the scene stands", GREEN
    return f"{text}: {recording.verdict}", RED


def replay(
    recording: Replay,
    config: FilmConfig | None = None,
    picture: PictureConfig | None = None,
    camera: Camera | None = None,
) -> Iterator[np.ndarray]:
    """The pictures of `replay_frames`, uint8[height, width, 3] each, drawn as they are asked for.

    Args:
      camera: that sees it; the picture's view if None.
    """
    picture = _with_size_of(picture or PictureConfig(samples=8), camera)
    frames = replay_frames(recording, config)
    points = _end_points(recording)
    seat = recording.seat if picture.photo is None else ""
    mark = seat_mark(recording.region, recording.support, seat)
    with open_scene_renderer(recording.objects, recording.support, points, picture) as renderer:
        renderer.camera = camera or renderer.camera
        image = None
        shown = None
        for frame in frames:
            # The end stands still: it is drawn once.
            if image is None or frame is not shown:
                image = with_caption(
                    renderer.picture(frame.styles, (*frame.trails, *mark)),
                    frame.caption,
                    frame.dot,
                )
                shown = frame
            yield image


def turntable(
    recording: Replay,
    config: FilmConfig | None = None,
    picture: PictureConfig | None = None,
    camera: Camera | None = None,
) -> Iterator[np.ndarray]:
    """Once around the finished scene, uint8[height, width, 3] each; the last picture leads to the first.

    Args:
      camera: that goes around the middle of the region; the picture's view if None.
    """
    config = config or FilmConfig(seconds=6.0)
    picture = _with_size_of(picture or PictureConfig(samples=8), camera)
    count = max(2, round(config.fps * config.seconds))
    styles = _standing(recording, recording.poses, recording.is_placed)
    points = _end_points(recording)
    seat = recording.seat if picture.photo is None else ""
    mark = seat_mark(recording.region, recording.support, seat)
    with open_scene_renderer(recording.objects, recording.support, points, picture) as renderer:
        around = turntable_points(renderer.content if picture.whole else points)
        for number in range(count):
            turn = 360.0 * number / count
            if camera is None:
                renderer.aim(around, replace(picture.view, azimuth=picture.view.azimuth + turn))
            else:
                renderer.camera = _rotate_about(camera, recording.region.center, math.radians(turn))
            # The lights go with the camera: it is the table that turns.
            yield renderer.picture(styles, mark, light_yaw=math.radians(turn))


def _with_size_of(picture: PictureConfig, camera: Camera | None) -> PictureConfig:
    return picture if camera is None else replace(picture, width=camera.width, height=camera.height)


def _rotate_about(camera: Camera, middle: Sequence[float], angle: float) -> Camera:
    """The camera somewhere else on its circle around a vertical axis through `middle` (x, y), metres."""
    turn = np.eye(4)
    cos = math.cos(angle)
    sin = math.sin(angle)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    turn[:2, 3] = middle - turn[:2, :2] @ middle
    return replace(camera, T_world_camera=turn @ camera.T_world_camera)


def _end_points(recording: Replay) -> np.ndarray:
    """f64[P, 3]: what the camera has to show, at the end."""
    objects = [recording.objects[i] for i in recording.placed]
    return close_points(objects, recording.poses[recording.placed], recording.support)


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
