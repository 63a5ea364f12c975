"""Classes of pixels: what stands for the table, for the arm and for each object of a pool."""

from __future__ import annotations

BACKGROUND, ARM, FIRST_OBJECT = 0, 1, 2
"""The table, the floor and all else; the robot; then object k of a pool as 2 + k."""


def num_classes(num_objects: int) -> int:
    """Classes where a pool has so many objects."""
    return FIRST_OBJECT + num_objects
