"""Refusing shapes whose size betrays a wrong unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cluttergen_jax.assets.mesh import joined
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import AssetError

MIN_SIZE = 0.005
MAX_SIZE = 2.0
_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "tenths of a millimetre": 0.0001}


def check_shape(shape: Shape, path: Path) -> None:
    """Raises AssetError if the shape is empty, not finite, or its largest side is not that of an object."""
    meshes = [piece.mesh for piece in shape.pieces]
    if not any(len(mesh.faces) for mesh in meshes):
        raise AssetError(f"{path} holds no triangles", "a surface mesh, not points or curves")
    whole = joined(meshes)
    if not np.isfinite(whole.vertices).all():
        raise AssetError(f"{path} has vertices that are not finite numbers")
    used = whole.vertices[np.unique(whole.faces)]
    size = float(np.ptp(used, axis=0).max())
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise AssetError(
            f"{path}: {shape.label!r} is {size:.3g} m across",
            f"a largest side between {MIN_SIZE * 1000:g} mm and {MAX_SIZE:g} m",
            _likely_cause(size),
        )


def _likely_cause(size: float) -> str:
    """Which unit would make this an object of 2 cm to 60 cm, in words that name the option."""
    if size < MIN_SIZE:
        return "`scale` with the factor to metres; a scale may have been applied twice"
    fitting = [
        f"scale={factor:g} if the file is in {unit} ({size * factor:.2g} m across)"
        for unit, factor in _UNITS.items()
        if 0.02 <= size * factor <= 0.6
    ]
    return " or ".join(fitting) or "`scale` with the factor from the file's unit to metres"
