"""Pictures: colours where they belong, framing that loses nothing, and clear words where nothing can draw."""

import os
import subprocess
import sys

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.assets import object_sheet, render_scene, scene_spec
from cluttergen_jax.rendering.camera import axes, fit_eye
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.picture import render_model
from tests.helpers.drawing import GREEN, RED, needs_gl


def status_with(value, **settings):
    code = "from cluttergen_jax.rendering.gl import renderer_status; print(*renderer_status(), sep='|')"
    env = {**os.environ, "MUJOCO_GL": value, **settings}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip().split("|", 1)


def test_nonsense_backend_is_named_and_choices_given():
    is_ok, message = status_with("nonsense")
    assert is_ok == "False"
    assert "nonsense" in message
    assert "glfw" in message
    assert "Try:" in message


@pytest.mark.parametrize(
    ("asked", "hint"), [(["--depth"], "--no-picture, since depth can"), ([], "unsetting")]
)
def test_what_has_to_be_drawn_is_refused_before_any_work(
    tmp_path, monkeypatch, capsys, asked, hint
):
    file = tmp_path / "ball.xml"
    ball = '<body pos="0 0 1"><freejoint/><geom size="0.1" group="2"/></body>'
    table = '<geom type="box" size="0.5 0.5 0.1" group="2"/>'
    file.write_text(f"<mujoco><worldbody>{table}{ball}</worldbody></mujoco>")
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert main(["render", str(file), *asked, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "MUJOCO_GL=disable switches pictures off" in said
    assert hint in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", range(20))
def test_fitted_eye_sees_all_points_and_stands_as_near_as_it_can(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3)) * rng.uniform(0.1, 2.0, 3) + rng.normal(size=3)
    margin = rng.uniform(0, 0.3)
    view = CameraView(rng.uniform(0, 360), rng.uniform(-85, 30), rng.uniform(10, 80), margin)
    aspect = rng.uniform(0.5, 2.0)
    seen = (points - fit_eye(points, view, aspect)) @ axes(view.azimuth, view.elevation).T
    assert seen[:, 2].min() > 0
    tangent = np.tan(np.radians(view.field_of_view) / 2)
    on_screen = seen[:, :2] / seen[:, 2:] / [tangent * aspect, tangent]
    assert np.abs(on_screen).max() == pytest.approx(1 - 2 * margin, rel=1e-9)
    np.testing.assert_allclose(on_screen.max(0), -on_screen.min(0), rtol=1e-9)


@pytest.mark.parametrize("wrong", [{"azimuth": np.nan}, {"elevation": np.nan}, {"elevation": 91.0}])
def test_views_are_finite(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        CameraView(**wrong)


@needs_gl
def test_objects_have_their_colours_where_they_stand():
    poses = np.array([[-0.15, 0, 0.75, 1, 0, 0, 0], [0.15, 0, 0.74, 1, 0, 0, 0]])
    # Seen from above with +x to the right: azimuth 90 looks along +y.
    view = CameraView(azimuth=90, elevation=-89)
    image = render_scene(
        [RED, GREEN], poses, cuboid_table(0.6, 0.4, 0.7), camera=view, samples=4
    ).astype(int)
    height, width, _ = image.shape
    assert (height, width) == (480, 640)
    is_red = (image[..., 0] > 2 * image[..., 1]) & (image[..., 0] > 100)
    is_green = (image[..., 1] > 2 * image[..., 0]) & (image[..., 1] > 80)
    # The table's 0.6 m fill the width but for the margins, so 0.25 m from the middle is about 0.22 of it.
    red_x = np.argwhere(is_red)[:, 1].mean() / width
    green_x = np.argwhere(is_green)[:, 1].mean() / width
    assert red_x + green_x == pytest.approx(1.0, abs=0.02)
    assert 0.2 < red_x < 0.35
    for mask, half in ((is_red, 0.05), (is_green, 0.04)):
        assert mask.sum() > 0.5 * (2 * half / 0.6 * width) ** 2 * 0.7
        assert np.argwhere(mask)[:, 0].mean() / height == pytest.approx(0.5, abs=0.05)


@needs_gl
def test_hulls_replace_surfaces_and_show_selects_bodies():
    poses = np.array([[-0.15, 0, 0.05, 1, 0, 0, 0], [0.15, 0, 0.04, 1, 0, 0, 0]])
    hulls = render_scene([RED, RED], poses, None, hulls=True, samples=2).astype(int)
    is_red = (hulls[..., 0] > 3 * hulls[..., 1]) & (hulls[..., 0] > 3 * hulls[..., 2])
    assert not is_red.any()
    spec, qpos = scene_spec([RED, GREEN], poses, None)
    model = spec.compile()
    groups = model.geom_group.copy()
    colours = model.geom_rgba.copy()
    alone = render_model(model, qpos, show=["00-red"], samples=2).astype(int)
    assert ((alone[..., 0] > 2 * alone[..., 1]) & (alone[..., 0] > 100)).any()
    assert not ((alone[..., 1] > 2 * alone[..., 0]) & (alone[..., 1] > 80)).any()
    np.testing.assert_array_equal(model.geom_group, groups)
    np.testing.assert_array_equal(model.geom_rgba, colours)
    with pytest.raises(ConfigError, match="body"):
        render_model(model, qpos, show=["blue"], samples=1)


@needs_gl
def test_object_sheet_draws_surface_and_parts():
    sheet = object_sheet([RED, GREEN, RED], columns=2, samples=2)
    assert sheet.shape == (2 * (240 + 8 + 24) + 8, 2 * (480 + 8) + 8, 3)
    left = sheet[8:248, 8:188].astype(int)
    right = sheet[8:248, 308:488].astype(int)
    assert not np.array_equal(right, np.broadcast_to(right[0, 0], right.shape))
    assert ((left[..., 0] > 3 * left[..., 1]) & (left[..., 0] > 100)).any()
    assert not ((right[..., 0] > 3 * right[..., 1]) & (right[..., 0] > 100)).any()
