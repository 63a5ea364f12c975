"""Convex decomposition with CoACD, or one hull where that is enough."""

from __future__ import annotations

import coacd
import numpy as np

from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.deviation import hull_deviation
from cluttergen_jax.assets.merging import merged
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.solid import Solid, simplified
from cluttergen_jax.errors import AssetError


def decompose(solid: Solid, config: DecompositionConfig, jitter: float = 0.0) -> list[np.ndarray]:
    """Convex parts, f64[V, 3] each, in the solid's frame, as many vertices as CoACD and merging give them.

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
        return one
    return _run(solid, config, jitter) or one


def _run(solid: Solid, config: DecompositionConfig, jitter: float) -> list[np.ndarray]:
    mesh = simplified(solid.mesh, config.simplify * solid.diagonal)
    if jitter:
        reach, rng = jitter * solid.diagonal, np.random.default_rng(config.seed)
        mesh = Mesh(mesh.vertices + rng.uniform(-reach, reach, mesh.vertices.shape), mesh.faces)
    coacd.set_log_level("error")
    found = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=config.threshold,
        # Its own merging by number changes the object more than `merged` does.
        max_convex_hull=-1,
        preprocess_mode="off",
        resolution=config.resolution,
        mcts_nodes=config.nodes,
        mcts_iterations=config.iterations,
        mcts_max_depth=config.depth,
        seed=config.seed,
    )
    # CoACD now and then returns a sliver that Qhull refuses; the rest is whole without it.
    parts = [np.asarray(vertices, np.float64) for vertices, _ in found]
    parts = [points for points in parts if hull_of(points) is not None]
    return merged(parts, solid, config.merge, config.max_parts)
