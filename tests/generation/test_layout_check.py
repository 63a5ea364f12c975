"""Layouts as YAML: the schema and the reader agree, and all that is wrong is said at once, with its place."""

import json

import jsonschema
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.layout_check import LayoutError, layout_schema, read_fields
from cluttergen_jax.generation.layouts import list_layouts, read_layout
from cluttergen_jax.placement.relations import KINDS, Relation

SCHEMA = jsonschema.Draft202012Validator(layout_schema())


def check(tmp_path, text, **options):
    path = tmp_path / "mine.yaml"
    path.write_text(text if isinstance(text, str) else yaml.safe_dump(text))
    return cg.check_layout(path, **options)


def paths(found):
    return [fault.path for fault in found.faults]


def is_read(content):
    """Whether the reader takes the form of a layout: its fields, and each relation."""
    _, faults = read_fields(content)
    relations = content.get("relations", ()) if isinstance(content, dict) else ()
    try:
        return not faults and all(map(Relation.parse, relations))
    except ConfigError:
        return False


# The schema and the reader

GOOD = [
    {"objects": {}},
    {"objects": {"a": "mug", "my-mug_2": "label=*mug* and mass<1"}},
    {"objects": {"a": "mug", "b": "bowl"}, "relations": ["a next_to b:0.05", "a aligned table"]},
    {"objects": {"a": "mug", "b": "bowl"}, "relations": ["a  left_of b : 2", "b under a"]},
    {"objects": {"a": "mug"}, "others": 3, "region": None, "poses": "resting", "natural": True},
    {"objects": {"a": "mug"}, "others": 3, "crowd": 0.5},
    {"objects": {"a": "mug"}, "region": "0.3x0.3", "clutter": {"stack": 1, "near": 0.02}},
    {"objects": {"a": "mug"}, "asked": {"request": "a mug", "model": "me", "tries": 2}},
    {"objects": {"a": "mug"}, "title": "", "pool": "dining+kitchen", "support": "tray"},
]
BAD = [
    [],
    "objects",
    {},
    {"objects": ["mug"]},
    {"objects": {"a": 3}},
    {"objects": {"a": ""}},
    {"objects": {"A": "mug"}},
    {"objects": {"table": "mug"}},
    {"objects": {"a": "mug"}, "relation": []},
    {"objects": {"a": "mug"}, "relations": "a on b"},
    {"objects": {"a": "mug"}, "relations": [["a", "on", "b"]]},
    {"objects": {"a": "mug"}, "relations": ["a on b"] * 65},
    {"objects": {"a": "mug"}, "others": -1},
    {"objects": {"a": "mug"}, "others": 1.5},
    {"objects": {"a": "mug"}, "others": True},
    {"objects": {"a": "mug"}, "poses": "lying"},
    {"objects": {"a": "mug"}, "natural": "yes"},
    {"objects": {"a": "mug"}, "others": 3, "crowd": 1.5},
    {"objects": {"a": "mug"}, "clutter": {"stack": "2"}},
    {"objects": {"a": "mug"}, "clutter": {"near": -1}},
    {"objects": {"a": "mug"}, "clutter": {"stak": 1}},
    {"objects": {"a": "mug"}, "support": None},
    {"objects": {"a": "mug"}, "asked": {"request": "a mug", "model": "me"}},
    {"objects": {"a": "mug"}, "asked": {"request": "a", "model": "b", "tries": 0}},
]


@pytest.mark.parametrize("content", GOOD, ids=json.dumps)
def test_what_the_schema_allows_is_read(content):
    assert SCHEMA.is_valid(content)
    assert is_read(content)


@pytest.mark.parametrize("content", BAD, ids=lambda content: json.dumps(content)[:60])
def test_what_the_schema_forbids_is_refused(content, tmp_path):
    assert not SCHEMA.is_valid(content)
    assert not check(tmp_path, content).is_sound
    with pytest.raises(ConfigError):
        read_layout(tmp_path / "mine.yaml")


@pytest.mark.parametrize("name", list_layouts())
def test_layouts_of_the_package_fulfil_the_schema_and_are_sound(name):
    SCHEMA.validate(yaml.safe_load(list_layouts()[name].read_text()))
    found = cg.check_layout(name)
    assert found.is_sound, str(found)
    assert found.spec == read_layout(name)


NAMES = st.sampled_from(["a", "b", "mug_1", "table", "any", "a:b", ""])
GAPS = st.sampled_from(["", ":0.05", ": 1", ":2.0", ":2.1", ":0", ":0.0", ":.5", ":x", ":-1", ":"])
SPACES = st.sampled_from([" ", "  ", "\t", ""])


