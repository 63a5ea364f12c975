"""The table of sense: which kind a label means, what is usual of it, and a table of one's own."""

from dataclasses import replace

import numpy as np
import pytest

from cluttergen_jax.assets.facts import ObjectFacts, chosen_names
from cluttergen_jax.assets.nouns import is_below, read_nouns
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.sense import (
    FREE,
    TURNS,
    UNUSUAL,
    USUAL,
    plan_shape,
    read_sense,
    sense_of,
)
from cluttergen_jax.errors import ConfigError
from tests.helpers.worlds import box, prism

TABLE = """
format: 1
kinds:
  dish: {synsets: [bowl.n.01], words: [wok of mine], on_top_of: [flat], stands: upright}
  slab: {words: [slab], turn: along, carries: never}
groups: {flat: [slab]}
themes: {dinner: [flat, dish]}
"""


def named(label="", synset="", name="thing_17"):
    size = (0.1, 0.1, 0.1)
    return ObjectFacts(name, label, size, 1e-3, 0.5, "CC0", "", 1, False, synset)


@pytest.mark.parametrize(
    ("label", "kind"),
    [
        # YCB, Google's scans, PartNet-Mobility, Objaverse, robosuite and plain words.
        ("003_cracker_box", "food box"),
        ("005_tomato_soup_can", "can"),
        ("019_pitcher_base", "jug"),
        ("035_power_drill", "tool"),
        ("043_phillips_screwdriver", "tool"),
        ("ACE_Coffee_Mug_Kristen_16_oz_cup", "cup"),
        ("Threshold_Porcelain_Serving_Bowl_Coupe_White", "bowl"),
        ("AlarmClock", "clock"),
        ("round-nut", "fastener"),
        ("jar with a lid", "jar"),
        ("roll of tape", "tape"),
        ("two teaspoons", "cutlery"),
        ("Granny Smith", "fruit"),
        ("potted cactus", "plant"),
        ("running shoe", "worn"),
        ("orange juice carton", "carton"),
        ("asset_00123", FREE),
        ("qwertz", FREE),
        ("", FREE),
    ],
)
def test_labels_are_of_a_kind(label, kind):
    assert read_sense().kind_of(named(label)) == kind


def test_a_synset_goes_before_a_label_and_a_label_before_a_name():
    sense = read_sense()
    assert sense.kind_of(named("plate", "teaspoon.n.02", "globe")) == "cutlery"
    assert sense.kind_of(named("plate", "", "globe")) == "plate"
    assert sense.kind_of(named("", "", "globe")) == "globe"
    assert sense.kind_of(named("plate", "a word that is no synset")) == "plate"


def test_every_embedded_object_has_a_kind():
    sense = read_sense()
    assert not [each.name for each in find_pool("all").facts if sense.kind_of(each) == FREE]


def test_nouns_are_closed_and_have_no_cycle():
    nouns = read_nouns()
    assert all(each in nouns.above for above in nouns.above.values() for each in above)
    for synset in nouns.above:
        assert synset not in nouns.hypernyms(synset)[1:]
        assert all(synset not in nouns.hypernyms(each) for each in nouns.above[synset])
    named_in_table = {each for kind in read_sense().kinds.values() for each in kind.synsets}
    assert named_in_table <= nouns.above.keys()


def test_nouns_are_those_of_wordnet():
    assert "fork.n.01" not in read_nouns().hypernyms("spoon.n.01")
    assert read_nouns().hypernyms("teaspoon.n.02")[:2] == ["teaspoon.n.02", "spoon.n.01"]
    assert read_nouns().senses["mouse"] == ("mouse.n.04",)
    assert is_below("", "large coffee mug", "cup.n.01")
    assert not is_below("", "large coffee mug", "plate.n.04")


def test_a_noun_chooses_objects():
    facts = find_pool("dining").facts
    assert chosen_names(facts, ("cup.n.01", "cutlery.n.02"), "dining") == ("mug", "fork")
    with pytest.raises(ConfigError, match=r"'drill\.n\.01' chooses no object of pool 'dining'"):
        chosen_names(facts, ("drill.n.01",), "dining")


