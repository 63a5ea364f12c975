"""The grasps of many objects as one result, and the table that is printed of them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.downstream.robot.grasping.grasps import MIN_GRASPS, Grasps, grasps_of
from cluttergen_jax.tables import aligned_table

_HEADINGS = ("object", "grasps", "low", "tested", "shift mm", "slip mm", "turn deg", "margin")


@dataclass(frozen=True, eq=False)
class GraspSets:
    """Grasps of several objects, in the order in which they were asked for.

    Attributes:
      sets: of each object.
    """

    sets: tuple[Grasps, ...]

    def __getitem__(self, name: str) -> Grasps:
        """Those of an object."""
        return next(each for each in self.sets if each.name == name)

    def __iter__(self) -> Iterator[Grasps]:
        return iter(self.sets)

    def __len__(self) -> int:
        return len(self.sets)

    @property
    def lacking(self) -> tuple[str, ...]:
        """The objects with fewer than `MIN_GRASPS`."""
        return tuple(each.name for each in self.sets if len(each) < MIN_GRASPS)

    @property
    def lifted_only(self) -> tuple[str, ...]:
        """The objects that have grasps, but none while they rest on a plane."""
        return tuple(each.name for each in self.sets if len(each) and not each.is_low.any())

    def __str__(self) -> str:
        """A row for each object, medians over its grasps; then what is missing."""
        lines = [aligned_table(_HEADINGS, [_row(each) for each in self.sets])]
        if self.lacking:
            lines.append(f"fewer than {MIN_GRASPS} grasps: {', '.join(self.lacking)}")
        if self.lifted_only:
            lines.append(f"none while it rests on a plane: {', '.join(self.lifted_only)}")
        return "\n".join(lines)


def _row(grasps: Grasps) -> tuple[str, ...]:
    counts = (grasps.name, str(len(grasps)), str(int(grasps.is_low.sum())), str(grasps.num_tested))
    if not len(grasps):
        return (*counts, "-", "-", "-", "-")
    shift, slip = 1e3 * np.median(grasps.shift), 1e3 * np.median(grasps.slip)
    turn, margin = np.degrees(np.median(grasps.turn)), np.median(grasps.margin)
    return (*counts, *(f"{each:.1f}" for each in (shift, slip, turn, margin)))


def grasp_sets(
    objects: Sequence[ObjectAsset], number: int, seed: int, num_threads: int, fresh: bool
) -> GraspSets:
    """The grasps of objects (`grasps.grasps_of`); 0 threads are as many as there are cores."""
    threads = num_threads or os.cpu_count() or 1
    return GraspSets(tuple(grasps_of(objects, number, seed, threads, fresh)))
