"""A scan of more than a million triangles: imported whole, in little memory."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.visuals import MAX_TRIANGLES

pytestmark = pytest.mark.slow

MAX_KILOBYTES = 4 << 20
# The largest of the command and its workers. A process counts what its parent held when it began, so
# a small one stands between the tests and the command.
MEASURE = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def scan(is_open):
    """A bumpy ball of 10 cm with a flat bottom, which is open if asked for, and noise of 20 micrometres."""
    ball = trimesh.creation.icosphere(subdivisions=8)
    x, y, z = ball.vertices.T
    radius = 0.06 * (1 + 0.25 * np.sin(5 * x) * np.cos(4 * y) + 0.1 * z)
    radius += np.random.default_rng(0).normal(0, 2e-5, len(radius))
    vertices = ball.vertices * radius[:, None]
    vertices[:, 2] = vertices[:, 2].clip(-0.045)
    is_kept = vertices[ball.faces, 2].max(1) > -0.045
    return trimesh.Trimesh(vertices, ball.faces[is_kept] if is_open else ball.faces, process=False)


@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.timeout(1200)
def test_a_million_triangles_take_less_than_four_gigabytes(tmp_path, home, is_open):
    mesh = scan(is_open)
    assert len(mesh.faces) > 1_000_000
    mesh.export(tmp_path / "stone.ply")
    command = [sys.executable, "-m", "cluttergen_jax", "import", str(tmp_path / "stone.ply")]
    # Such a scan takes about as long as an object may by default, on a slow machine longer.
    command += ["--pool", "mine", "--jobs", "1", "--no-progress", "--time-limit", "600"]
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, *command], capture_output=True, text=True, check=True
    )
    assert int(done.stdout.split()[-1]) < MAX_KILOBYTES
    (stone,) = find_pool("mine").objects
    assert stone.quality.solo_rate >= 0.99
    assert stone.quality.deviation < 0.06
    num_faces = sum(len(piece.mesh.faces) for piece in stone.pieces)
    # An open surface has a second side.
    assert num_faces <= MAX_TRIANGLES * (1 + is_open)
    assert any(f"of its {len(mesh.faces):,} triangles" in note for note in stone.notes)