def test_arrays_say_what_the_table_says():
    labels = ("dinner plate", "fork", "wine glass", "scissors", "qwertz")
    objects = [
        replace(box(f"thing_{place}", (0.05, 0.08, 0.01)), label=label)
        for place, label in enumerate(labels)
    ]
    plate, fork, glass, scissors, unknown = range(len(labels))
    found = sense_of(objects)
    assert found.kinds == ("plate", "cutlery", "wine glass", "scissors", FREE)
    np.testing.assert_array_equal(found.is_free, [0, 0, 0, 0, 1])
    assert found.weight_on[fork, plate] == np.float32(USUAL)
    assert found.weight_on[plate, fork] == found.weight_on[glass, plate] == np.float32(UNUSUAL)
    assert np.all(found.weight_on[unknown] == 1)
    assert np.all(found.weight_on[:, unknown] == 1)
    # Neighbours are mutual, and what carries nothing does so for all, those that are free too.
    np.testing.assert_array_equal(found.weight_beside, found.weight_beside.T)
    assert found.weight_beside[fork, plate] == np.float32(USUAL)
    assert found.never_carries[:, [glass, scissors]].all()
    assert not found.never_carries[:, [plate, unknown]].any()
    # The table says how a fork is turned; of a free one its shape does.
    assert TURNS[found.turn[fork]] == "towards"
    assert TURNS[found.turn[unknown]] == "edge"
    assert found.heading[unknown] % np.pi == pytest.approx(np.pi / 2)


def test_ones_own_table_replaces_it(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TABLE)
    sense = read_sense(path)
    assert sense.kind_of(named("wok of mine")) == sense.kind_of(named("soup bowl")) == "dish"
    assert sense.kind_of(named("plate")) == FREE
    assert sense.is_usual("on", "slab", "dish")
    assert not sense.is_usual("on", "dish", "slab")
    assert sense.themes == {"dinner": {"slab", "dish"}}
    assert sense.digest != read_sense().digest


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format: 1", "format: 2", "format 2. Allowed: format: 1"),
        ("on_top_of: [flat]", "on_top_of: [flta]", "'flta' in kind 'dish'.*Did you mean 'flat'"),
        ("on_top_of", "ontopof", "ontopof.*on_top_of, inside, beside"),
        ("along", "sideways", "sideways"),
        ("bowl.n.01", "bowl", "synset 'bowl'.*word.n.number"),
        ("words: [slab]", "words: [slab, Wok of mine]", "among the words of dish, slab"),
        ("flat: [slab]", "slab: [dish]", "'slab' is a kind and a group"),
        ("dinner: [flat, dish]", "dinner: [fish]", "'fish' in theme 'dinner'"),
        ("kinds:", "kinds: {", "not YAML"),
    ],
)
def test_a_table_that_is_wrong_says_where(old, new, message, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TABLE.replace(old, new))
    with pytest.raises(ConfigError, match=f"(?s){message}"):
        read_sense(path)


def test_a_table_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"no\.yaml.*Allowed: a YAML file"):
        read_sense(tmp_path / "no.yaml")


def test_themes_name_objects_and_are_refused_by_name():
    sense = read_sense()
    facts = find_pool("dining").facts
    assert "fork" in sense.in_theme("breakfast", facts, "dining")
    with pytest.raises(ConfigError, match=r"theme 'tools', .* pool 'dining'.*Allowed: breakfast"):
        sense.in_theme("tools", facts, "dining")
    with pytest.raises(ConfigError, match="Did you mean 'breakfast'"):
        sense.in_theme("breakfst", facts, "dining")


@pytest.mark.parametrize("degrees", [0, 20, 45, 130])
def test_a_box_shows_how_it_is_turned(degrees):
    corners = np.array([[-0.1, -0.03], [0.1, -0.03], [0.1, 0.03], [-0.1, 0.03], [0.0, 0.0]])
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    found = plan_shape(corners @ turn.T)
    assert found.is_box_like
    assert found.sides == pytest.approx((0.2, 0.06))
    assert np.sin(found.heading - angle) == pytest.approx(0, abs=1e-6)


def test_a_rounded_box_shows_how_it_is_turned():
    turns = np.radians(np.arange(0, 360, 5))
    corner = 0.02 * np.column_stack([np.cos(turns), np.sin(turns)])
    middles = np.array([[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]])
    found = plan_shape((middles[:, None] + corner).reshape(-1, 2))
    assert found.is_box_like
    assert found.sides == pytest.approx((0.10, 0.08))


def test_a_can_is_turned_by_its_shape():
    boxy = replace(box("boxy", (0.05, 0.03, 0.04)), label="potted meat can")
    round_one = replace(prism("tin", 0.03, 0.05), label="soup can")
    found = sense_of([boxy, round_one])
    assert found.kinds == ("can", "can")
    assert [TURNS[turn] for turn in found.turn] == ["edge", "free"]


def test_a_disc_shows_no_turn():
    angles = np.linspace(0, 2 * np.pi, 50)
    found = plan_shape(np.column_stack([np.cos(angles), np.sin(angles)]))
    assert not found.is_box_like
    assert not found.shows_turn
    assert found.fill == pytest.approx(np.pi / 4, rel=0.02)
