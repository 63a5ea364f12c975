"""Corrects masks: a pixel whose depth is that of an object at its expected pose shows that object.

A segmenter errs where light is strange. What has not been touched, or was put down with care, is mostly where
it is expected, and depth confirms that without any colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation

from cluttergen_jax.downstream.perception.classes import BACKGROUND, FIRST_OBJECT
from cluttergen_jax.downstream.perception.pose.compare import AGREES, IN_FRONT, drawn_alone
from cluttergen_jax.downstream.perception.pose.estimator import Look
from cluttergen_jax.downstream.perception.pose.models import ObjectModel

LEAST_SHARE = 0.6
"""Of the pixels of an object that should be seen: so many have to have its depth for it to count as there."""
_FEWEST = 40
"""Pixels that should be seen, below which nothing is concluded."""
_MARGIN = 6
"""Pixels about an object that is there, outside of which nothing else of its kind is."""


def as_expected(looks: Sequence[Look], expected: dict[int, tuple[ObjectModel, np.ndarray]]) -> list[Look]:
    """The looks, with corrected masks of those objects that depth shows where they are expected.

    Args:
      expected: by number, the object and its pose f64[4, 4], T_world_object.
    """
    return [_corrected(look, expected) for look in looks]


def _corrected(look: Look, expected: dict[int, tuple[ObjectModel, np.ndarray]]) -> Look:
    label, nearest = look.label.copy(), np.full(look.depth.shape, np.inf)
    for number, (model, pose) in expected.items():
        drawn = drawn_alone(model, look.camera, pose)
        is_drawn = np.isfinite(drawn)
        behind = np.where(is_drawn & np.isfinite(look.depth), look.depth, np.nan) - drawn
        near, shown = np.abs(behind) < IN_FRONT, behind > -IN_FRONT
        if shown.sum() < _FEWEST or near.sum() < LEAST_SHARE * shown.sum():
            continue
        stray = (label == FIRST_OBJECT + number) & ~binary_dilation(is_drawn, iterations=_MARGIN)
        label[stray] = BACKGROUND
        # Whatever is near to it in depth is no other object; what is said to be the table may be.
        own = near & ((np.abs(behind) < AGREES) | (label != BACKGROUND)) & (drawn < nearest)
        label[own], nearest[own] = FIRST_OBJECT + number, drawn[own]
    return replace(look, label=label)
