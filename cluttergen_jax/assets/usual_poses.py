"""How often people leave an object in which of its resting poses, judged by its shape.

An object's own frame is how it stands in use: import turns it so (`--up auto`). What lies in use, such as a
fork or a book, lies in its frame. Other poses are rare, and which of them occur at all follows from measured
facts: whether the object is flat, tall, hollow, or much the same on all sides.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from cluttergen_jax.assets.hollow import hollow_of
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.geometry import rotation_matrix

Way = Literal["upright", "lying", "any"]
"""What a table of knowledge may say of an object: always as its frame has it, mostly on its largest side, or
as often as it falls so."""

# Share of the releases in other poses than the object's own.
_RARELY = 0.02
_HOLLOW = 0.03
_TALL_LIES = 0.08
_FLAT_IS_TURNED = 0.05
_STANDS_UP = 0.05
"""Of what lies by the table's word."""

# Height over the longer side in plan from which an object is tall, and up to which it is flat; by how much
# sides may differ of what is the same on all sides; what lies is so much lower, or higher, than its frame.
_TALL = 1.3
_FLAT = 0.35
_SAME = 1.15
_LOWER = 0.75
_AS_LOW = 1.25


def usual_weights(
    asset: ObjectAsset, quaternions: np.ndarray, likelihood: np.ndarray, way: Way | None = None
) -> np.ndarray:
    """f64[P], which sum to one: how often an object is left in each of its resting poses.

    Args:
      quaternions: f64[P, 4], wxyz, from the object frame; the first is the object's own frame.
      likelihood: f64[P], how often random releases end in each.
      way: what is known of such things, where it is: it comes before what the shape suggests.
    """
    height = np.array([np.ptp(asset.vertices @ rotation_matrix(each)[2]) for each in quaternions])
    likelihood = np.asarray(likelihood, float)
    sides = 2 * np.asarray(asset.half_extents)
    if way == "any" or (way is None and sides.max() < _SAME * sides.min()):
        return likelihood / likelihood.sum()
    if way == "lying":
        lies = height <= height.min() * _AS_LOW
        return _share_out(lies, likelihood, _STANDS_UP)
    own = np.arange(len(height)) == 0
    if way == "upright":
        return own.astype(float)
    share = _RARELY
    other = ~own
    if hollow_of(asset) is not None:
        share = _HOLLOW
    elif sides[2] <= min(_FLAT * sides.max(), sides.min()):
        share = _FLAT_IS_TURNED
        other &= height <= height[0] * _AS_LOW
    elif sides[2] >= _TALL * sides[:2].max():
        share = _TALL_LIES
        other &= height <= height[0] * _LOWER
    if not other.any():
        return own.astype(float)
    others = np.where(other, likelihood, 0.0)
    return np.where(own, 1 - share, share * others / others.sum())


def _share_out(is_usual: np.ndarray, likelihood: np.ndarray, rest: float) -> np.ndarray:
    """f64[P]: the share `rest` is that of all that are not usual; each in proportion to its likelihood."""
    usual = np.where(is_usual, likelihood, 0.0)
    other = likelihood - usual
    if not other.any():
        return usual / usual.sum()
    return (1 - rest) * usual / usual.sum() + rest * other / other.sum()
