"""Our pose estimator: upright registration from many turns, then free; rendered, compared, refined.

Registration is by iterated closest points: of upright objects in x, y, z and yaw, and without any rule.
"""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cluttergen_jax.assets import ObjectAsset, SupportAsset
from cluttergen_jax.downstream.perception.object_model import Comparer, ObjectModel
from cluttergen_jax.downstream.perception.types import PoseEstimate
from cluttergen_jax.downstream.transforms import (
    inverse,
    matrix_of,
    offset,
    pose_of,
    rigid,
    shift_along,
    turn_matrix,
)
from cluttergen_jax.errors import ConfigError, MissingExtraError, range_text
from cluttergen_jax.geometry import ROUND, rotation_matrix, yaw_matrix
from cluttergen_jax.sensing import View

NUM_YAWS = 24
_ICP_STEPS = 12
# Metres beyond which points pair with nothing, at the first and at the last step.
_FIRST_TRIM = 0.04
_LAST_TRIM = 0.010

# What a point's own distance counts for beside that from its plane; and what keeps an open move at none.
_POINTS = 0.2
_DAMPING = 1e-8


def starting_yaws(symmetry: int) -> np.ndarray:
    """f64[n]: turns to begin with, radians; fewer where turns look alike."""
    if symmetry >= ROUND:
        return np.zeros(1)
    number = max(NUM_YAWS // symmetry, 3)
    return 2 * np.pi / symmetry * np.arange(number) / number


def register_upright(
    model: ObjectModel,
    points: np.ndarray,
    eyes: np.ndarray,
    yaw: float,
    bottom: float | None,
    offset: np.ndarray | None = None,
) -> np.ndarray:
    """f64[4, 4]: T_world_object near a turn, by iterated closest points on tangent planes.

    Args:
      points: f64[P, 3], of the object, world frame. eyes: f64[P, 3], from where each was seen.
      yaw: radians. bottom: the height of what it stands on; None leaves z free.
      offset: f64[2], metres, added to the first guess in plan; none if None.
    """
    pose = _first_guess(model, points, eyes, yaw, bottom)
    if offset is not None:
        pose[:2, 3] += offset
    fixed = bottom is not None
    for step in range(_ICP_STEPS):
        trim = _FIRST_TRIM * (_LAST_TRIM / _FIRST_TRIM) ** (step / (_ICP_STEPS - 1))
        rotation = pose[:3, :3]
        local = (points - pose[:3, 3]) @ rotation
        distance, nearest = model.tree.query(local, distance_upper_bound=trim)
        is_near = np.isfinite(distance)
        if is_near.sum() < 8:
            return pose
        near = local[is_near]
        index = nearest[is_near]
        normal = model.normals[index]
        # A surface that faces away from the eye was not what was seen.
        view = near - ((eyes[is_near] - pose[:3, 3]) @ rotation)
        faces = (normal * view).sum(1) < 0
        weight = np.where(faces, 1.0, 0.2)
        weight *= np.clip(1 - (distance[is_near] / trim) ** 2, 0.0, None)
        change = _solve_move(near, model.points[index], normal, weight, fixed)
        turn = yaw_matrix(change[3])
        moved = np.eye(4)
        moved[:3, :3] = turn
        moved[:3, 3] = change[:3]
        pose = pose @ moved
    return pose


def _first_guess(
    model: ObjectModel, points: np.ndarray, eyes: np.ndarray, yaw: float, bottom: float | None
) -> np.ndarray:
    """The middle of what would be seen at this turn lies in the middle of what was seen."""
    turn = yaw_matrix(yaw)
    toward = (eyes.mean(0) - points.mean(0)) @ turn
    is_seen = model.normals @ toward > 0
    seen = model.points[is_seen] if is_seen.sum() > 20 else model.points
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = points.mean(0) - turn @ seen.mean(0)
    if bottom is not None:
        pose[2, 3] = bottom + model.asset.half_extents[2]
    return pose


def _solve_move(
    near: np.ndarray, target: np.ndarray, normal: np.ndarray, weight: np.ndarray, fixed: bool
) -> np.ndarray:
    """f64[4]: the move x, y, z, yaw of the object, in its frame, that brings its planes to the points.

    Args:
      near, target, normal: f64[P, 3], seen points, the surface's points and normals; weight: f64[P].
      fixed: z does not change.
    """
    apart = near - target
    none = np.zeros(len(near))
    one = np.ones(len(near))
    # A point p of the object moves by t + w x p.
    about = target[:, 0] * normal[:, 1] - target[:, 1] * normal[:, 0]
    planes = np.column_stack([normal[:, :2], none if fixed else normal[:, 2], about])
    # Slides that the planes leave open are held by the points themselves, a little.
    along_x = _POINTS * np.column_stack([one, none, none, -target[:, 1]])
    along_y = _POINTS * np.column_stack([none, one, none, target[:, 0]])
    aims = (apart * normal).sum(1), _POINTS * apart[:, 0], _POINTS * apart[:, 1]
    matrix = _DAMPING * np.eye(4)
    right = np.zeros(4)
    for rows, aim in zip((planes, along_x, along_y), aims, strict=True):
        weighted = rows * weight[:, None]
        matrix += weighted.T @ rows
        right += weighted.T @ aim
    change = np.linalg.solve(matrix, right)
    change[3] = np.clip(change[3], -0.3, 0.3)
    return change


EXTRA = "perception"
_FREE_REACH = 0.012
_FREE_STEPS = 20


def need_gicp() -> Any:
    """The module `small_gicp`. Raises MissingExtraError: it is not installed."""
    try:
        return importlib.import_module("small_gicp")
    except ImportError as error:
        raise MissingExtraError(EXTRA, "pose estimation") from error


class FreeRegistration:
    """Moves poses of one object, all six coordinates, to where its surface meets points."""

    def __init__(self, model: ObjectModel) -> None:
        self._gicp = need_gicp()
        self._target = self._gicp.PointCloud(model.points)
        self._tree = self._gicp.KdTree(self._target, num_threads=1)
        self._gicp.estimate_normals_covariances(
            self._target, self._tree, num_neighbors=12, num_threads=1
        )

    def __call__(self, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """f64[4, 4]: T_world_object near `pose` f64[4, 4] for points f64[P, 3] of it, world frame."""
        # In the frame of the guess, so that rotations and lengths weigh alike.
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        found = self._gicp.align(
            self._target,
            self._gicp.PointCloud(local),
            self._tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=_FREE_REACH,
            num_threads=1,
            max_iterations=_FREE_STEPS,
            translation_epsilon=1e-5,
            rotation_epsilon=1e-4,
        )
        T = np.asarray(found.T_target_source, np.float64)
        if not np.isfinite(T).all():
            return pose
        return pose @ inverse(T)


FEWEST_PIXELS = 40
"""Of an object, below which no pose is sought."""
_MOST_POINTS = 400
_BEST = 5
_REFINED = 3
SURE = 0.6
"""Score from which on a pose is believed, and no other is tried."""
# Where else registration begins, in half diagonals of the object, towards the eye and across.
_OFFSET = 0.5
_AROUND = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])