@settings(max_examples=400, deadline=None)
@given(NAMES, SPACES, st.sampled_from([*KINDS, "under", "near", "On"]), SPACES, NAMES, GAPS)
def test_the_schema_allows_the_relations_that_are_read(one, space, kind, gap, other, distance):
    text = f"{one}{space}{kind}{gap}{other}{distance}"
    try:
        Relation.parse(text)
        is_relation = ":" not in one
    except ConfigError:
        is_relation = False
    assert SCHEMA.is_valid({"objects": {}, "relations": [text]}) == is_relation, text


def test_every_field_is_described_and_its_examples_are_valid():
    schema = layout_schema()
    json.dumps(schema)
    for name, field in schema["properties"].items():
        assert len(field["description"]) > 10, name
        for example in field.get("examples", ()):
            assert SCHEMA.is_valid({"objects": {}} | {name: example}), name


# All errors at once, each with its place

MANY = """
objects:
  laptop: lap_top
  mouse: mouse
  Coffee: mug
  cup: {a: b}
relations:
  - mouse right_of laptop:0.10
  - 7
  - mouse left_of laptop
  - mouse besides laptop
  - mouse next_to labtop
others: -1
suport: table
clutter: {stak: 2}
"""


def test_all_errors_are_said_at_once_with_their_places(tmp_path):
    found = check(tmp_path, MANY, pool="study")
    assert paths(found) == [
        "objects.Coffee",
        "objects.cup",
        "objects.laptop",
        "relations[1]",
        "relations[3]",
        "relations[4]",
        "relations[2]",
        "others",
        "clutter.stak",
        "suport",
    ]
    meant = {fault.path: fault.meant for fault in found.faults}
    assert meant["objects.laptop"] == "laptop"
    assert meant["relations[3]"] == "mouse next_to laptop:0.05"
    assert meant["relations[4]"] == "laptop"
    assert meant["clutter.stak"] == "stack"
    assert meant["suport"] == "support"
    for fault in found.faults:
        assert fault.given
        assert fault.allowed
    assert "coffee, here and in" in str(found.faults[0])
    with pytest.raises(LayoutError) as caught:
        read_layout(tmp_path / "mine.yaml", "study")
    assert len(caught.value.faults) == 7
    assert all(fault.path in str(caught.value) for fault in caught.value.faults)


def test_a_misspelt_pool_or_support_hides_no_other_error(tmp_path):
    layout = {
        "pool": "dinning",
        "support": "tabel",
        "colour": "red",
        "objects": {"a": "mugg", "b": "bowl"},
        "relations": ["a next_to xx"],
        "arrangements": ["nest bottle"],
        "region": "5by3",
        "clutter": {"stack": 50},
    }
    found = check(tmp_path, layout)
    assert paths(found) == [
        "objects.a",
        "relations[0]",
        "arrangements[0]",
        "pool",
        "support",
        "region",
        "clutter",
        "colour",
    ]
    assert found.faults[-1].meant == ""
    # Of a pool of which nothing is known, the layout's own names are.
    found = check(tmp_path, {**layout, "pool": "qqq", "relations": ["a next_to b", "a next_to xx"]})
    assert paths(found) == ["relations[1]", "pool", "support", "colour"]
    sloping = {"objects": {"a": "mug", "b": "bowl"}, "support": "tilted_board_10", "crowd": 0.5}
    assert paths(check(tmp_path, sloping)) == ["crowd"]


@pytest.mark.parametrize(
    ("condition", "meant"),
    [
        ("computer mouse", "mouse"),
        ("Computer_Mouse", "mouse"),
        ("label=*eyeglases*", "eyeglasses"),
        ("hardback", "hardback_book"),
        ("a lamp", "desk_lamp"),
    ],
)
def test_an_object_is_meant_by_what_people_call_it(tmp_path, condition, meant):
    (fault,) = check(tmp_path, {"objects": {"a": condition}}, pool="study").faults
    assert (fault.path, fault.meant) == ("objects.a", meant)


@pytest.mark.parametrize(
    ("relations", "place", "said"),
    [
        (["a left_of b", "a right_of b"], "relations[1]", "one side"),
        (["a left_of b", "a behind b"], "relations[1]", "one side"),
        (["a on b", "a next_to b"], "relations[1]", "not beside"),
        (["a in b", "a far_from b"], "relations[1]", "not beside"),
        (["a next_to b:0.1", "a far_from b:0.2"], "relations[1]", "at least 0.2 m"),
        (["a left_of b:0.1", "a far_from b"], "relations[1]", "at most 0.1 m"),
        (["a on b", "b on a"], "relations", "circle"),
        (["a on b", "b next_to c", "c behind a"], "relations", "circle"),
        (["a left_of b", "b left_of c", "a right_of c"], "relations", "left_of"),
        (["a behind b", "b behind c", "a in_front_of c"], "relations", "in_front_of"),
        (["a in b", "a in c"], "relations", "in 'b' and in 'c'"),
    ],
)
def test_relations_that_contradict_each_other_are_named(tmp_path, relations, place, said):
    layout = {"objects": {"a": "mug", "b": "bowl", "c": "dinner_plate"}, "relations": relations}
    found = check(tmp_path, layout)
    assert place in paths(found)
    assert said in str(found)


