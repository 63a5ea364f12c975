"""Proposals from maps: kept apart, lowered to contact, the cheapest first."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.downstream.placer.map_search import APART, best_apart, search
from cluttergen_jax.downstream.placer.proposers import GeometryPlacer
from cluttergen_jax.downstream.placer.query import PlacementQuery
from cluttergen_jax.placement.heightmap import VOID, HeightMap
from cluttergen_jax.placement.search import CLEARANCE, SearchConfig, UnderSide

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
            jnp.asarray(heights if ceilings is None else ceilings),
            jnp.asarray(corner),
            (0.01, 0.01),
        ),
        under=UnderSide(
            jnp.asarray(xy), jnp.full(count, -HALF), jnp.ones(count, bool), jnp.zeros(2)
        ),
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
    cost = rng.uniform(size=60).astype(np.float32)
    xy = rng.uniform(-0.08, 0.08, (60, 2)).astype(np.float32)
    expected: list[int] = []
    for index in np.argsort(cost):
        if all(np.linalg.norm(xy[index] - xy[other]) >= APART for other in expected):
            expected.append(int(index))
    found = np.asarray(best_apart(cost, xy, 5))
    assert found.tolist() == expected[:5]


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
