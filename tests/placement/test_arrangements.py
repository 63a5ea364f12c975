"""Rows, stacks and nests: their words, what can be in one, and scenes against geometry of their own."""

from __future__ import annotations

from itertools import pairwise

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg
from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.assets.pool import Pool, find_pool, write_pool
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.arranged import (
    able_objects,
    count_arranged,
    lift_of,
    row_quaternions,
    stands_on_itself,
)
from cluttergen_jax.placement.arrangements import (
    Arrangement,
    parse_arrangements,
    roles_and_relations,
)
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.region import pose_of_action
from cluttergen_jax.scene.bank import read_bank, read_scenes
from cluttergen_jax.scene.bank.stats import stats_of
from tests.helpers.worlds import box, prism


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["row"], "KIND CONDITION"),
        (["rwo book*"], "Did you mean 'row'"),
        (["stack plate*:1"], "2 to 16"),
        (["stack plate*:two"], "2 to 16"),
        (["nest hieght<3"], "Did you mean 'height'"),
        ("row book*", "a sequence of texts"),
    ],
)
def test_what_is_no_arrangement_is_refused_in_words(texts, words):
    with pytest.raises(ConfigError, match=words):
        parse_arrangements(texts)


def test_arrangements_are_read_and_written():
    found = parse_arrangements(["row label=*book* and height<0.3:4", "nest  bowl"])
    assert found == (
        Arrangement("row", "label=*book* and height<0.3", 4),
        Arrangement("nest", "bowl", 3),
    )
    assert parse_arrangements(list(map(str, found))) == found
    roles, relations = roles_and_relations(found)
    assert len(roles) == 7
    # A row's first member is placed by the region, a nest's like any object.
    assert [(each.kind, each.reference) for each in relations] == [
        ("in_row_with", "table"),
        ("in_row_with", "row-1-1"),
        ("in_row_with", "row-1-2"),
        ("in_row_with", "row-1-3"),
        ("nested_in", "nest-2-1"),
        ("nested_in", "nest-2-2"),
    ]
    config = PlacementConfig(num_objects=7, arrangements=tuple(map(str, found)))
    assert config.all_roles == roles
    with pytest.raises(ConfigError, match="7 objects in relations and arrangements"):
        PlacementConfig(num_objects=6, arrangements=config.arrangements)


BOOK = box("book", (0.1, 0.07, 0.015))
BALL = prism("ball", 0.03, 0.03, sides=24)


def test_a_row_of_round_things_is_refused_with_what_would_do():
    objects = [BOOK, BALL, box("cube", (0.03, 0.03, 0.03))]
    facts = [ObjectFacts.of(each) for each in objects]
    with pytest.raises(ConfigError) as told:
        able_objects(objects, facts, ("row ball",))
    assert "'row ball:3' of ball, which are no boxes" in str(told.value)
    assert told.value.allowed == "such as book"
    assert told.value.hint == "arrangements=('row book:3',)"
    # A cube has no thin side either.
    with pytest.raises(ConfigError, match="cube"):
        able_objects(objects, facts, ("row cube",))
    (first, *_) = able_objects(objects, facts, ("row *",)).values()
    assert first.tolist() == [True, False, False]


def test_things_that_do_not_stand_on_their_like_are_refused():
    pool = find_pool("dining+kitchen", names=("bowl", "dinner_plate", "bottle", "teapot"))
    bowl, plate, bottle, teapot = (
        pool[name] for name in ("bowl", "dinner_plate", "bottle", "teapot")
    )
    assert stands_on_itself(bowl) == (True, True)
    assert stands_on_itself(plate)[0]
    assert not stands_on_itself(teapot)[0]
    assert not stands_on_itself(bottle)[0]
    assert stands_on_itself(BOOK) == (True, False)
    assert lift_of(BOOK) == pytest.approx(0.03, abs=1e-6)
    # Bowls sink into one another by more than a third of their height.
    assert lift_of(bowl) < 4 / 3 * bowl.half_extents[2]
    objects = [bowl, plate, bottle, teapot]
    facts = [ObjectFacts.of(each) for each in objects]
    with pytest.raises(ConfigError, match=r"teapot, which do not stand on one another.*bowl"):
        able_objects(objects, facts, ("stack teapot",))
    with pytest.raises(ConfigError, match=r"dinner_plate, which are not hollow.*such as bowl"):
        able_objects(objects, facts, ("nest dinner_plate",))
    with pytest.raises(ConfigError, match=r"'plate', which no object is.*dinner_plate"):
        able_objects(objects, facts, ("stack plate",))


