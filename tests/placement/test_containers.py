"""Containers: what is in what, which objects are drawn, and scenes judged by another measure."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.sampler import make_sampler
from cluttergen_jax.placement.boxes import Boxes
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.placement.containers import draw_contents, is_contained, num_contained, pairs_in
from cluttergen_jax.placement.types import Hollows
from cluttergen_jax.spec import SceneSpec
from studies.measures import relations
from tests.helpers.problems import made_up_rules

HALF = np.array([[0.1, 0.1, 0.05], [0.02, 0.02, 0.03], [0.09, 0.01, 0.03]], np.float32)
"""A bowl, what fits into it, and what is as long as it."""
BOWL = Hollows(
    jnp.array([[0.0, 0.0, 0.01]] * 3),
    jnp.array([[0.08, 0.05, 0.04]] * 3),
    jnp.array([True, False, False]),
    jnp.array([[False] * 3, [True, False, False], [True, False, False]]),
)


def at(*place: float, up: float = 0.0) -> list[float]:
    return [*place, np.cos(up / 2), np.sin(up / 2), 0.0, 0.0]


@pytest.mark.parametrize(
    ("place", "tilt", "expected"),
    [
        ((0.0, 0.0, 0.05), 0.0, True),
        ((0.07, 0.04, 0.05), 0.0, True),
        ((0.09, 0.0, 0.05), 0.0, False),
        ((0.0, 0.06, 0.05), 0.0, False),
        ((0.0, 0.0, 0.08), 0.0, False),
        ((0.0, 0.0, -0.2), 0.0, False),
        ((0.0, 0.0, 0.02), np.pi, False),
    ],
)
def test_what_is_in_a_bowl_is_over_its_hollow_and_below_its_rim(place, tilt, expected):
    poses = jnp.array([at(0, 0, 0, up=tilt), at(*place), at(0, 0, 0)])
    boxes = Boxes.of(jnp.asarray(HALF), poses)
    is_there = jnp.array([True, True, False])
    found = is_contained(boxes, BOWL.boxes(poses), is_there, BOWL.is_container)
    assert found.tolist() == [False, expected, False]
    assert int(num_contained(HALF, BOWL, poses, is_there)) == expected


def test_what_lies_across_a_small_opening_is_not_in_it():
    poses = jnp.array([at(0, 0, 0), at(0, 0, 0.05), at(0, 0, 0.05)])
    boxes = Boxes.of(jnp.asarray(HALF), poses)
    narrow = BOWL.replace(half_extents=BOWL.half_extents * 0.7)
    assert pairs_in(boxes, narrow.boxes(poses))[1:, 0].tolist() == [True, False]


def test_contents_are_drawn_with_containers_that_have_room():
    rules = made_up_rules(5)
    fits = np.zeros((5, 5), bool)
    fits[1:4, 0] = True
    fits[2, 4] = True
    room = np.full((5, 3), 0.03)
    room[0] = 0.06
    hollows = Hollows(
        jnp.zeros((5, 3)), jnp.asarray(room), jnp.asarray(fits.any(0)), jnp.asarray(fits)
    )
    geometry = rules.geometry.replace(hollows=hollows)
    draw = jax.jit(draw_contents, static_argnums=(3, 4))
    for seed in range(4):
        drawn = draw(jax.random.key(seed), geometry, jnp.zeros(5, bool), 2, 4)
        inside, containers = (np.flatnonzero(each).tolist() for each in drawn)
        # The first one has room for two at most, and nothing is drawn twice.
        assert len(inside) == 2
        assert not set(inside) & set(containers)
        assert all(fits[each][containers].any() for each in inside)


REFUSED = [
    ({"method": "pile", "clutter": "contained=2"}, "with spread or guided"),
    ({"method": "packed", "clutter": "near=0.02"}, "or with guided or spread"),
    ({"method": "drop", "clutter": "near=0.02"}, "with spread or guided"),
    ({"method": "policy", "clutter": "occlusion=0.2"}, "with spread or guided"),
    ({"method": "packed", "poses": "resting"}, "places all objects upright"),
    ({"method": "packed", "poses": "any"}, "poses='upright'"),
    ({"method": "pile", "poses": "resting"}, "always releases objects in random orientations"),
    ({"method": "pile", "surface": "all", "support": "rack"}, "leaving it out"),
    ({"method": "pile", "relations": ("mug on bowl",)}, "with spread or guided"),
    ({"method": "packed", "relations": ("mug on bowl",)}, "with spread or guided"),
    ({"method": "packed", "tidy": True}, "with spread or guided"),
    ({"method": "pile", "start": "bank:0"}, "leaving it out"),
    ({"method": "policy", "poses": "any"}, "poses='upright'"),
]
"""Ways to clutter that do not go together, and what is said to be allowed."""


@pytest.mark.parametrize(("asked", "allowed"), REFUSED)
def test_what_does_not_go_together_is_refused_at_once(asked, allowed):
    spec = SceneSpec(num_objects=6, **asked)
    with pytest.raises(ConfigError, match=allowed):
        spec.check_method(asked["method"])


def test_more_than_there_are_others_is_refused():
    with pytest.raises(ConfigError, match="0 to 5"):
        Clutter.of("contained=6").check(6)


@pytest.mark.slow
def test_more_than_fits_is_refused():
    with pytest.raises(ConfigError, match="up to 1, in bowl"):
        make_sampler(pool="dining", num_objects=6, clutter="contained=3", method="spread")


TOGETHER = [
    {"clutter": "contained=2"},
    {"clutter": "contained=2", "poses": "resting", "method": "guided"},
    {"clutter": "contained=2,near=0.02", "support": "tote"},
    {"clutter": "contained=1,stack=2", "relations": ("knife next_to pot:0.2",)},
    {"clutter": "contained=2", "support": "bookcase", "surface": "all"},
    {"clutter": "contained=2", "support": "tilted_board_10"},
]
"""Ways to clutter that do."""


@pytest.mark.slow
@pytest.mark.parametrize("asked", TOGETHER, ids=str)
def test_objects_are_inside_of_others_by_another_measure_too(asked, monkeypatch):
    # What is tall stands in a pan with little of its surface.
    monkeypatch.setattr(relations, "SURFACE_SHARE", 0.05)
    sample = make_sampler(pool="dining+kitchen", num_objects=8, **{"method": "spread"} | asked)
    scenes = jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), 16))
    assert scenes.is_success.mean() > 0.7
    geometry = sample.problem.rules.geometry
    objects = sample.problem.world.objects
    assert geometry.hollows is not None
    wanted = int(asked["clutter"].split("=")[1][0])
    counts = []
    others = []
    for place in np.flatnonzero(scenes.is_success):
        index = np.asarray(scenes.object_index[place])
        placed = np.asarray(scenes.is_placed[place])
        hollows = geometry.hollows.take(index)
        counts.append(
            int(num_contained(geometry.half_extents[index], hollows, scenes.poses[place], placed))
        )
        here = [objects[each] for each in index]
        others.append(
            int(relations._inside(here, np.asarray(scenes.poses[place]), placed).any(1).sum())
        )
    assert np.mean(counts) == pytest.approx(wanted, abs=0.5)
    assert np.mean(others) > 0.85 * np.mean(counts)
