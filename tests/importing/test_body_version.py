"""Bodies of this code are those that the cache's version stands for: its key does not look at the code."""

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.importing.cache import BODY_VERSION
from cluttergen_jax.importing.readers import find_sources, read_shape
from cluttergen_jax.importing.solo_stability import measured_object

# By BODY_VERSION: the figures of each body below. Where the test fails after a change of code, and the new
# bodies are meant: raise BODY_VERSION and put the new figures under its number, in place of the old ones.
# Where no code was changed but a library was (its version is in the cache's key), or on another machine (the
# cup's parts are CoACD's, which is not the same on all of them): look at the difference, and put the new
# figures here, or widen the tolerance; the version stays.
FIGURES = {
    11: {
        "crate.obj": """
            1 8 160 80 0 0 0 27.3333 53.3333 59.3333 40 25 20 0.5207 -0.2296 -0.2418 26.9596 20.1549
            17.2799 12 0.7 0.7 0.7 1 6 20 1 28.38
        """,
        "bracket.stl": """
            2 16 96.0006 48 14.9999 0 -14.9999 17.2 58 68 40.0002 15 50.0001 14.8197 0.30937 -13.3934
            26.4948 13.1666 33.5293 26 0.7 0.7 0.7 1 5 50.0001 1 28.38
        """,
        "cup.ply": """
            5 56 245.294 122.647 0 0 -3.30217 119.674 150.736 150.736 40 40 45 0.798341 0.346365 -2.43686
            26.1151 24.6546 32.7279 46 0.7 0.7 0.7 1 8 45 1 28.38
        """,
    }
}


def box(size, at):
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(at))


MESHES = {
    "crate.obj": lambda: box((0.08, 0.05, 0.04), (0, 0, 0)),
    "bracket.stl": lambda: trimesh.boolean.union(
        [box((0.10, 0.03, 0.02), (0, 0, 0.01)), box((0.02, 0.03, 0.08), (-0.04, 0, 0.04))]
    ),
    "cup.ply": lambda: trimesh.boolean.difference(
        [trimesh.creation.cylinder(0.04, 0.09, sections=8), box((0.045, 0.045, 0.09), (0, 0, 0.01))]
    ),
}


def figures(asset):
    """What a change of any step from a file to a body would change: in millimetres, grams, cm^3."""
    hulls = [hull_of(part.vertices) for part in asset.parts]
    return [
        len(hulls),
        sum(len(hull.vertices) for hull in hulls),
        1e6 * sum(hull.volume for hull in hulls),
        1e3 * asset.mass,
        *(1e3 * asset.center_of_mass),
        *(1e6 * np.linalg.eigvalsh(asset.inertia)),
        *(1e3 * asset.half_extents),
        *(1e3 * asset.cloud.mean(0)),
        *(1e3 * asset.cloud[:16].std(0)),
        sum(len(piece.mesh.faces) for piece in asset.pieces),
        *np.mean([piece.rgba for piece in asset.pieces], 0),
        len(asset.resting),
        1e3 * asset.resting[0].height,
        asset.quality.solo_rate,
        asset.quality.solo_steps,
    ]


@pytest.mark.parametrize("name", MESHES)
def test_bodies_are_those_of_this_version(name, tmp_path):
    MESHES[name]().export(tmp_path / name)
    (source,) = find_sources(tmp_path / name)
    found = figures(measured_object(read_shape(source), trials=8))
    assert BODY_VERSION in FIGURES, "figures of the new version belong above"
    expected = [float(figure) for figure in FIGURES[BODY_VERSION][name].split()]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