# Cosine of the tilt, and metres over the table, up to which an object counts as standing on it.
_NEARLY_UPRIGHT = np.cos(np.radians(10))
_LOW = 0.01

# The same up to which it is taken to stand there exactly: nothing leans so little, or sinks into a table.
_ALL_BUT_UPRIGHT = np.cos(np.radians(3))
_ALL_BUT_DOWN = 0.005

_SAME_PLACE = 0.01
_SAME_TURN = np.radians(10)
_STEPS = ((0.03, 0.0), (0.015, 0.0), (0.006, 0.0), (0.003, 4.0), (0.0015, 2.0))
"""Metres and degrees of the last refinement; long ones first: what is half hidden slides along itself."""
_TOPMOST = 0.98
"""Share of an object's points below what counts as its top: some bled over an edge."""
# By which a pose that leans has to agree better, and one that rests in another way, as a ring that looks the
# same upside down; and the cosine of the tilt between them.
_FREE_GAIN = 0.03
_LYING_GAIN = 0.05
_LEANING = 0.7

_FEW_TURNS = 8
"""Turns that are tried first where an object was; if one scores like its own, all of `starting_yaws` are."""
# Evidence from which on another turn than the one that was is believed, and by how much a score may be less:
# something small decides about a turn, as the handle of a candlestick does.
_DECISIVE = 200.0
_ALIKE = 0.05

