"""Films, figures and overlays: what is shown when, and that files hold what was put in."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.rendering import film
from cluttergen_jax.rendering.config import FilmConfig
from cluttergen_jax.rendering.figure import GREEN as GREEN_RING
from cluttergen_jax.rendering.figure import closed_loop_figure
from cluttergen_jax.rendering.film import replay, replay_frames, save_film, turntable
from cluttergen_jax.rendering.scene_renderer import (
    RED,
    PictureConfig,
)
from cluttergen_jax.sensing.camera import Camera
from tests.helpers.drawing import needs_gl
from tests.helpers.recordings import cubes


def test_replay_shows_the_trajectory_and_only_what_stood():
    recording = cubes()
    frames = replay_frames(recording, FilmConfig(fps=40, seconds=60))
    for frame in frames:
        current = [
            k for k, style in enumerate(frame.styles) if style is not None and style.strength > 0
        ]
        assert len(current) <= 1
        # What is tinted is the current object, and red itself is never tinted: it failed at nothing.
        assert current in ([], [1])
    tinted = [f.styles[1] for f in frames if f.styles[1] is not None and f.styles[1].strength > 0]
    starts = [t.points[0] for f in frames for t in f.trails]
    for attempt in recording.failures:
        ends = np.array([style.pose[:3] for style in tinted])
        assert np.linalg.norm(ends - attempt.trajectory[-1, :3], axis=1).min() < 1e-6
        assert np.linalg.norm(np.array(starts) - attempt.trajectory[0, :3], axis=1).min() < 1e-6
    # Green is not there before red stands.
    first_green = next(k for k, f in enumerate(frames) if f.styles[1] is not None)
    np.testing.assert_array_equal(frames[first_green].styles[0].pose, recording.poses[0])
    last = frames[-1]
    for style, pose in zip(last.styles, recording.poses, strict=True):
        np.testing.assert_array_equal(style.pose, pose)
        assert (style.alpha, style.strength) == (1.0, 0.0)
    assert last.caption == "2 objects, 4 attempts: the scene stands"
    assert any("fell below" in f.caption for f in frames)


def test_replay_leads_from_where_objects_were_placed_to_where_a_crowd_left_them():
    recording = cubes()
    *before, last = recording.attempts
    gathered = recording.poses.copy()
    gathered[0, :2] += 0.05
    # A quarter turn, and the quaternion's other sign: nothing may vanish on the way.
    gathered[1, 3:] = [-np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    attempts = (*before, replace(last, gathered=gathered))
    recording = replace(recording, attempts=attempts, poses=gathered)
    frames = [each for each in replay_frames(recording) if "draws all together" in each.caption]
    poses = np.array([[style.pose for style in frame.styles] for frame in frames])
    assert len(frames) > 10
    assert np.abs(np.diff(poses, axis=0)).max() < 0.1
    np.testing.assert_allclose(np.linalg.norm(poses[..., 3:], axis=-1), 1.0)
    np.testing.assert_allclose(poses[0, 0], last.settled[0], atol=0.002)
    np.testing.assert_allclose(poses[-1, 0], gathered[0], atol=1e-6)
    np.testing.assert_allclose(poses[-1, 1, 3:], -gathered[1, 3:], atol=1e-6)


@needs_gl
def test_closed_loop_figure_rings_failures_red_and_the_end_green():
    image = closed_loop_figure(cubes(), picture=PictureConfig(width=320, height=240, samples=4))
    assert image.shape == (240, 320, 3)
    green = np.round(255 * np.array(GREEN_RING)).astype(int)
    assert (np.abs(image.astype(int) - green).max(-1) < 12).sum() > 20
    red = np.round(255 * np.array(RED)).astype(int)
    assert (np.abs(image.astype(int) - red).max(-1) < 12).sum() > 60


@needs_gl
def test_a_camera_of_ones_own_stays_or_goes_around():
    recording = cubes()
    picture = PictureConfig(width=64, height=48, samples=2)
    middle = np.append(recording.region.center, recording.support.top)
    one, other = (
        Camera.looking(middle + np.array([side * 0.5, 0.1 * side, 0.4]), middle, 80, 60, 90.0)
        for side in (1, -1)
    )
    pace = FilmConfig(fps=4, seconds=1)
    around, from_other = ([*turntable(recording, pace, picture, each)] for each in (one, other))
    plain = FilmConfig(fps=4, seconds=1, captions=False)
    ends = [[*replay(recording, plain, picture, each)][-1] for each in (one, other)]
    assert {image.shape for image in (*around, *ends)} == {(60, 80, 3)}
    # Half a turn leads to where the other camera begins; only the light has gone along.
    near, far = (
        np.abs(around[2].astype(int) - image).mean() for image in (from_other[0], around[0])
    )
    assert near < 0.8 * far
    np.testing.assert_array_equal(ends[0], around[0])
    np.testing.assert_array_equal(ends[1], from_other[0])


def moving_square(count=6, size=(48, 64)):
    for k in range(count):
        image = np.full((*size, 3), 230, np.uint8)
        image[10:20, 5 + 8 * k : 15 + 8 * k] = (200, 30, 30)
        yield image


def test_gif_holds_every_frame_at_its_pace(tmp_path):
    path = save_film(moving_square(), tmp_path / "new" / "a.gif", 20)
    with Image.open(path) as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (6, (64, 48), 0)
        for k, expected in enumerate(moving_square()):
            film.seek(k)
            assert film.info["duration"] == 50
            np.testing.assert_allclose(
                np.asarray(film.convert("RGB")).astype(int), expected, atol=8
            )
    assert [each.name for each in path.parent.iterdir()] == ["a.gif"]


def test_mp4_holds_every_frame(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    path = save_film(moving_square(size=(49, 65)), tmp_path / "a.mp4", 10)
    reader = ffmpeg.read_frames(str(path))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).reshape(48, 64, 3) for frame in reader]
    assert meta["size"] == (64, 48)
    assert meta["fps"] == pytest.approx(10)
    assert len(frames) == 6
    for frame, expected in zip(frames, moving_square(size=(49, 65)), strict=True):
        np.testing.assert_allclose(
            frame[12:18].mean((0, 1)), expected[12:18, :64].mean((0, 1)), atol=12
        )


def test_films_that_cannot_be_are_refused_and_leave_nothing(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="avi"):
        save_film(moving_square(), tmp_path / "a.avi", 20)
    with pytest.raises(ConfigError, match="without frames"):
        save_film([], tmp_path / "a.gif", 20)
    with pytest.raises(ConfigError, match="frames per second"):
        save_film(moving_square(), tmp_path / "a.gif", 120)
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(film.shutil, "which", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"'\.\[video\]'"):
        save_film(moving_square(), tmp_path / "a.mp4", 20)
    assert list(tmp_path.iterdir()) == []
