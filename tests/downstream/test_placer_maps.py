"""Proposals from maps: kept apart, lowered to contact, the cheapest first."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.downstream.placer.map_search import APART, best_apart, look, search
from cluttergen_jax.downstream.placer.proposers import BASELINES, GeometryPlacer, RandomPlacer, find_placer
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS, PlacementQuery, pad_map
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.heightmap import VOID, HeightMap
from cluttergen_jax.placement.search.fit import Candidates, UnderSide
from cluttergen_jax.placement.search.search import CLEARANCE, SearchConfig

HALF = 0.02
"""Half the side of the cube that is placed, metres."""


def query(heights: np.ndarray, ceilings: np.ndarray | None = None) -> PlacementQuery:
    """A cube of 4 cm over a map of cells of 1 cm, its middle at the origin."""
    corner = -np.array(heights.shape, np.float32) / 2 * 0.01
    axis = np.linspace(-HALF, HALF, 9, dtype=np.float32)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    count = len(xy)
    return PlacementQuery(
        heights=HeightMap(jnp.asarray(heights), jnp.asarray(corner), (0.01, 0.01)),
        ceilings=HeightMap(
            jnp.asarray(heights if ceilings is None else ceilings), jnp.asarray(corner), (0.01, 0.01)
        ),
        under=UnderSide(jnp.asarray(xy), jnp.full(count, -HALF), jnp.ones(count, bool), jnp.zeros(2)),
        half_extents=jnp.full(3, HALF),
        center_of_mass=jnp.zeros(3),
        own_margin=jnp.float32(HALF),
        object_cloud=jnp.zeros((1024, 3)),
        cloud=jnp.zeros((2048, 3)),
        cloud_mask=jnp.zeros(2048, bool),
        region_half_extents=jnp.array([0.2, 0.2]),
        height_range=jnp.float32(0.2),
    )


def bare() -> np.ndarray:
    heights = np.full((42, 42), VOID, np.float32)
    heights[1:-1, 1:-1] = 0.0
    return heights


def test_the_best_are_apart_as_a_plain_loop_finds_them():
    rng = np.random.default_rng(0)
    cost, xy = rng.uniform(size=60).astype(np.float32), rng.uniform(-0.08, 0.08, (60, 2)).astype(np.float32)
    expected: list[int] = []
    for index in np.argsort(cost):
        if all(np.linalg.norm(xy[index] - xy[other]) >= APART for other in expected):
            expected.append(int(index))
    found = np.asarray(best_apart(cost, xy, 5))
    assert found.tolist() == expected[:5]


def test_where_none_is_apart_the_cheapest_of_the_rest_follow():
    cost = np.array([3.0, 1.0, 2.0, 5.0], np.float32)
    assert np.asarray(best_apart(cost, np.zeros((4, 2), np.float32), 4)).tolist() == [1, 2, 0, 3]


def test_an_object_is_let_go_just_above_what_is_below_it():
    heights = bare()
    heights[21:31, 11:31] = 0.05
    candidates = Candidates(jnp.array([[-0.1, 0.0], [0.05, 0.0]]), jnp.zeros(2))
    found = jax.jit(look)(query(heights), query(heights).heights, candidates)
    assert np.asarray(found.pose[:, 2]) == pytest.approx(
        [HALF + CLEARANCE, 0.05 + HALF + CLEARANCE], abs=1e-6
    )
    assert found.cost[0] < found.cost[1]


def test_a_search_finds_the_only_hole_in_a_block():
    heights = bare()
    heights[1:-1, 1:-1] = 0.1
    heights[30:37, 5:12] = 0.0
    asked = query(heights)
    found = jax.jit(search, static_argnums=3)(
        jax.random.key(0), asked, asked.heights, SearchConfig(4096, 24, 32)
    )
    best = found.pose[jnp.argmin(found.cost)]
    assert np.asarray(best[:2]) == pytest.approx([0.125, -0.125], abs=0.015)
    assert best[2] == pytest.approx(HALF + CLEARANCE, abs=1e-6)


def test_what_is_hidden_is_free_to_one_and_taken_to_the_other():
    ceilings = bare()
    ceilings[1:21, 1:-1] = 0.3
    asked = query(bare(), ceilings)
    place = {
        unseen: jax.jit(GeometryPlacer(unseen))(jax.random.key(1), asked).pose
        for unseen in ("free", "occupied")
    }
    assert (place["occupied"][:, 0] > 0).all()
    assert (place["free"][:, 0] < 0).any()
    assert np.allclose(place["occupied"][:, 2], HALF + CLEARANCE, atol=1e-6)


@pytest.mark.parametrize("name", BASELINES)
def test_a_baseline_answers_many_queries_at_once_as_it_answers_one(name):
    placer, keys = BASELINES[name](), jax.random.split(jax.random.key(2), 3)
    heights = bare()
    heights[10:20, 10:20] = 0.04
    asked = query(heights)
    many = jax.jit(jax.vmap(placer, in_axes=(0, None)))(keys, asked)
    one = jax.jit(placer)(keys[1], asked)
    assert many.pose.shape == (3, NUM_PROPOSALS, 4)
    assert jnp.isnan(many.score).all()
    assert np.allclose(many.pose[1], one.pose, atol=1e-5)
    assert (jnp.abs(many.pose[..., :2]) <= 0.2).all()


def test_the_random_placer_looks_at_nothing():
    pose = [RandomPlacer()(jax.random.key(3), query(heights)).pose for heights in (bare(), bare() + 0.1)]
    assert np.array_equal(*pose)
    assert np.allclose(pose[0][:, 2], HALF + CLEARANCE)


def test_a_map_is_padded_at_its_far_ends():
    wide = pad_map(bare(), (50, 44))
    assert wide.shape == (50, 44)
    assert np.array_equal(wide[:42, :42], bare())
    assert (wide[42:] == VOID).all()
    assert (wide[:, 42:] == VOID).all()


def test_a_placer_that_is_none_is_refused_with_those_that_are():
    for name in ("geometri", ""):
        with pytest.raises(ConfigError, match=rf"'{name}'.*geometry.*drop"):
            find_placer(name)
