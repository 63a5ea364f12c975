"""Verified grasps of objects, made once for each and kept on disk.

A file is called after the object and the hash of its content, so pools that share an object share its grasps,
and an object that is changed is looked at anew; and after that of the gripper. Files lie in `grasps` beside
the user's own pools.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mujoco.rollout import Rollout

from cluttergen_jax.assets import ObjectAsset, object_hash, user_root
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.grasping.candidates import (
    GraspCandidates,
    candidates_of,
    spread,
)
from cluttergen_jax.downstream.robot.grasping.grasp_check import MAX_LOAD, GraspCheck, check_grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.protocols import GraspSource
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.own_parts import array_of
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import Trail, contact_sheet, render_object
from cluttergen_jax.schema import (
    Numbers,
    SchemaError,
    check_numbers,
    read_sealed_parquet,
    sealed_parquet,
)
from cluttergen_jax.tables import aligned_table

MIN_GRASPS = 8
"""As many an object needs; one with fewer is named."""
_VERSION = 5
_NUM_LINES = 6000
# Candidates that are tested at most, for each grasp that is wanted; and at least, where few are wanted.
_CANDIDATES = 4
_LEAST_CANDIDATES = 128

_AT_ONCE = 16
_SHORT = np.eye(4)
_SHORT[2, 3] = -0.002
"""A hand that stops 2 mm short has to hold the object, too: what it has by an edge alone slips out."""
_POSES = {"pose": "T_object_tool, metres, wxyz", "held": "T_tool_object once lifted, metres, wxyz"}
_COLUMNS = {
    "width": "metres",
    "shift": "metres",
    "slip": "metres",
    "turn": "radians",
    "margin": "weights",
}


@dataclass(frozen=True, eq=False)
class Grasps:
    """G verified grasps of one object, spread over it.

    Attributes:
      name: of the object. hash: of its content. gripper: of the gripper's description.
      pose: f64[G, 7], T_object_tool: z is the approach, y the direction in which the fingers close.
      width: f64[G], metres between the fingers.
      shift: f64[G], metres by which the closing fingers moved the object as it floated.
      slip, turn: f64[G], metres and radians that it slipped in the test.
      margin: f64[G], times its weight that it held, at most `grasp_check.MAX_LOAD`.
      is_low: bool[G], the hand can come there while the object rests on a plane.
      num_tested: candidates that were tested.
      held: f64[G, 7], T_tool_object after the fingers have closed and the object was lifted.
    """

    name: str
    hash: str
    pose: np.ndarray
    width: np.ndarray
    shift: np.ndarray
    slip: np.ndarray
    turn: np.ndarray
    margin: np.ndarray
    is_low: np.ndarray
    num_tested: int
    held: np.ndarray
    gripper: str = ""

    def __len__(self) -> int:
        return len(self.width)

    @cached_property
    def digest(self) -> str:
        """Equal for equal grasps of equal objects."""
        arrays = (getattr(self, name) for name in (*_POSES, *_COLUMNS, "is_low"))
        parts = [self.hash.encode(), *(np.ascontiguousarray(array).tobytes() for array in arrays)]
        return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def make_grasps(
    asset: ObjectAsset, number: int, seed: int, pool: Rollout, robot: RobotDescription
) -> Grasps:
    """Draws candidates for an object and tests them until `number` hold; of those the low ones come first.

    Args:
      pool: MuJoCo's threads; their number changes nothing.
      robot: whose hand it is.
    """
    content = object_hash(asset)
    # An object's own numbers, whatever pool it is in.
    rng = np.random.default_rng([seed, int(content[:12], 16)])
    candidates = candidates_of(
        asset, max(_CANDIDATES * number, _LEAST_CANDIDATES), _NUM_LINES, rng, robot
    )
    tests: list[GraspCheck] = []
    num_tested = 0
    missing = number
    while missing > 0 and num_tested < len(candidates.width):
        # Few where few are missing, but not one by one, which would leave threads idle.
        batch = candidates.take(
            slice(num_tested, num_tested + min(_AT_ONCE, max(missing, _AT_ONCE // 2)))
        )
        tests.append(verify_grasps(asset, batch, pool, robot))
        num_tested = num_tested + len(batch.width)
        missing = missing - int(tests[-1].is_held.sum())
    result = GraspCheck(*(np.concatenate(each) for each in zip(_NO_TEST, *tests, strict=True)))
    held = np.flatnonzero(result.is_held)
    chosen = held[spread(candidates.pose[held], min(number, len(held)), rng)]
    chosen = chosen[np.argsort(~candidates.is_low[chosen], kind="stable")]
    return Grasps(
        name=asset.name,
        hash=content,
        pose=pose_of(candidates.pose[chosen]),
        width=candidates.width[chosen],
        is_low=candidates.is_low[chosen],
        num_tested=num_tested,
        gripper=robot.gripper.hash,
        **{
            name: getattr(result, name)[chosen]
            for name in ("shift", "slip", "turn", "margin", "held")
        },
    )


def verify_grasps(
    asset: ObjectAsset,
    candidates: GraspCandidates,
    pool: Rollout,
    robot: RobotDescription,
) -> GraspCheck:
    """`check_grasps`, passed where the hand also holds the object 2 mm short of the grasp."""
    test = check_grasps(asset, candidates, pool, robot=robot)
    held = np.flatnonzero(test.is_held)
    if len(held):
        short = candidates.take(held)
        short = short._replace(pose=short.pose @ _SHORT)
        test.is_held[held] = check_grasps(asset, short, pool, True, robot).is_held
    return test


_NO_TEST = GraspCheck(np.zeros(0, bool), *(np.zeros(0),) * 4, np.zeros((0, 7)))


def grasp_file(
    asset: ObjectAsset, number: int, seed: int, robot: RobotDescription | None = None
) -> Path:
    """Where the grasps of an object are kept; robot: whose hand it is, the Panda's if not given."""
    gripper = (robot or find_robot()).gripper.hash
    name = f"{asset.name}-{object_hash(asset)[:16]}-{gripper[:8]}-{number}-{seed}.parquet"
    return user_root().with_name("grasps") / name


