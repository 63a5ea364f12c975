"""Voxels: a flood never slips through a closed surface, and water stays where it should."""

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.solid import Voxels, scan_lines
from cluttergen_jax.importing.readers.primitives import box


def as_mesh(tri):
    return Mesh(tri.vertices, tri.faces)


def random_rotation(seed):
    return trimesh.transformations.random_rotation_matrix(
        np.random.default_rng(seed).uniform(size=3)
    )[:3, :3]


def open_box(half=(0.05, 0.04, 0.03), wall=0.004):
    """A box without a lid: five overlapping slabs."""
    x, y, z = half
    slabs = [((x, y, wall), (0, 0, wall))]
    slabs += [((wall, y, z), (side * (x - wall), 0, z)) for side in (-1, 1)]
    slabs += [((x, wall, z), (0, side * (y - wall), z)) for side in (-1, 1)]
    return join_meshes(
        [Mesh(box(np.array(h)).vertices + c, box(np.array(h)).faces) for h, c in slabs]
    )


@pytest.mark.parametrize("seed", range(12))
def test_a_closed_surface_does_not_leak(seed):
    rng = np.random.default_rng(seed)
    tri = [
        trimesh.creation.icosphere(2, 0.05),
        trimesh.creation.cylinder(0.03, 0.12, sections=int(rng.integers(3, 200))),
        trimesh.creation.box(rng.uniform(0.02, 0.2, 3)),
        trimesh.convex.convex_hull(rng.normal(size=(30, 3))),
    ][seed % 4]
    mesh = as_mesh(tri).transform(random_rotation(seed), rng.normal(size=3))
    voxels = Voxels.of(mesh, 40)
    filled = voxels.solid.sum() * voxels.pitch**3
    skin = voxels.surface.sum() * voxels.pitch**3
    assert filled - skin <= tri.volume <= filled
    assert filled - skin > 0.5 * tri.volume


@pytest.mark.parametrize("seed", range(5))
def test_samples_are_as_near_as_promised(seed):
    rng = np.random.default_rng(seed)
    # Slivers, needles and plain triangles.
    corners = rng.normal(size=(3, 3)) * [1, 10.0 ** -(seed - 1), 1]
    mesh = Mesh(corners, [[0, 1, 2]])
    samples = scan_lines(mesh, 0.035, 0.06)
    weights = rng.dirichlet((0.5, 0.5, 0.5), 500)
    distance = np.linalg.norm((weights @ corners)[:, None] - samples, axis=2).min(1)
    assert distance.max() <= np.hypot(0.035, 0.03) + 1e-9


def test_water_stays_in_an_open_box_and_nowhere_else():
    mesh = open_box()
    voxels = Voxels.of(mesh, 60)
    water = voxels.water().sum() * voxels.pitch**3
    inside = (0.1 - 0.016) * (0.08 - 0.016) * (0.06 - 0.008)
    assert 0.75 * inside < water <= inside
    upside_down = mesh.transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    assert Voxels.of(upside_down, 60).water().sum() == 0
    assert Voxels.of(box(np.array([0.05, 0.04, 0.03])), 60).water().sum() == 0