def test_what_carries_nothing_is_not_stacked():
    names = ("mug", "wine_glass", "water_glass", "fork", "soup_can")
    objects = list(find_pool("dining", names=names).objects)
    facts = [ObjectFacts.of(each) for each in objects]
    (able, *_) = able_objects(objects, facts, ("stack *",)).values()
    # Mugs are stacked by people, and glasses that sink into one another.
    is_stacked = dict(zip([each.name for each in objects], able.tolist(), strict=True))
    assert is_stacked == {
        "mug": True,
        "wine_glass": False,
        "water_glass": True,
        "fork": False,
        "soup_can": True,
    }
    with pytest.raises(ConfigError, match=r"wine_glass, which carry nothing.*such as mug"):
        able_objects(objects, facts, ("stack wine_glass",))


def test_a_book_stands_on_its_narrow_side_with_its_thin_side_along_the_row():
    (tall, low) = row_quaternions(BOOK)
    for quaternion, height in ((tall, 0.2), (low, 0.14)):
        vertices = BOOK.vertices @ Rotation.from_quat(quaternion, scalar_first=True).as_matrix().T
        assert np.ptp(vertices, axis=0)[[0, 2]] == pytest.approx([0.03, height])
    # Where a board hangs over it, it stands on its longer side.
    assert row_quaternions(BOOK, free=0.15) == [pytest.approx(low)]
    # What stands so by itself stays as it is.
    carton = box("carton", (0.08, 0.03, 0.11))
    assert row_quaternions(carton)[0].tolist() == [1, 0, 0, 0]


def test_rows_stacks_and_nests_are_counted():
    half = np.array([[0.015, 0.07, 0.1]] * 3 + [[0.06, 0.06, 0.03]] * 3)
    poses = np.zeros((6, 7))
    poses[:, 3] = 1.0
    poses[:3, 0] = [0.0, 0.033, 0.2]
    poses[:3, 2] = 0.1
    poses[3:, :3] = [[1.0, 0.0, 0.03], [1.0, 0.01, 0.05], [1.0, 0.0, 0.11]]
    names = ["book"] * 3 + ["bowl"] * 3
    is_hollow = np.array([False] * 3 + [True] * 3)
    assert count_arranged(names, half, is_hollow, poses) == (2, 2, 1)
    # A book at an angle is none of the row, nor one of another thickness than thin.
    turned = poses.copy()
    turned[1, 3:] = Rotation.from_euler("z", 20, degrees=True).as_quat(scalar_first=True)
    assert count_arranged(names, half, is_hollow, turned)[0] == 0
    cubes = half.copy()
    cubes[:3] = 0.015
    assert count_arranged(names, cubes, is_hollow, poses)[0] == 0
    # Other things in a bowl are no nest.
    assert count_arranged(["a", "b", "c", "d", "e", "f"], half, is_hollow, poses)[1:] == (0, 0)
    assert count_arranged([], np.zeros((0, 3)), np.zeros(0, bool), np.zeros((0, 7))) == (0, 0, 0)


@pytest.fixture(scope="module")
def books(tmp_path_factory):
    objects = (BOOK, box("thick", (0.09, 0.065, 0.02)), BALL, box("tile", (0.05, 0.05, 0.01)))
    return str(write_pool(tmp_path_factory.mktemp("pools") / "books", Pool("books", objects)))


@pytest.mark.slow
def test_the_first_of_a_row_stands_at_the_back_of_a_shelf_and_leaves_room(books):
    rules = PlacementConfig(num_objects=4, arrangements=("row book:3",), order="random")
    config = ProblemConfig(
        pool=books, repeat=True, support="bookcase", surface="shelf_1", placement=rules
    )
    problem = make_problem(config)
    propose = make_proposer("spread", problem.rules)
    rules = problem.rules

    def first(key):
        episode = rules.begin(key)
        action = propose(key, episode)
        quaternion = rules.body(episode).quaternion
        pose = pose_of_action(action, episode.region, rules.height_range(episode), quaternion)
        return pose, episode.region, rules.focus(episode)

    poses, regions, focus = jax.jit(jax.vmap(first))(jax.random.split(jax.random.key(0), 8))
    room = np.asarray(regions.half_extents)[0]
    origin = np.asarray(regions.T_world_region.translation())[0]
    for pose, index in zip(np.asarray(poses), np.asarray(focus), strict=True):
        asset = problem.world.objects[index]
        assert asset.name == "book"
        turn = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
        vertices = asset.vertices @ turn.T + pose[:3] - origin
        assert np.ptp(vertices[:, 0]) < 0.035
        assert np.ptp(vertices[:, 2]) == pytest.approx(0.2, abs=1e-4)
        assert 0 < room[1] - vertices[:, 1].max() < 0.004
        assert vertices[:, 0].min() > -room[0]
        assert vertices[:, 0].max() + 2 * 0.03 < room[0]


