"""NumPy's files, whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.files import write_atomically


def write_npz(path: Path, **arrays: Any) -> None:
    """Writes arrays by name, compressed; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())


def write_npy(path: Path, array: np.ndarray) -> None:
    """Writes one array."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    write_atomically(path, buffer.getvalue())
