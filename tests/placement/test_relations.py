"""Relations: their words, who takes which role, and scenes judged by contacts and polygons of their own."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapely import MultiPoint

from cluttergen_jax.api.generate import generate
from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.files import view_of
from cluttergen_jax.generation.layouts import list_layouts, read_layout
from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.config import placement_record
from cluttergen_jax.placement.region import make_region
from cluttergen_jax.placement.related import RelatedObjects, hold, preference
from cluttergen_jax.placement.relations import Relation, order_of, parse_relations, parse_roles
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.scene.bank import Bank, read_scenes
from cluttergen_jax.spec import SceneSpec


def facts(*names: str) -> list[ObjectFacts]:
    return [ObjectFacts(name, name, (0.1, 0.1, 0.1), 1e-3, 0.1, "", "", 1, False) for name in names]


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["mug on mug"], "to itself"),
        (["a on b", "b on c", "c on a"], "circle"),
        (["a over b"], "'over'"),
        (["a on b:0.2"], "none with the others"),
        (["a next_to b:9"], "up to 2 m"),
        (["table on a"], "aligned table"),
        (["a rigt_of b"], "Did you mean 'right_of'"),
        (["a on"], "SUBJECT KIND REFERENCE"),
        ("a on b", "a sequence of texts"),
    ],
)
def test_what_is_no_relation_is_refused_in_words(texts, words):
    with pytest.raises(ConfigError, match=words):
        parse_relations(texts)


def test_relations_are_read_and_written():
    texts = ["fork under plate", "cup next_to jar", "jar left_of plate:0.3", "fork aligned table"]
    found = parse_relations(texts)
    assert [str(each) for each in found] == [
        "plate on fork",
        "cup next_to jar:0.05",
        "jar left_of plate:0.3",
        "fork aligned table",
    ]
    assert parse_relations(list(map(str, found))) == found
    order = order_of(found)
    assert all(
        order.index(each.subject) > order.index(each.reference)
        for each in found
        if each.reference in order
    )


def test_every_role_has_its_own_object_that_fits():
    related = RelatedObjects.of(
        parse_relations(["a on b", "c next_to b"]),
        parse_roles("a=mug*; b=any_of*; c=*"),
        facts("mug", "mug_2", "any_of_1", "other"),
    )
    drawn = np.asarray(jax.jit(jax.vmap(related.draw))(jax.random.split(jax.random.key(0), 40)))
    fits = np.asarray(related.candidates)
    for objects in drawn:
        assert len(set(objects.tolist())) == 3
        assert all(fits[role, each] for role, each in enumerate(objects))
    assert len({tuple(each) for each in drawn.tolist()}) > 2


def test_too_few_objects_for_the_roles_are_refused():
    with pytest.raises(ConfigError, match="2 different objects"):
        RelatedObjects.of(
            parse_relations(["a on b"]), parse_roles("a=mug; b=mug"), facts("mug", "jar")
        )
    with pytest.raises(ConfigError, match="Did you mean 'mug'"):
        RelatedObjects.of(parse_relations(["mgu on jar"]), (), facts("mug", "jar"))
    with pytest.raises(ConfigError, match="num_objects=3"):
        SceneSpec(num_objects=2, relations=("mug on bowl", "fork next_to mug"))


def boxes(center, yaw: float = 0.0, half=(0.02, 0.05, 0.03)) -> Boxes:
    half_quaternion = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    return Boxes.of(jnp.array([half]), jnp.array([[*center, *half_quaternion]]))


@pytest.mark.parametrize(
    ("text", "place", "expected"),
    [
        ("a right_of b", (0.18, 0.05, 0.0), True),
        ("a right_of b", (0.18, 0.2, 0.0), False),
        ("a right_of b", (0.3, 0.0, 0.0), False),
        ("a left_of b", (-0.18, 0.05, 0.0), True),
        ("a behind b", (0.05, 0.2, 0.0), True),
        ("a in_front_of b", (0.05, -0.2, 0.0), True),
        ("a in_front_of b", (0.05, 0.2, 0.0), False),
        ("a next_to b", (0.08, 0.0, 0.0), True),
        ("a next_to b", (0.10, 0.0, 0.0), False),
        ("a next_to b", (0.01, 0.0, 0.06), False),
        ("a far_from b", (0.25, 0.0, 0.0), True),
        ("a far_from b", (0.20, 0.0, 0.0), False),
        ("a in b", (0.01, 0.0, 0.02), True),
        ("a in b", (0.01, 0.0, 0.06), False),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 1.1])
def test_what_holds_is_told_in_the_frame_of_the_region(text, place, expected, yaw):
    related = RelatedObjects.of([Relation.parse(text)], (), facts("a", "b"))
    turned = Rotation.from_euler("z", yaw).apply(place)
    region = make_region(jnp.zeros(2), jnp.ones(2), yaw, 0.0)
    reference = boxes((0, 0, 0), yaw)
    opening = boxes((0, 0, 0), yaw, (0.016, 0.04, 0.03))
    assert bool(hold(related, boxes(turned, yaw), reference, opening, region)[0]) == expected


@pytest.mark.parametrize(
    ("degrees", "expected"), [(0, True), (9, True), (14, False), (90, False), (180, True)]
)
def test_longer_sides_are_aligned(degrees, expected):
    region = make_region(jnp.zeros(2), jnp.ones(2), 0.3, 0.0)
    to_object = RelatedObjects.of([Relation.parse("a aligned b")], (), facts("a", "b"))
    to_table = RelatedObjects.of([Relation.parse("a aligned table")], (), facts("a", "b"))
    turned = boxes((0, 0.3, 0), 0.3 + np.radians(degrees))
    other = boxes((0, 0, 0), 0.3)
    assert bool(hold(to_object, turned, other, other, region)[0]) == expected
    assert bool(hold(to_table, turned, other, other, region)[0]) == (expected or degrees == 90)


def test_layouts_are_read_and_errors_say_where():
    assert len(list_layouts()) == 12
    for name in list_layouts():
        spec = read_layout(name)
        assert spec.relations
        assert spec.num_objects >= len(parse_roles(spec.roles))
    with pytest.raises(ConfigError, match="Did you mean 'picnic'"):
        read_layout("picnik")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("objects: {a: mug}\nrelations: [b on a]", "'b' in a relation"),
        ("objects: {a: mug}\nrelatoins: [b on a]", "relatoins"),
        ("- a", "a mapping with"),
        ("objects: {a: mug", "YAML"),
    ],
)
def test_a_layout_with_a_mistake_is_refused(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_layout(path)


def test_relations_of_a_layout_take_objects_of_the_pool(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "objects: {mine: dinner_plate}\nrelations: [fork left_of mine, any behind mine]\n"
    )
    spec = read_layout(path)
    assert (spec.num_objects, spec.objects) == (3, ("dinner_plate", "fork", "*"))
    asked = SceneSpec(relations=spec.relations, roles=spec.roles, num_objects=3).problem_config(
        "guided"
    )
    assert asked.placement.relations == spec.problem_config("guided").placement.relations
    for wrong, meant in (("frok left_of mine", "fork"), ("fork left_of mime", "mine")):
        path.write_text(f"objects: {{mine: dinner_plate}}\nrelations: [{wrong}]\n")
        with pytest.raises(ConfigError, match=f"in a relation of layout .*Did you mean '{meant}'"):
            read_layout(path)


def test_a_misspelt_object_of_a_relation_is_named_with_what_was_meant():
    with pytest.raises(
        ConfigError, match=r"^no object is called 'papreback'. Did you mean 'paperback'\?"
    ):
        RelatedObjects.of([Relation.parse("papreback on book")], (), facts("paperback", "book"))
    # Another misspelt name is not what was meant.
    with pytest.raises(ConfigError, match="Did you mean 'paperback'"):
        RelatedObjects.of(
            [Relation.parse("papreback on papreback2")], (), facts("paperback", "book")
        )
    with pytest.raises(ConfigError, match=r"role 'low' is 'boko\*', .* Try: roles='low=book'"):
        RelatedObjects.of(
            [Relation.parse("paperback on low")], [("low", "boko*")], facts("paperback", "book")
        )


def corners(scene, index) -> np.ndarray:
    asset = scene.objects[index]
    pose = scene.poses[index]
    vertices = np.concatenate([part.vertices for part in asset.parts])
    return Rotation.from_quat(pose[3:], scalar_first=True).apply(vertices) + pose[:3]


@pytest.mark.slow
def test_relations_hold_in_scenes_that_succeed(tmp_path):
    bank = generate(
        tmp_path / "bank",
        pool="dining",
        relations=(
            "bowl on dinner_plate",
            "fork left_of dinner_plate",
            "mug next_to bottle:0.05",
            "wine_glass behind dinner_plate",
        ),
        num_scenes=64,
        seed=5,
        render=False,
        max_files=0,
    )
    scenes = list(read_scenes(bank))
    assert len(scenes) >= 60
    for scene in scenes:
        place = {name: index for index, name in enumerate(scene.names)}
        points = {name: corners(scene, index) for name, index in place.items()}
        plans = {name: MultiPoint(each[:, :2]).convex_hull for name, each in points.items()}
        # Of hulls, which are within the boxes: gaps are larger by what a box has beyond its hull.
        assert points["bowl"][:, 2].min() > points["dinner_plate"][:, 2].min() + 0.002
        assert plans["bowl"].centroid.within(plans["dinner_plate"])
        assert plans["mug"].distance(plans["bottle"]) < 0.05 + 0.06
        x, y, _ = (scene.poses[place["fork"]] - scene.poses[place["dinner_plate"]])[:3]
        assert x < 0
        assert abs(y) <= -x + 1e-5
        x, y, _ = (scene.poses[place["wine_glass"]] - scene.poses[place["dinner_plate"]])[:3]
        assert y > 0
        assert abs(x) <= y + 1e-5


def weigh(text, places, yaws, half=(0.01, 0.08, 0.01)):
    """Log weights of places of "a", a long thing, about "b", a plate at the origin."""
    related = RelatedObjects.of([Relation.parse(text)], (), facts("a", "b"))
    roles = {name: index for index, name in enumerate(order_of([Relation.parse(text)]))}
    numbers = jnp.array([("a", "b").index(name) for name in sorted(roles, key=roles.get)])
    episode = SimpleNamespace(
        roles=numbers,
        is_placed=jnp.array([False, True]),
        safe_poses=jnp.tile(jnp.array([[0.0, 0, 0, 1, 0, 0, 0]]), (2, 1)),
        region=make_region(jnp.zeros(2), jnp.ones(2), 0.0, 0.0),
    )
    geometry = SimpleNamespace(half_extents=jnp.array([half, (0.1, 0.1, 0.01)]), hollows=None)
    # Four whatever is asked for: of one size all is compiled once.
    number = len(places)
    poses = np.zeros((4, 7))
    poses[:, 3] = 1
    poses[:number, :2] = places
    poses[:number, 3] = np.cos(np.divide(yaws, 2))
    poses[:number, 6] = np.sin(np.divide(yaws, 2))
    proposed = Boxes.of(jnp.array([half] * 4), jnp.array(poses))
    return np.asarray(preference(related, episode, jnp.int32(0), proposed, geometry))[:number]


def around(kind, degrees, far):
    """A place at an angle from the middle of a side."""
    middle = {"left_of": 180, "right_of": 0, "in_front_of": 270, "behind": 90}[kind]
    angle = np.radians(middle + degrees)
    return far * np.cos(angle), far * np.sin(angle)


@pytest.mark.parametrize("kind", ["left_of", "right_of", "in_front_of", "behind"])
def test_the_middle_of_a_side_a_usual_gap_and_a_usual_turn_weigh_most(kind):
    across = 0.0 if kind in ("left_of", "right_of") else np.pi / 2
    gap = 0.1 + 0.01 + 0.15 * 0.15
    places = [around(kind, degrees, gap) for degrees in (0, 8, 20, 40)]
    by_angle = weigh(f"a {kind} b", places, [across] * 4)
    assert np.all(np.diff(by_angle) < 0)
    # Two standard deviations of the turn, and of it the other way around.
    by_turn = weigh(
        f"a {kind} b", [places[0]] * 3, [across, across + np.radians(8), across + np.pi]
    )
    assert by_turn[0] - by_turn[1] > 1.9
    assert by_turn[2] == pytest.approx(by_turn[0], abs=1e-3)
    far = [around(kind, 0, each) for each in (0.1, gap, gap + 0.03, gap + 0.1)]
    by_gap = weigh(f"a {kind} b", far, [across] * 4)
    assert np.argmax(by_gap) == 1
    assert np.all(np.diff(by_gap[1:]) < 0)
    # What is as wide as long is turned as one likes.
    square = weigh(f"a {kind} b", [places[0]] * 2, [0.0, 0.7], half=(0.03, 0.03, 0.03))
    assert abs(square[0] - square[1]) < 0.5


def test_over_the_middle_weighs_most_and_far_away_is_all_alike():
    places = [(0.0, 0.0), (0.02, 0.0), (0.08, 0.0)]
    for kind in ("on", "in"):
        assert np.all(np.diff(weigh(f"a {kind} b", places, [0.3] * 3)) < 0)
    away = [(0.4, 0.0), (0.0, 0.5)]
    assert np.all(weigh("a far_from b", away, [0.2, 1.0]) == 0)


def test_a_bank_records_whether_relations_prefer():
    related = SceneSpec(relations=("fork left_of dinner_plate",), num_objects=4)
    plain = dataclasses.replace(related, relations_prefer=False)
    asked = [each.problem_config("guided").placement for each in (related, plain)]
    assert [each.relations_prefer for each in asked] == [True, False]
    records = [placement_record(each) for each in asked]
    assert records[0] == records[1] | {"relations_prefer": True}
    unrelated = SceneSpec(num_objects=4).problem_config("guided")
    assert "relations_prefer" not in placement_record(unrelated.placement)
    with pytest.raises(ConfigError, match="relations_prefer"):
        SceneSpec(relations=("fork left_of dinner_plate",), relations_prefer=1)  # type: ignore[arg-type]


def test_time_and_side_support_are_for_what_is_in_others():
    inside = SceneSpec(relations=("fork in mug",), num_objects=4).problem_config("guided")
    beside = SceneSpec(relations=("fork left_of mug",), num_objects=4).problem_config("guided")
    assert inside.stability.side_support
    assert inside.stability.decision_step == inside.stability.max_steps
    assert beside.stability == SceneSpec(num_objects=4).problem_config("guided").stability


def test_pictures_look_from_where_left_is_meant():
    region = {"center": [0.0, 0.0], "half_extents": [0.3, 0.3], "yaw": np.radians(20.0)}
    for relations, expected in (
        (["fork left_of mug"], 110.0),
        (["fork on mug"], CameraView().azimuth),
        ([], CameraView().azimuth),
    ):
        recipe = {"placement": {"relations": relations}, "region": region}
        bank = Bank(Path("bank"), {"recipe": recipe})
        assert view_of(bank).azimuth == pytest.approx(expected)


@pytest.mark.slow
def test_what_is_related_is_near_the_middle_of_its_side(tmp_path):
    asked = ("fork left_of dinner_plate", "mug behind dinner_plate")
    medians = []
    for prefers in (True, False):
        bank = generate(
            tmp_path / str(prefers),
            pool="dining",
            num_objects=6,
            relations=asked,
            relations_prefer=prefers,
            num_scenes=48,
            render=False,
            max_files=0,
        )
        away = []
        for scene in read_scenes(bank):
            place = {name: scene.poses[index] for index, name in enumerate(scene.names)}
            x, y = (place["fork"] - place["dinner_plate"])[:2]
            away.append(np.degrees(np.arctan2(abs(y), -x)))
            x, y = (place["mug"] - place["dinner_plate"])[:2]
            away.append(np.degrees(np.arctan2(abs(x), y)))
        assert len(away) >= 0.98 * 2 * 48
        medians.append(np.median(away))
    assert medians[0] <= 12 < medians[1]


@pytest.mark.slow
def test_what_goes_in_leaning_is_put_in(tmp_path):
    bank = generate(
        tmp_path / "bank",
        pool="dining",
        num_objects=4,
        relations=("fork in mug",),
        num_scenes=16,
        render=False,
        max_files=0,
    )
    scenes = list(read_scenes(bank))
    assert len(scenes) >= 14
    for scene in scenes:
        place = {name: index for index, name in enumerate(scene.names)}
        fork = corners(scene, place["fork"])
        mug = corners(scene, place["mug"])
        assert fork[:, 2].min() < mug[:, 2].mean()
        lowest = fork[fork[:, 2].argmin(), :2]
        assert MultiPoint(mug[:, :2]).convex_hull.covers(MultiPoint([lowest]))