@pytest.mark.slow
def test_rows_on_shelves_stand_side_by_side_with_their_backs_in_one_line(books, tmp_path):
    bank = cg.generate(
        tmp_path / "bank",
        pool=books,
        repeat=True,
        support="bookcase",
        surface="all",
        num_objects=7,
        num_scenes=6,
        arrangements=("row book:4",),
        render=False,
        max_files=0,
    )
    scenes = list(read_scenes(bank))
    assert len(scenes) >= 5
    for scene in scenes:
        corners = [
            asset.vertices @ Rotation.from_quat(pose[3:], scalar_first=True).as_matrix().T
            + pose[:3]
            for asset, pose in zip(scene.objects, scene.poses, strict=True)
            if asset.name == "book"
        ]
        row = [each for each in corners if np.ptp(each[:, 2]) > 0.19]
        row.sort(key=lambda each: each[:, 0].min())
        # Others of the kind may lie anywhere; four stand.
        assert len(row) == 4
        assert np.ptp([each[:, 2].min() for each in row]) < 0.002
        assert np.ptp([each[:, 1].max() for each in row]) < 0.006
        gaps = [b[:, 0].min() - a[:, 0].max() for a, b in pairwise(row)]
        assert max(gaps) < 0.006
    stats = {each.name: each for each in stats_of(bank).clutter}
    assert stats["row"].asked == 4
    assert stats["row"].got >= 4
    assert read_bank(bank.path).spec.arrangements == ("row book:4",)


@pytest.mark.slow
def test_stacks_and_nests_are_centred(tmp_path):
    bank = cg.generate(
        tmp_path / "bank",
        pool="dining",
        objects=("bowl", "dinner_plate", "mug"),
        repeat=True,
        num_objects=7,
        num_scenes=6,
        arrangements=("stack dinner_plate:3", "nest bowl:3"),
        render=False,
        max_files=0,
    )
    scenes = list(read_scenes(bank))
    assert len(scenes) >= 5
    for scene in scenes:
        for name, pitch in (("dinner_plate", 0.012), ("bowl", 0.03)):
            place = [
                pose[:3]
                for asset, pose in zip(scene.objects, scene.poses, strict=True)
                if asset.name == name
            ]
            place.sort(key=lambda each: each[2])
            # The three that are one upon the other, whatever else stands there.
            near = [each for each in place if np.linalg.norm(each[:2] - place[-1][:2]) < 0.01]
            assert len(near) == 3
            assert np.diff([each[2] for each in near]).max() < pitch
    stats = {each.name: each for each in stats_of(bank).clutter}
    assert (stats["stacked"].asked, stats["nest"].asked) == (4, 2)
    assert stats["nest"].got == 2


def test_a_layout_has_arrangements(tmp_path):
    path = tmp_path / "cupboard.yaml"
    path.write_text(
        "objects: {mine: mug}\narrangements: ['stack dinner_plate:3', nest bowl]\nothers: 1\n"
    )
    spec = cg.read_layout(path)
    assert spec.num_objects == 1 + 3 + 3 + 1
    assert spec.arrangements == ("stack dinner_plate:3", "nest bowl")
    path.write_text("objects: {mine: mug}\narrangements: ['stack dinner_plate:3']\n")
    assert cg.read_layout(path).objects == ("mug", "dinner_plate")


def test_arrangements_are_refused_where_nothing_brings_them_about():
    with pytest.raises(ConfigError, match=r"arrangements.*random"):
        cg.SceneSpec(arrangements=("stack bowl",)).check_method("random")
    with pytest.raises(ConfigError, match="shelf"):
        cg.SceneSpec(arrangements=("stack bowl",), shelf=5).problem_config("guided")
    with pytest.raises(ConfigError, match="start from"):
        cg.SceneSpec(arrangements=("stack bowl",), start="bank:0")
    rules = PlacementConfig(num_objects=4, arrangements=("stack bowl",))
    with pytest.raises(ConfigError, match="repeat=True"):
        make_problem(ProblemConfig(placement=rules))
