"""The hollows of cups, bowls and pots, found in their collision parts."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from cluttergen_jax.assets.hollow import find_hollow
from cluttergen_jax.assets.mesh import joined
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.solid import Solid


class Hollow:
    """The space that would hold water in an object that stands upright, object frame.

    Args:
      points: f64[P, 3], a cubic grid of points inside, metres; pitch: its step.
    """

    def __init__(self, points: np.ndarray, pitch: float) -> None:
        self._tree, self._reach = cKDTree(points), 0.5001 * pitch

    def holds(self, points: np.ndarray) -> np.ndarray:
        """bool[M]: which points f[M, 3] of the object frame lie in the hollow, to within a cell."""
        return self._tree.query(points, p=np.inf, distance_upper_bound=self._reach)[0] <= self._reach


def vessel_of(asset: ObjectAsset) -> Hollow | None:
    """An object's hollow, or None if it has none.

    By the importer's rule (`assets.hollow`): as deep as 15 mm and a fifth of its width, and open to a ball of
    10 mm. A plate is no vessel.
    """
    mesh = joined([part.hull() for part in asset.parts])
    hollow = find_hollow(Solid(mesh, True, mesh))
    return None if hollow is None else Hollow(hollow.points, hollow.pitch)
