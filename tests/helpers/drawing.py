"""Two cubes to draw, and whether this machine can draw at all."""

from __future__ import annotations

from dataclasses import replace

import pytest
import trimesh

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.rendering.gl import renderer_status
from tests.helpers.worlds import box

IS_DRAWING, STATUS = renderer_status()
needs_gl = pytest.mark.skipif(not IS_DRAWING, reason=f"nothing here can draw: {STATUS}")


def cube(name: str, half: float, rgba: tuple[float, float, float, float]) -> ObjectAsset:
    """A cube of one colour."""
    surface = trimesh.creation.box((2 * half,) * 3)
    return replace(
        box(name, (half,) * 3), pieces=(Piece(Mesh(surface.vertices, surface.faces), rgba),)
    )


RED = cube("red", 0.05, (0.9, 0.1, 0.1, 1.0))
GREEN = cube("green", 0.04, (0.1, 0.8, 0.1, 1.0))
