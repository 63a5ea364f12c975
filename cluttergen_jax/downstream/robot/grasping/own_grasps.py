"""Grasps of a user's own: from a mapping, or from a Parquet file; those that were not tested are named."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.assets import ObjectAsset, object_hash
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.grasping.grasps import (
    Grasps,
    GraspSets,
    grasps_of,
    read_grasps,
)
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.protocols import GraspSource
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.own_parts import array_of

_HINT = "{'mug': (poses, widths), ...}, or a file of `cluttergen robot grasps` with --out"
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


class GraspFinder:
    """Gives objects their grasps: the user's own, or the tested ones that are kept or made.

    Args:
      own: a user's; None for those that are made. num_threads: of the tests of those.
      robot: whose hand it is; the Panda's if not given.

    Raises:
      ConfigError: `own` is no source of grasps. PoolError: a file cannot be read.
    """

    def __init__(
        self,
        own: GraspSource | GraspSets | None,
        num_threads: int,
        robot: RobotDescription | None = None,
    ) -> None:
        self._path = Path(own) if isinstance(own, str | Path) else None
        self._robot = robot or find_robot()
        self._num_threads = num_threads
        self._told = set[str]()
        self._own: Mapping[str, Any] | None = None
        if isinstance(own, GraspSets):
            self._own = {each.name: each for each in own}
        elif self._path is not None:
            self._own = _read_plain(self._path)
        elif isinstance(own, Mapping):
            self._own = own
        elif own is not None:
            raise ConfigError(f"grasps = {own!r}", "a mapping by object, or a Parquet file", _HINT)

    def __call__(self, objects: Sequence[ObjectAsset]) -> list[Grasps]:
        """The grasps of objects, in their order.

        Raises:
          ConfigError: an object has none, or they have other shapes or numbers.
        """
        if self._own is None:
            return list(grasps_of(objects, num_threads=self._num_threads, robot=self._robot))
        if missing := sorted({each.name for each in objects} - set(self._own)):
            raise ConfigError(
                f"`grasps` without any of {', '.join(missing)}", "some of each object", _HINT
            )
        found = [self._of(asset, self._own[asset.name]) for asset in objects]
        fresh = [each.name for each in found if not each.num_tested and each.name not in self._told]
        if fresh:
            self._told.update(fresh)
            print(f"grasps     not tested: your own of {', '.join(fresh)}", file=sys.stderr)
        return found

    def _of(self, asset: ObjectAsset, given: Any) -> Grasps:
        content = object_hash(asset)
        if self._path is not None:
            tested = read_grasps(self._path, asset) if given is None else None
            if tested is not None:
                given = tested
            elif given is None:
                raise PoolError(
                    f"{self._path}: grasps of another version", _HINT, "making them again"
                )
        if isinstance(given, Grasps):
            is_ours = given.gripper == self._robot.gripper.hash
            if len(given) and given.hash == content and is_ours:
                return given
            other = f"another gripper than {self._robot.name}'s"
            if given.hash != content:
                other = "another object of that name"
            what = f"those of {other}" if len(given) else "none"
            raise ConfigError(f"`grasps` of {asset.name}: {what}", "grasps of this object", _HINT)
        return _make_grasps(asset.name, content, given, self._robot)


def _read_plain(path: Path) -> dict[str, Any]:
    """Pairs of poses and widths by object; None for each object of a file of `robot grasps`."""
    try:
        table = pq.read_table(path)
        names = table["object"].to_pylist()
        if b"cluttergen_grasps" in (table.schema.metadata or {}):
            return dict.fromkeys(names)
        poses, widths = (
            np.array(table[each].to_pylist(), np.float64) for each in ("pose", "width")
        )
        return {
            name: (poses[rows], widths[rows])
            for name in dict.fromkeys(names)
            for rows in [[row for row, each in enumerate(names) if each == name]]
        }
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        allowed = "a Parquet file with columns object, pose (7 numbers) and width, or one of `robot grasps`"
        raise PoolError(f"{path}: no grasps can be read ({error})", allowed, _HINT) from error


def _make_grasps(name: str, content: str, given: Any, robot: RobotDescription) -> Grasps:
    widest = 2 * gripper_of(robot).max_opening
    try:
        pose, width = (array_of(each).astype(np.float64) for each in given)
        if pose.ndim == 3:
            if pose.shape[1:] != (4, 4) or not np.isfinite(pose).all():
                raise ValueError(f"poses of shape {pose.shape}, or not finite")
            turn = pose[:, :3, :3]
            if (
                np.abs(turn @ turn.mT - np.eye(3)).max(initial=0) > _UNIT
                or (np.linalg.det(turn) < 0).any()
            ):
                raise ValueError("poses that are no rigid transforms")
            pose = pose_of(pose)
        if pose.ndim != 2 or pose.shape[1] != 7 or width.shape != (len(pose),) or not len(pose):
            raise ValueError(f"poses of shape {pose.shape}, widths of shape {width.shape}")
        if not (np.isfinite(pose).all() and ((width >= 0) & (width <= widest)).all()):
            raise ValueError("numbers that are not finite, or a width out of range")
        if np.abs(np.linalg.norm(pose[:, 3:], axis=1) - 1).max() > _UNIT:
            raise ValueError("quaternions that are not of length 1")
    except (ValueError, TypeError) as error:
        allowed = (
            f"poses f[G, 7] or f[G, 4, 4], T_object_tool, metres, and widths f[G], 0 to {widest:g} m, "
            "G at least 1, all finite"
        )
        raise ConfigError(f"`grasps` of {name}: {error}", allowed, _HINT) from error
    nothing = np.zeros(len(pose))
    # As if the object stayed where it is between the fingers.
    held = pose_of(inverse(matrix_of(pose)))
    tested = dict.fromkeys(("shift", "slip", "turn", "margin"), nothing)
    return Grasps(
        name,
        content,
        pose,
        width,
        is_low=nothing == 0,
        num_tested=0,
        held=held,
        gripper=robot.gripper.hash,
        **tested,
    )
