"""Whether the pieces of an object touch one another."""

from __future__ import annotations

import manifold3d
import numpy as np

from cluttergen_jax.assets.solid import Solid

_SHARE = 0.02
"""Of an object's size: what is nearer, as a drawer to its frame, touches; what is smaller is no piece."""
_MOST_PIECES = 50


def gap_alarm(solid: Solid) -> str:
    """How far pieces of an object are from all others, in words; empty if each touches another."""
    gaps = piece_gaps(solid)
    if not gaps:
        return ""
    pieces = "a piece does" if len(gaps) == 1 else f"{len(gaps)} pieces do"
    return f"{pieces} not touch the rest of it: the gap is {1000 * max(gaps):.0f} mm"


def piece_gaps(solid: Solid) -> list[float]:
    """Metres from each piece, but the first, to the nearest one before it, where they do not touch."""
    least = _SHARE * solid.diagonal
    pieces = sorted((each for each in solid.shells() if _size(each) > least), key=_size)
    left = dict(enumerate(pieces[-_MOST_PIECES:]))
    distance = {len(left) - 1: 0.0}
    gaps: list[float] = []
    while left:
        near = min(left, key=lambda index: distance.get(index, np.inf))
        shell = left.pop(near)
        gaps += [distance[near]] if distance[near] > least else []
        for index, other in left.items():
            distance[index] = min(distance.get(index, np.inf), shell.min_gap(other, 2 * solid.diagonal))
    return gaps


def _size(shell: manifold3d.Manifold) -> float:
    """Metres across the box around it."""
    box = np.array(shell.bounding_box())
    return float(np.linalg.norm(box[3:] - box[:3]))