def grasps_of(
    objects: Sequence[ObjectAsset],
    number: int = 64,
    seed: int = 0,
    num_threads: int = 1,
    fresh: bool = False,
    robot: RobotDescription | None = None,
) -> Iterator[Grasps]:
    """The grasps of objects one after another, from disk where they are kept, and made and kept where not.

    Args:
      num_threads: 0 takes every core. robot: whose hand it is; the Panda's if not given.
    """
    robot = robot or find_robot()
    with (
        Progress("grasping", len(objects), "object") as progress,
        Rollout(nthread=num_threads or os.cpu_count() or 1) as pool,
    ):
        for asset in objects:
            path = grasp_file(asset, number, seed, robot)
            found = None if fresh else read_grasps(path, asset)
            if found is None or found.gripper != robot.gripper.hash:
                found = make_grasps(asset, number, seed, pool, robot)
                write_grasps(path, [found])
            progress.update(note=f"{len(found)} of {asset.name}")
            yield found


def write_grasps(path: Path, sets: Sequence[Grasps]) -> Path:
    """Writes a Parquet file of one gripper's grasps, a row each; its metadata name objects without any."""
    gripper = sets[0].gripper if sets else ""
    # The models that tell whose hand it is are there where a gripper was tested, and only there.
    is_panda = bool(gripper) and gripper == find_robot().gripper.hash
    rows = {
        "object": [each.name for each in sets for _ in each.width],
        "hash": [each.hash for each in sets for _ in each.width],
    }
    for name in (*_POSES, *_COLUMNS, "is_low"):
        rows[name] = np.concatenate([getattr(each, name) for each in sets]).tolist()
    schema = pa.schema(
        [
            ("object", pa.string()),
            ("hash", pa.string()),
            *(
                pa.field(name, pa.list_(pa.float64(), 7), metadata={"what": what})
                for name, what in _POSES.items()
            ),
            *(
                pa.field(name, pa.float64(), metadata={"unit": unit})
                for name, unit in _COLUMNS.items()
            ),
            ("is_low", pa.bool_()),
        ],
        metadata={
            "cluttergen_grasps": str(_VERSION),
            "gripper": gripper,
            # For those who know hands by name (`scene.export.molmospaces`).
            "hand": "panda" if is_panda else "another",
            "frame": "tool: z approach, y closing, between the pads",
            "tested": " ".join(f"{each.name}={each.num_tested}" for each in sets),
        },
    )
    write_atomically(path, sealed_parquet(pa.table(rows, schema=schema)))
    return path


_NUMBERS = {
    "pose": Numbers("f8", ("grasps", 7), -10, 10),
    "width": Numbers("f8", ("grasps",), 0, 1),
    "shift": Numbers("f8", ("grasps",), 0),
    "slip": Numbers("f8", ("grasps",), 0),
    "turn": Numbers("f8", ("grasps",), 0, 2 * np.pi),
    "margin": Numbers("f8", ("grasps",), 0, MAX_LOAD),
    "is_low": Numbers("bool", ("grasps",)),
    "held": Numbers("f8", ("grasps", 7), -10, 10),
}
"""What is read of a file's columns."""
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


