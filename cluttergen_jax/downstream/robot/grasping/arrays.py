"""Files of arrays and of meshes, whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from cluttergen_jax.assets import Mesh
from cluttergen_jax.files import write_atomically


def write_npz(path: Path, **arrays: Any) -> None:
    """Writes arrays by name, compressed; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())


def write_npy(path: Path, array: np.ndarray) -> None:
    """Writes one array."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    write_atomically(path, buffer.getvalue())


def write_mesh(path: Path, mesh: Mesh) -> np.ndarray:
    """Writes a mesh as OBJ; f64[3], the mean of its vertices, as a reader finds it.

    Vertices at one place are one, which readers would make of them: Contact-GraspNet has its meshes about
    this mean.
    """
    merged = trimesh.Trimesh(np.round(mesh.vertices, 7), mesh.faces, process=True)
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in merged.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in merged.faces + 1]
    data = ("\n".join(lines) + "\n").encode()
    write_atomically(path, data)
    read = trimesh.load_mesh(io.BytesIO(data), file_type="obj")
    return np.asarray(read.vertices, np.float64).mean(0)
