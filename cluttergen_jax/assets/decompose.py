"""Convex decomposition with CoACD, or one hull where that is enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import coacd
import numpy as np

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.deviation import hull_deviation
from cluttergen_jax.assets.merging import ALWAYS, FEW, merge_parts, parts_enough
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.solid import Solid, simplified
from cluttergen_jax.errors import AssetError

_MOST_RAW = 96
_LIMITS = (0.055, 0.05, 0.045, 0.03, ALWAYS)
"""How far from the surface, over the diagonal, merged parts may be, in the order in which it is tried. The
distance is an estimate: what is made of it is measured again."""


def decompose(solid: Solid, config: DecompositionConfig, jitter: float = 0.0) -> list[np.ndarray]:
    """The first of `decompositions`."""
    return next(decompositions(solid, config, jitter))


def decompositions(
    solid: Solid, config: DecompositionConfig, jitter: float = 0.0
) -> Iterator[list[np.ndarray]]:
    """Sets of convex parts, f64[V, 3] each, in the solid's frame: first the fewest, then nearer ones.

    They have as many vertices as CoACD and merging give them.

    Args:
      jitter: share of the diagonal by which each vertex that CoACD sees is moved at most, always in the same
        way. There are closed meshes over which it crashes or never ends, and the slightest change helps.

    Raises:
      AssetError: neither CoACD nor Qhull can make anything of the mesh.
    """
    hull = hull_of(solid.mesh.vertices)
    if hull is None:
        raise AssetError(
            "a mesh so flat that it has no convex hull", "a mesh of an object with some thickness"
        )
    one = [solid.mesh.vertices[hull.vertices]]
    is_convex = solid.volume >= config.one_hull_volume * hull.volume
    if config.max_parts == 1 or (is_convex and hull_deviation(one[0], solid) <= config.one_hull_deviation):
        yield one
        return
    enough = parts_enough(solid)
    sets = merge_parts(_run(solid, config, jitter), solid, _LIMITS, enough, config.max_parts)
    first, is_few = sets[0] or one, len(sets[0]) <= enough
    if is_few:
        yield first
    # Which cuts leave few parts of a can is a matter of luck.
    for other in _others(config) if enough == FEW and len(first) <= 2 * FEW else ():
        (few,) = merge_parts(_run(solid, other, jitter), solid, _LIMITS[:1], enough, config.max_parts)
        if 0 < len(few) <= enough:
            yield few
    if not is_few:
        yield first
    for fewer, more in pairwise(sets):
        if len(more) > len(fewer):
            yield more


def _others(config: DecompositionConfig) -> list[DecompositionConfig]:
    tries = ((1, 1.0), (0, 4 / 3), (1, 4 / 3))[: config.tries]
    return [
        replace(config, seed=config.seed + seed, threshold=min(factor * config.threshold, 1.0))
        for seed, factor in tries
    ]


def _run(solid: Solid, config: DecompositionConfig, jitter: float) -> list[np.ndarray]:
    mesh = simplified(solid.mesh, config.simplify * solid.diagonal)
    if jitter:
        reach, rng = jitter * solid.diagonal, np.random.default_rng(config.seed)
        mesh = Mesh(mesh.vertices + rng.uniform(-reach, reach, mesh.vertices.shape), mesh.faces)
    coacd.set_log_level("error")
    found = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=config.threshold,
        # Its own merging changes the object more than `merge_parts` does, but is far faster.
        max_convex_hull=_MOST_RAW,
        preprocess_mode="off",
        resolution=config.resolution,
        mcts_nodes=config.nodes,
        mcts_iterations=config.iterations,
        mcts_max_depth=config.depth,
        seed=config.seed,
    )
    # CoACD now and then returns a sliver that Qhull refuses; the rest is whole without it.
    parts = [np.asarray(vertices, np.float64) for vertices, _ in found]
    return [points for points in parts if hull_of(points) is not None]
