"""COLLADA polygons: pycollada cuts each into a fan; here those that a fan would fold are cut otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
from collada.polylist import Polylist
from collada.triangleset import TriangleSet

from cluttergen_jax.importing.readers.polygons import CROSSING, cuts


@contextmanager
def dae_polygons_cut() -> Iterator[list[str]]:
    """While it is open, pycollada's polygons become triangles that do not lie over each other.

    Yields:
      What there is to say of the polygons, once they are read.
    """
    notes: list[str] = []
    fanned = Polylist.triangleset

    def triangleset(polylist: Any) -> Any:
        if polylist._triangleset is None and (corners := _corners(polylist, notes)) is not None:
            index = polylist.index[corners.reshape(-1)].reshape(-1)
            polylist._triangleset = TriangleSet(polylist.sources, polylist.material, index, polylist.xmlnode)
        return fanned(polylist)

    with patch.object(Polylist, "triangleset", triangleset):
        yield notes


def _corners(polylist: Any, notes: list[str]) -> np.ndarray | None:
    """i64[F, 3]: rows of the list's index that make its triangles; None where fans will do."""
    named, points = polylist.vertex_index, polylist.vertex
    if named is None or points is None or not len(named) or min(polylist.vcounts) < 3:
        return None
    if named.min() < 0 or named.max() >= len(points):
        return None
    starts = polylist.polyindex[:, 0]
    polygons = [named[start:end] for start, end in polylist.polyindex]
    found, is_crossing = cuts(np.asarray(points, np.float64), polygons)
    if is_crossing and CROSSING not in notes:
        notes.append(CROSSING)
    if not found:
        return None
    fans = {n: np.array([[0, i + 1, i + 2] for i in range(n - 2)]) for n in set(polylist.vcounts.tolist())}
    return np.concatenate(
        [start + found.get(i, fans[len(polygons[i])]) for i, start in enumerate(starts.tolist())]
    )
