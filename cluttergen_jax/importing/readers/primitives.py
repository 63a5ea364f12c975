"""Boxes, cylinders, spheres, capsules, ellipsoids and height fields as meshes."""

from __future__ import annotations

import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh


def box(half_extents: np.ndarray) -> Mesh:
    """A box centred on the origin."""
    return _mesh(trimesh.creation.box(2 * np.asarray(half_extents, np.float64)))


def cylinder(radius: float, half_height: float, sections: int = 32) -> Mesh:
    """A cylinder along z, centred on the origin."""
    return _mesh(trimesh.creation.cylinder(radius, 2 * half_height, sections=sections))


def ellipsoid(radii: np.ndarray) -> Mesh:
    """An ellipsoid centred on the origin; equal radii make a sphere."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return Mesh(ball.vertices * np.asarray(radii, np.float64), ball.faces)


def capsule(radius: float, half_height: float) -> Mesh:
    """A capsule along z, centred on the origin; `half_height` is that of its cylinder."""
    tri = trimesh.creation.capsule(height=2 * half_height, radius=radius, count=(16, 16))
    tri.apply_translation(-tri.bounds.mean(0))
    return _mesh(tri)


def height_field(heights: np.ndarray, half_x: float, half_y: float, base: float) -> Mesh:
    """The ground under a grid of heights as a closed mesh, down to z = -base.

    Args:
      heights: f[R, C], metres, at least 2 x 2; columns run along x, rows along y, evenly from -half to +half.
    """
    rows, columns = heights.shape
    y, x = np.meshgrid(
        np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij"
    )
    top = np.stack([x, y, heights], axis=-1).reshape(-1, 3)
    bottom = top * [1, 1, 0] - [0, 0, base]
    index = np.arange(rows * columns).reshape(rows, columns)
    a = index[:-1, :-1]
    b = index[:-1, 1:]
    c = index[1:, 1:]
    d = index[1:, :-1]
    upper = np.concatenate(
        [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))]
    )
    # The outline, counter-clockwise seen from above, each point once.
    rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    after = np.roll(rim, -1)
    below = rows * columns
    sides = [
        np.stack(each, axis=-1)
        for each in ((rim, rim + below, after), (after, rim + below, after + below))
    ]
    return Mesh(
        np.concatenate([top, bottom]), np.concatenate([upper, upper[:, ::-1] + below, *sides])
    )


def _mesh(tri: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(tri.vertices), np.asarray(tri.faces))