Scored = tuple[float, np.ndarray]
"""A score, and the pose f64[4, 4] that has it."""


class _Seen(NamedTuple):
    """An object as it was seen: points f64[P, 3], and from where each, f64[P, 3]."""

    model: ObjectModel
    free: FreeRegistration
    points: np.ndarray
    eyes: np.ndarray
    compare: Comparer

    def upright(self, yaw: float, bottom: float | None, offset: np.ndarray | None = None) -> Scored:
        """The upright pose near a turn (`register_upright`)."""
        pose = register_upright(self.model, self.points, self.eyes, yaw, bottom, offset)
        return _worth(self.compare, pose), pose

    def freely(self, pose: np.ndarray) -> Scored:
        """The pose near f64[4, 4] that fits best, however it leans."""
        freed = self.free(self.points, pose)
        return _worth(self.compare, freed), freed


class RegistrationEstimator:
    """Finds poses of its objects in looks at one moment, by registration and comparison.

    Args:
      objects: K, in the order of their numbers. support: the table that they stand on.

    Raises:
      MissingExtraError: the extra `perception` is not installed.
    """

    def __init__(self, objects: Sequence[ObjectAsset], support: SupportAsset) -> None:
        need_gicp()
        self._objects = tuple(objects)
        self._top = float(support.top)
        self._models: dict[int, tuple[ObjectModel, FreeRegistration]] = {}

    def model(self, index: int) -> ObjectModel:
        """Of an object, made when it is first asked for."""
        return self._load(index)[0]

    def _load(self, index: int) -> tuple[ObjectModel, FreeRegistration]:
        if not 0 <= index < len(self._objects):
            raise ConfigError(f"object {index}", range_text(0, len(self._objects) - 1))
        if index not in self._models:
            model = ObjectModel.of(self._objects[index])
            self._models[index] = model, FreeRegistration(model)
        return self._models[index]

    def __call__(
        self, index: int, looks: Sequence[View], near: np.ndarray | None = None
    ) -> PoseEstimate | None:
        """The pose of the object of that number; None where too little of it is seen.

        Args:
          near: f64[7], T_world_object at which it was, if that is known; sought there first.
        """
        model, free = self._load(index)
        points, eyes, num_pixels = seen_points(index, looks)
        if num_pixels < FEWEST_PIXELS or len(points) < FEWEST_PIXELS // 2:
            return None
        compare = Comparer(model, index, looks)
        seen = _Seen(model, free, points, eyes, compare)
        if near is not None and (known := matrix_of(near))[2, 2] > _NEARLY_UPRIGHT:
            found, lead = self._where_it_was(seen, known)
            if found[0][0] >= SURE:
                return self._estimate(model, found, compare, num_pixels, lead)
        found = self._upright(seen)
        if found[0][0] < SURE:
            found = _best([*found, *self._lying(seen)])
        likely, lead = self._likeliest(found, model.symmetry, compare)
        tried = list(found)
        others = [each for each in _unlike(found, model.symmetry) if each is not likely]
        for score, pose in [likely, *others][:_REFINED]:
            tried += [seen.freely(pose), _climb(compare, (score, pose))]
        ranked = _best(tried)
        # What looks alike is told apart by evidence alone, and what agrees much better is not alike.
        first = next(each for each in ranked if not _is_turned(each[1], likely[1], model.symmetry))
        if first[0] > ranked[0][0] - _ALIKE:
            ranked = [first, *ranked]
        # Once refined, another turn may agree as well.
        likely, again = self._likeliest([ranked[0], *tried[len(found) :]], model.symmetry, compare)
        lead = min(lead, again) if likely is ranked[0] else 0.0
        return self._estimate(model, ranked, compare, num_pixels, lead)

    def _likeliest(
        self, found: Sequence[Scored], symmetry: int, compare: Comparer, prior: float = 0.0
    ) -> tuple[Scored, float]:
        """The first pose, or one of another turn with about the same score and more evidence; and its lead.

        Give it many turns: at an edge an error of a millimetre changes evidence as much as a handle does.

        Args:
          prior: evidence for the first one's turn before anything is seen (`Comparer.evidence`).

        Returns:
          Also by how much more evidence its turn has than the next best (`PoseEstimate.lead`).
        """
        first = found[0]
        alike = [each for each in found if each[0] > found[0][0] - _ALIKE]
        is_other = np.array([_is_turned(each[1], first[1], symmetry) for each in alike])
        if not is_other.any():
            return first, 1.0
        evidence = np.array([compare.evidence(pose, self._top) for _, pose in alike])
        evidence += np.where(is_other, 0.0, prior)
        best = int(evidence.argmax())
        likely = alike[best] if is_other[best] else first
        is_rival = np.array([_is_turned(each[1], likely[1], symmetry) for each in alike])
        return likely, min(float(evidence[best] - evidence[is_rival].max()) / _DECISIVE, 1.0)

    def _where_it_was(self, seen: _Seen, known: np.ndarray) -> tuple[list[Scored], float]:
        """Poses at the height of `known` f64[4, 4], the likeliest first; its own turn if none is more so.

        Returns:
          Also the lead of the first (`_likeliest`).
        """
        model = seen.model
        compare = seen.compare
        is_low = known[2, 3] - model.asset.half_extents[2] < self._top + _LOW
        bottom = self._top if is_low else None
        yaws = starting_yaws(model.symmetry)

        def from_all(turns: np.ndarray) -> list[Scored]:
            return [seen.upright(_yaw(known) + turn, bottom) for turn in turns]

        own, *others = from_all(yaws[:: max(len(yaws) // _FEW_TURNS, 1)])
        if any(
            each[0] > own[0] - _ALIKE and _is_turned(each[1], own[1], model.symmetry)
            for each in others
        ):
            own, *others = from_all(yaws)
        likely, lead = self._likeliest([own, *others], model.symmetry, compare, _DECISIVE)
        first = _climb(compare, likely)
        return [first, *_best([first if likely is own else _climb(compare, own), *others])], lead

    def _upright(self, seen: _Seen) -> list[Scored]:
        """The best poses of an upright object, each with its score: on the table, and if need be elsewhere.

        If none on the table agrees well, it may stand on something else, or begin too far away.
        """
        model = seen.model
        yaws = starting_yaws(seen.model.symmetry)

        def from_all(bottom: float | None, offsets: np.ndarray) -> list[Scored]:
            return [
                seen.upright(yaw, bottom, offset)
                for yaw, offset in itertools.product(yaws, offsets)
            ]

        nothing = np.zeros((1, 2))
        found = from_all(self._top, nothing)
        if _best(found)[0][0] < SURE:
            # What stands on something else has its top where its highest points are.
            highest = float(np.quantile(seen.points[:, 2], _TOPMOST))
            found += from_all(
                max(highest - 2 * float(model.asset.half_extents[2]), self._top), nothing
            )
        if _best(found)[0][0] < SURE:
            found += from_all(None, nothing)
        if _best(found)[0][0] < SURE:
            away = _OFFSET * float(np.linalg.norm(model.asset.half_extents[:2]))
            found += from_all(self._top, away * _AROUND)
        # Long things look much the same when they are turned round.
        for _, pose in _unlike(found, model.symmetry)[:_REFINED]:
            bottom = pose[2, 3] - model.asset.half_extents[2]
            found.append(seen.upright(_yaw(pose) + np.pi, float(bottom)))
        return _best(found)

    def _lying(self, seen: _Seen) -> list[Scored]:
        """Poses of an object that rests in another way, if it has one."""
        found = []
        for resting in seen.model.asset.resting[1:3]:
            rotation = rotation_matrix(np.array(resting.quaternion))
            for yaw in 2 * np.pi * np.arange(12) / 12:
                turn = turn_matrix(yaw)[:3, :3] @ rotation
                center = seen.points.mean(0)
                center[2] = self._top + resting.height
                found.append(seen.freely(rigid(turn, center)))
        return _best(found)[:_BEST]

    def _estimate(
        self,
        model: ObjectModel,
        ranked: list[Scored],
        compare: Comparer,
        num_pixels: int,
        lead: float,
    ) -> PoseEstimate:
        """The best of poses with their scores, best first; what all but stands on the table stands there."""
        score, pose = ranked[0]
        others = [each for each, other in ranked[1:] if _differs(other, pose, model.symmetry)]
        visible = compare.visible(pose)
        height = float(model.asset.half_extents[2])
        if pose[2, 2] > _ALL_BUT_UPRIGHT and pose[2, 3] - height < self._top + _ALL_BUT_DOWN:
            pose = rigid(
                turn_matrix(_yaw(pose))[:3, :3], np.array([*pose[:2, 3], self._top + height])
            )
        return PoseEstimate(
            pose=pose_of(pose),
            score=max(score, 0.0),
            gap=score - max(others, default=0.0),
            lead=lead,
            visible=visible,
            num_pixels=num_pixels,
        )


def seen_points(index: int, looks: Sequence[View]) -> tuple[np.ndarray, np.ndarray, int]:
    """Points f64[P, 3] of an object, world frame; the eye of each f64[P, 3]; pixels in its masks.

    Points beyond the bulk of each look's, along its line of sight, are left out: what bled over an edge.
    """
    points = []
    eyes = []
    number = 0
    for look in looks:
        mask = look.mask(index)
        number += int(mask.sum())
        there = mask & np.isfinite(look.depth)
        if there.sum() < 8:
            continue
        found = look.camera.points(look.depth)[there]
        middle = np.median(found, axis=0)
        far = np.linalg.norm(found - middle, axis=1)
        found = found[far < 3.5 * np.median(far) + 0.01]
        points.append(found)
        eyes.append(np.broadcast_to(look.camera.eye, found.shape))
    if not points:
        return np.zeros((0, 3)), np.zeros((0, 3)), number
    all_points = np.concatenate(points)
    all_eyes = np.concatenate(eyes)
    chosen = np.random.default_rng(len(all_points)).permutation(len(all_points))[:_MOST_POINTS]
    return all_points[chosen], all_eyes[chosen], number


def _best(found: list[Scored]) -> list[Scored]:
    return sorted(found, key=lambda each: -each[0])


def _unlike(found: list[Scored], symmetry: int) -> list[Scored]:
    """The best of each place and turn, best first."""
    kept: list[Scored] = []
    for score, pose in _best(found):
        if all(_differs(pose, other, symmetry) for _, other in kept):
            kept.append((score, pose))
    return kept


def _yaw(pose: np.ndarray) -> float:
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def _worth(compare: Comparer, pose: np.ndarray) -> float:
    """The score of a pose, less a penalty if it is not upright."""
    up = pose[2, 2]
    asked = 0.0 if up > 1 - 1e-9 else _FREE_GAIN if up > _LEANING else _LYING_GAIN
    return compare(pose).score - asked


def _differs(pose: np.ndarray, other: np.ndarray, symmetry: int) -> bool:
    is_elsewhere = ((pose[:3, 3] - other[:3, 3]) ** 2).sum() > _SAME_PLACE**2
    return bool(is_elsewhere) or _is_turned(pose, other, symmetry)


def _is_turned(pose: np.ndarray, other: np.ndarray, symmetry: int) -> bool:
    return offset(pose, other, symmetry)[1] > _SAME_TURN


def _climb(compare: Comparer, start: Scored) -> Scored:
    """A better pose near one, by moves along its own x and y and turns, each kept if it agrees better."""
    best, pose = start
    for step, degrees in _STEPS:
        for along in ((step, 0, 0), (-step, 0, 0), (0, step, 0), (0, -step, 0)):
            tried = shift_along(pose, along)
            if (score := _worth(compare, tried)) > best:
                best = score
                pose = tried
        for angle in np.radians([degrees, -degrees]) if degrees else ():
            tried = pose @ turn_matrix(angle)
            if (score := _worth(compare, tried)) > best:
                best = score
                pose = tried
    return best, pose
