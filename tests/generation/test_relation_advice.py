"""What is said where scenes fail at relations: which, how often, by which verdicts, and what helps."""

from __future__ import annotations

import re
from types import SimpleNamespace

import jax.numpy as jnp
import pyarrow as pa
import pytest

from cluttergen_jax.generation.relation_advice import advice_on, relation_notes
from cluttergen_jax.placement.related import IN
from cluttergen_jax.placement.relations import Relation
from cluttergen_jax.placement.types import Hollows
from cluttergen_jax.scene.bank.relation_tally import RelationFailures, RelationTally
from cluttergen_jax.scene.bank.table import COUNTED, count_column
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import box

RELATIONS = ["pen in mug", "mug left_of plate:0.15"]


def row(attempts, is_filled, **counts):
    """A scene of mug, plate and pen, with an object without a role."""
    verdicts = {count_column(each): 0 for each in COUNTED}
    verdicts |= {count_column(Verdict[name.upper()]): number for name, number in counts.items()}
    objects = ["plate", "mug", "pen", "box"]
    return {"objects": objects, "attempts": attempts, "is_filled": is_filled, **verdicts}


def tally_of(rows, relations=RELATIONS):
    bank = SimpleNamespace(
        path="bank",
        recipe={"placement": {"relations": relations}},
        object=lambda name: box(name, (0.01, 0.01, 0.01)),
    )
    tally = RelationTally(bank)
    tally.add(pa.Table.from_pylist(rows))
    return tally.failures()


def test_scenes_fail_at_the_object_that_took_most_attempts():
    found = tally_of(
        [
            row([1, 1, 30, 0], False, stable=2, unsettled=10, displaced=20),
            row([1, 1, 25, 1], False, stable=3, unrelated=24, unsettled=1),
            row([1, 9, 2, 0], False, stable=1, outside=9),
            row([1, 1, 1, 20], False, stable=3, displaced=20),
            row([1, 1, 1, 1], True, stable=4),
        ]
    )
    assert [(each.relation, each.scenes, each.total) for each in found] == [
        ("pen in mug", 2, 5),
        ("mug left_of plate:0.15", 1, 5),
    ]
    assert found[0].verdicts == {"unrelated": 24, "displaced": 20, "unsettled": 11}
    assert "'pen in mug' failed in 2 of 5 scenes" in found[0].line()
    assert "24 unrelated" in found[0].line()


def test_nothing_is_said_without_relations():
    assert tally_of([row([1, 1, 9, 0], False, unsettled=9)], []) == ()


@pytest.mark.parametrize(
    ("relation", "words"),
    [
        ("pen in mug", "larger container than mug"),
        ("pen on mug", "wider, flatter or heavier mug"),
        ("pen left_of mug:0.15", "pen left_of mug:0.3"),
        ("pen next_to mug:0.05", "pen next_to mug:0.1"),
        ("pen far_from mug:0.2", "pen far_from mug:0.1"),
        ("pen aligned table", "budget"),
    ],
)
def test_advice_is_of_the_relation_and_what_it_quotes_can_be_asked_for(relation, words):
    said = advice_on(RelationFailures(relation, 5, 8, {"unsettled": 9, "fell": 1}))
    assert words in said
    assert "mostly unsettled" in said
    for quoted in re.findall(r"'([^']+)'", said):
        Relation.parse(quoted)


def problem_of(goes_in, half):
    """A pen and a cup, as what is related of them knows them."""
    related = SimpleNamespace(
        goes_in=jnp.array([[True, goes_in], [True, True]]),
        candidates=jnp.array([[False, True], [True, False]]),
        kind=jnp.array([IN]),
        subject=jnp.array([1]),
        reference=jnp.array([0]),
    )
    hollows = Hollows(
        jnp.zeros((2, 3)),
        jnp.full((2, 3), 0.03),
        jnp.array([False, True]),
        jnp.zeros((2, 2), bool),
    )
    return SimpleNamespace(
        rules=SimpleNamespace(related=related, geometry=SimpleNamespace(hollows=hollows)),
        config=SimpleNamespace(placement=SimpleNamespace(relations=("pen in cup",))),
        world=SimpleNamespace(
            names=("pen", "cup"),
            objects=(box("pen", half), box("cup", (0.035, 0.035, 0.05))),
        ),
    )


def test_what_does_not_go_in_is_told_with_the_sizes_of_both():
    (wide,) = relation_notes(problem_of(False, (0.05, 0.04, 0.044)))
    assert "its shorter sides, 80 x 88 mm, are wider than the opening of cup, 60 x 60 mm" in wide
    (lost,) = relation_notes(problem_of(False, (0.1, 0.005, 0.005)))
    assert "none came to rest inside" in lost
    assert not list(relation_notes(problem_of(True, (0.1, 0.005, 0.005))))