@pytest.mark.parametrize(
    "relations",
    [
        ["a left_of b", "a next_to b:0.05"],
        ["a left_of b:0.5", "a far_from b:0.2"],
        ["a in b", "b in c", "a in c"],
        ["a on b", "a in b"],
        ["a left_of b", "b left_of c", "a left_of c:0.5"],
        ["a left_of b", "b behind c"],
    ],
)
def test_relations_that_can_hold_together_are_let_be(tmp_path, relations):
    layout = {"objects": {"a": "mug", "b": "bowl", "c": "dinner_plate"}, "relations": relations}
    assert check(tmp_path, layout).is_sound


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("objects: {a: mug", "", "not YAML"),
        ("objects: {a: mug}\nobjects: {b: mug}", "", "comes twice"),
        ("objects: {a: mug}\npool: dinning", "pool", "'dining'"),
        ("objects: {a: mug}\nsupport: tabel", "support", "'table'"),
        ("objects: {a: mug}\nothers: 200", "others", "up to 128"),
        ("objects: {a: mug}\nothers: 2\ntheme: brekfast", "theme", "'breakfast'"),
        ("objects: {a: mug}\ntheme: breakfast", "theme", "others: 4"),
        ("objects: {a: mug}\nclutter: {near: 3}", "clutter.near", "0 to 1"),
        ("objects: {a: mug}\nregion: 3x3", "region", "region"),
        ("objects: {a: 'mass<x'}", "objects.a", "a number"),
        ("objects: {}", "objects", "1 to 128"),
        ("objects: {a: mug}\nposes: restin", "poses", "Did you mean 'resting'?"),
        ("objects: [{name: mug}]", "objects", "Try: objects: {my_mug: mug"),
    ],
)
def test_what_cannot_be_is_told_with_its_field(tmp_path, text, place, said):
    found = check(tmp_path, text)
    assert paths(found) == [place]
    assert said in str(found)


def test_objects_that_have_no_room_are_refused_and_those_that_hardly_have_are_noted(tmp_path):
    layout = {"objects": {f"pan_{number}": "frying_pan" for number in range(4)}, "pool": "kitchen"}
    found = check(tmp_path, layout, support="table-0.30x0.30")
    assert paths(found) == ["objects"]
    assert "4 objects that are on or in no other cover" in str(found)
    found = check(tmp_path, layout, support="table-0.45x0.45")
    assert found.is_sound
    assert "tight" in str(found)
    assert not check(tmp_path, layout, support="table-1.00x1.00").notes
    # What lies on others needs no place of its own.
    layout["relations"] = [f"pan_{number} on pan_0" for number in range(1, 4)]
    assert check(tmp_path, layout, support="table-0.30x0.30").is_sound


def test_what_is_too_large_for_walls_is_refused(tmp_path):
    layout = {"objects": {"pan": "frying_pan"}, "pool": "kitchen", "support": "bin-0.20x0.20x0.10"}
    assert "too large" in str(check(tmp_path, layout))


def test_options_go_before_what_the_layout_says(tmp_path):
    layout = {"objects": {"a": "laptop"}, "pool": "nowhere"}
    assert paths(check(tmp_path, layout)) == ["pool"]
    assert check(tmp_path, layout, pool="study").spec.pool == "study"


def test_others_of_a_theme_belong_to_it_and_what_is_named_may_be_anything(tmp_path):
    layout = {"objects": {"a": "bottle"}, "others": 4, "theme": "breakfast"}
    spec = check(tmp_path, layout | {"pool": "dining"}).spec
    assert spec.num_objects == 5
    assert {"bottle", "mug", "fork"} <= {*spec.objects}
    assert "pepper_mill" not in spec.objects


def test_how_a_layout_is_cluttered_becomes_the_request(tmp_path):
    layout = {"objects": {"a": "mug"}, "others": 4, "poses": "resting", "clutter": {"stack": 2}}
    spec = check(tmp_path, layout | {"natural": True}).spec
    assert (spec.poses, spec.natural, spec.num_objects) == ("resting", True, 5)
    assert spec.clutter.targets == {"stack": 2}
    usual = check(tmp_path, {"objects": {"a": "mug"}}).spec
    assert (usual.poses, usual.natural, usual.clutter) == ("upright", False, None)
