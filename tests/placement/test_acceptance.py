"""What is asked of a place beyond standing still: verdicts of the rules, whatever searches propose."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from cluttergen_jax.assets.facts import ObjectFacts
from cluttergen_jax.placement.related import RelatedObjects
from cluttergen_jax.placement.relations import parse_relations
from cluttergen_jax.types import Verdict
from tests.helpers.problems import made_up_rules, trio_problem, try_action

GOOD = jnp.array([0.9, 0.5, 0.5, 0.2])


def test_what_stands_on_the_wrong_side_is_unrelated():
    facts = [ObjectFacts(name, name, (0.1,) * 3, 1e-3, 0.1, "", "", 1, False) for name in "abcdef"]
    related = RelatedObjects.of(parse_relations(["a left_of b"]), (), facts)
    rules = dataclasses.replace(made_up_rules(), related=related)
    first = try_action(rules, rules.begin(jax.random.key(0)), GOOD)[0]
    for x, verdict in ((0.95, Verdict.UNRELATED), (0.7, Verdict.STABLE)):
        assert try_action(rules, first, GOOD.at[0].set(x))[0].verdict == verdict


def test_a_place_beside_a_polygon_is_outside():
    corners = jnp.array([[0.0, -0.2], [0.3, -0.2], [0.3, 0.2]])
    rules = dataclasses.replace(made_up_rules(order="fixed"), polygon=corners)
    episode = rules.begin(jax.random.key(0))
    for action, verdict in (
        ([0.9, 0.5, 0.5, 0.2], Verdict.STABLE),
        ([0.7, 0.9, 0.5, 0.2], Verdict.OUTSIDE),
    ):
        assert try_action(rules, episode, jnp.array(action))[0].verdict == verdict


@pytest.mark.parametrize(("overhang", "most"), [("none", 0.0), ("half", 0.25), ("any", 0.5)])
def test_what_reaches_too_far_beyond_the_edge_is_outside(overhang, most):
    rules = trio_problem(overhang=overhang, order="fixed", history_stride=0).rules
    episode = rules.begin(jax.random.key(0))
    poses = episode.poses
    placed = jnp.ones(3, bool)
    made = jax.eval_shape(rules.simulator.settle, poses, placed, jnp.int32(0), jnp.bool_(True))
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), made)
    # The first of the trio is 6 cm wide, and the table ends at x = 0.30.
    for share in (0.0, 0.15, 0.35, 0.6):
        pose = jnp.array([0.27 + 0.06 * share, 0, 0.75, 1, 0, 0, 0])
        settled = nothing.replace(poses=poses.at[0].set(pose))
        expected = Verdict.STABLE if share <= most else Verdict.OUTSIDE
        assert int(rules.verdict_of_place(episode, jnp.int32(0), settled)) == expected, share