def read_grasps(path: Path, asset: ObjectAsset) -> Grasps | None:
    """The grasps of one object in a file; None where there is no file, or one of another version.

    Raises:
      PoolError: the file is damaged.
    """
    if not path.is_file():
        return None
    try:
        table = read_sealed_parquet(path.read_bytes())
        metadata = {
            key.decode(): text.decode() for key, text in (table.schema.metadata or {}).items()
        }
        if metadata.get("cluttergen_grasps") != str(_VERSION):
            return None
        tested = dict(each.split("=") for each in metadata["tested"].split())
        rows = table.filter(pa.compute.equal(table["hash"], object_hash(asset)))
        columns = {name: rows[name].to_numpy() for name in (*_COLUMNS, "is_low")}
        poses = {
            name: np.array(rows[name].to_pylist(), np.float64).reshape(-1, 7) for name in _POSES
        }
        check_numbers({**poses, **columns}, _NUMBERS)
        turns = [np.linalg.norm(each[:, 3:], axis=1) for each in poses.values()]
        num_tested = int(tested[asset.name])
        if np.abs(np.concatenate(turns) - 1).max(initial=0) > _UNIT or num_tested < len(rows):
            raise SchemaError("a turn is none, or more grasps than were tested")
        known: dict[str, Any] = {
            "num_tested": num_tested,
            "gripper": metadata["gripper"],
            **poses,
            **columns,
        }
        return Grasps(asset.name, object_hash(asset), **known)
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        raise PoolError(
            f"{path}: damaged ({error})", "a file of `robot grasps`", "removing it"
        ) from error


_HEADINGS = ("object", "grasps", "low", "tested", "shift mm", "slip mm", "turn deg", "margin")


@dataclass(frozen=True, eq=False)
class GraspSets:
    """Grasps of several objects, in the order in which they were asked for; sets: of each object."""

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
    shift = 1e3 * np.median(grasps.shift)
    slip = 1e3 * np.median(grasps.slip)
    turn = np.degrees(np.median(grasps.turn))
    margin = np.median(grasps.margin)
    return (*counts, *(f"{each:.1f}" for each in (shift, slip, turn, margin)))


_HINT = "{'mug': (poses, widths), ...}, or a file of `cluttergen robot grasps` with --out"


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
        if given is None and self._path is not None:
            given = read_grasps(self._path, asset)
            if given is None:
                told = f"{self._path}: grasps of another version"
                raise PoolError(told, _HINT, "making them again")
        if not isinstance(given, Grasps):
            return _make_grasps(asset.name, content, given, self._robot)
        what = "none"
        if len(given):
            if given.hash != content:
                what = "those of another object of that name"
            elif given.gripper != self._robot.gripper.hash:
                what = f"those of another gripper than {self._robot.name}'s"
            else:
                return given
        raise ConfigError(f"`grasps` of {asset.name}: {what}", "grasps of this object", _HINT)


def _read_plain(path: Path) -> dict[str, Any]:
    """Pairs of poses and widths by object; None for each object of a file of `robot grasps`."""
    try:
        table = pq.read_table(path)
        names = np.array(table["object"].to_pylist())
        if b"cluttergen_grasps" in (table.schema.metadata or {}):
            return dict.fromkeys(names.tolist())
        columns = [np.array(table[each].to_pylist(), np.float64) for each in ("pose", "width")]
        return {
            name: [each[names == name] for each in columns]
            for name in dict.fromkeys(names.tolist())
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
    tested = (nothing, nothing, nothing, nothing, nothing == 0, 0)
    return Grasps(name, content, pose, width, *tested, held, robot.gripper.hash)


_MOST = 24
"""Of an object: more hide it."""
# Metres from the tips to the palm, and of the line behind it.
_FINGER = 0.045
_STEM = 0.035

_RADIUS = 0.0012
_WEAK = np.array([0.85, 0.35, 0.1])
_STRONG = np.array([0.1, 0.55, 0.25])


def grasp_trails(grasps: Grasps, most: int = _MOST) -> list[Trail]:
    """Lines in the object's frame: of `most` grasps at most, evenly through their list.

    Green ones held `MAX_LOAD` times the object's weight, red ones hardly more than once.
    """
    number = min(most, len(grasps))
    trails = []
    for k in np.linspace(0, len(grasps) - 1, number).round().astype(int):
        T_object_tool = matrix_of(grasps.pose[k])
        half = grasps.width[k] / 2
        fork = np.array([[0, -half, 0], [0, -half, -_FINGER], [0, half, -_FINGER], [0, half, 0]])
        stem = np.array([[0, 0, -_FINGER], [0, 0, -_FINGER - _STEM]])
        share = float(np.clip((grasps.margin[k] - 1) / (MAX_LOAD - 1), 0, 1))
        red, green, blue = (_WEAK + share * (_STRONG - _WEAK)).tolist()
        for line in (fork, stem):
            points = line @ T_object_tool[:3, :3].T + T_object_tool[:3, 3]
            trails.append(Trail(points, (red, green, blue), radius=_RADIUS))
    return trails


def grasp_sheet(
    objects: Sequence[ObjectAsset], sets: Iterable[Grasps], columns: int = 4, samples: int = 16
) -> np.ndarray:
    """u8[H, W, 3]: a contact sheet of objects with grasps about each, and how many there are.

    Args:
      sets: of each object, in their order.
    """
    images = []
    captions = []
    for asset, grasps in zip(objects, sets, strict=True):
        trails = grasp_trails(grasps)
        images.append(render_object(asset, width=320, height=320, samples=samples, trails=trails))
        captions.append(f"{asset.name} (grasps: {len(grasps)}, low: {int(grasps.is_low.sum())})")
    return contact_sheet(images, captions, columns)
