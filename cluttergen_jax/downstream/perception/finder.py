"""The finder: from pictures of one moment to where each known object is, and how sure that is."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from cluttergen_jax.assets import ObjectAsset, SupportAsset
from cluttergen_jax.downstream.digests import constants_hash
from cluttergen_jax.downstream.perception import corrections, object_model, registration
from cluttergen_jax.downstream.perception import segmenter as segmenters
from cluttergen_jax.downstream.perception.corrections import (
    PosePhysicsCheck,
    correct_camera,
    correct_masks,
    find_unexplained,
)
from cluttergen_jax.downstream.perception.object_model import ObjectModel
from cluttergen_jax.downstream.perception.registration import SURE, RegistrationEstimator
from cluttergen_jax.downstream.perception.segmenter import load_segmenter, segmenter_folder
from cluttergen_jax.downstream.perception.types import (
    ARM,
    BACKGROUND,
    FIRST_OBJECT,
    PoseEstimate,
    Segmenter,
    check_images,
)
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.schema import checked_record, convert
from cluttergen_jax.sensing import Camera, Grid, View, level_camera

CERTAINTY_FILE = "certainty.json"
FEATURES = ("bias", "score", "gap", "lead", "visible", "pixels", "steady")


@dataclass(frozen=True)
class Certainty:
    """The chance that a pose is right, by a logistic rule.

    Attributes:
      weights: of `FEATURES`; the usual ones were set by hand.
      number: poses whose errors are known that they were fitted to; 0 for the usual ones.
    """

    weights: tuple[float, ...] = (-6.0, 6.0, 4.0, 1.0, 1.5, 0.3, 1.0)
    number: int = 0

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """f64[...] in (0, 1): the chance that poses with features f[..., 7] are right."""
        return 1 / (1 + np.exp(-np.asarray(features, np.float64) @ np.array(self.weights)))


class _Stored(msgspec.Struct):
    """What the file of a rule of certainty holds."""

    weights: dict[str, float]
    number: Annotated[int, msgspec.Meta(ge=0)]


def features_of(estimate: PoseEstimate, is_steady: bool) -> np.ndarray:
    """f64[7], in the order of `FEATURES`."""
    pixels = np.log10(max(estimate.num_pixels, 1)) - 2
    told = (estimate.score, estimate.gap, estimate.lead)
    return np.array([1.0, *told, estimate.visible, pixels, float(is_steady)])


def read_certainty(folder: Path) -> Certainty:
    """The rule beside a segmenter; the usual one where there is none.

    Raises:
      PoolError: the file is damaged.
    """
    path = folder / CERTAINTY_FILE
    if not path.is_file():
        return Certainty()
    try:
        stored = convert(checked_record(path.read_bytes()), _Stored)
        return Certainty(tuple(stored.weights[name] for name in FEATURES), stored.number)
    except (OSError, ValueError, KeyError) as error:
        hint = "python -m studies.perception eval --calibrate, in a checkout"
        raise PoolError(f"{path} is damaged ({error})", hint=hint) from error


_AGREED = 0.5
"""Certainty from which on a pose tells where a camera is."""
LEAST_CERTAIN = 0.1
"""Below it an object counts as not seen."""
_LEAD = FEATURES.index("lead")
_RADIUS = 0.1
_FEWEST = 60
"""Pixels of a thing that nothing explains, from which on it is looked into."""


@dataclass(frozen=True, eq=False)
class FoundScene:
    """Where N objects are, by what was seen.

    Attributes:
      names: of the objects.
      pose: f64[N, 7], T_world_object, metres, wxyz; the identity where not seen.
      seen: bool[N]. certainty: f64[N] in [0, 1], the chance that the pose is right; 0 where not seen.
      features: f64[N, 7], what that was told from (`FEATURES`).
      visible: f64[N], share of each silhouette that is seen.
      labels: of each look u8[H, W], which object each pixel shows (`types`): the segmenter's word,
        corrected by depth where an object of these names was found.
    """

    names: tuple[str, ...]
    pose: np.ndarray
    seen: np.ndarray
    certainty: np.ndarray
    features: np.ndarray
    visible: np.ndarray
    labels: tuple[np.ndarray, ...]


class SceneFinder:
    """Finds known objects in pictures of one moment.

    Args:
      objects: K, in the order of the segmenter's names. support: the table.
      segmenter: any that obeys the protocol. estimator: of the same objects, made here if not given.
      certainty: the rule that tells chances.

    Raises:
      ConfigError: the segmenter knows other objects.
    """

    def __init__(
        self,
        objects: Sequence[ObjectAsset],
        support: SupportAsset,
        segmenter: Segmenter,
        estimator: RegistrationEstimator | None = None,
        certainty: Certainty | None = None,
    ) -> None:
        names = tuple(asset.name for asset in objects)
        if names != tuple(segmenter.names):
            raise ConfigError(
                f"a segmenter of {', '.join(segmenter.names)}",
                f"one of {', '.join(names)}",
                "its own pool",
            )
        self.names = names
        self._segmenter = segmenter
        self.estimator = estimator or RegistrationEstimator(objects, support)
        self._certainty = certainty or Certainty()
        self._steady = PosePhysicsCheck(objects, support)
        self._grid = Grid.of(support, _RADIUS)
        self._objects = tuple(objects)
        self._top = support.top

    def look(
        self,
        rgb: np.ndarray,
        depth: np.ndarray,
        camera: Camera,
        is_own: np.ndarray | None = None,
        among: Sequence[str] | None = None,
    ) -> View:
        """One picture, segmented; the known table corrects the camera's height and orientation.

        Args:
          rgb: u8[H, W, 3]. depth: f32[H, W], metres, nan or inf where nothing was measured.
          is_own: bool[H, W], pixels in which the robot knows itself to be, if there is one.
          among: the objects that may be there, by name; all if None.

        Raises:
          ConfigError: the images are not the camera's, or hold no depth.
        """
        rgb, depth = check_images(rgb, depth, camera)
        if is_own is not None:
            depth = np.where(is_own, np.nan, depth)
        camera = upright_at_its_place(depth, camera, self._grid)
        label = self._segmenter(rgb, depth, camera, among).label
        if is_own is not None:
            label = np.where(is_own, ARM, label)
        return View(depth, label, camera)

    def __call__(
        self,
        looks: Sequence[View],
        names: Sequence[str] | None = None,
        near: np.ndarray | None = None,
        share: float = 1.0,
    ) -> FoundScene:
        """Where objects are; all if no names are given.

        Cameras are first brought to agree with what is known of the objects, or several with each other.

        Args:
          looks: of one moment, in which nothing moved.
          near: f64[n, 7], where those of these names probably are, which depth then confirms or not
            (`expected`); nan where that is not known.
          share: in [0, 1], of the way that cameras are brought to agree with `near`.

        Raises:
          ConfigError: an object of that name is not known.
        """
        asked = self.names if names is None else tuple(names)
        if strange := [name for name in asked if name not in self.names]:
            raise ConfigError(f"objects {', '.join(strange)}", ", ".join(self.names))
        lead = np.ones(len(asked))
        if near is None or np.isnan(near).all():
            found = self._find(looks, asked, np.full((len(asked), 7), np.nan), lead)
            near = np.where(found.certainty[:, None] >= _AGREED, found.pose, np.nan)
            share = 1.0
            if len(looks) == 1 or np.isnan(near).all():
                return found
            # What these looks told of a turn, they do not tell once more.
            lead = np.where(np.isnan(near).any(1), 1.0, found.features[:, _LEAD])
        return self._find(self._correct_cameras(looks, asked, near, share), asked, near, lead)

    def _correct_cameras(
        self, looks: Sequence[View], names: Sequence[str], known: np.ndarray, share: float
    ) -> list[View]:
        there = self._at(_poses_by_number(self.names, names, known))
        return [correct_camera(look, there, share) for look in correct_masks(looks, there)]

    def _find(
        self, looks: Sequence[View], asked: Sequence[str], near: np.ndarray, most: np.ndarray
    ) -> FoundScene:
        """As `__call__`; `most` f64[n]: what each pose's lead is at most."""
        numbers = [self.names.index(name) for name in asked]
        places = _poses_by_number(self.names, asked, near)
        looks = self._as_expected(looks, places)
        found = {number: self.estimator(number, looks, places.get(number)) for number in numbers}
        # What is there for sure is nothing else.
        sure = {number: each.pose for number, each in found.items() if each and each.score >= SURE}
        unsure = [number for number in numbers if number not in sure]
        told = self._as_expected(looks, sure) if unsure else looks
        for number in unsure:
            masks = (
                (old.mask(number), new.mask(number)) for old, new in zip(looks, told, strict=True)
            )
            if not all(np.array_equal(old, new) for old, new in masks):
                found[number] = self.estimator(number, told, places.get(number))
        estimates = {number: each for number, each in found.items() if each is not None}
        self._seek_in_the_rest(told, unsure, estimates)
        poses, is_placed = self._pool_poses(estimates)
        poses = self._steady.apart(poses, is_placed)
        steady = self._steady(poses, is_placed)
        count = len(asked)
        pose = np.tile(np.eye(7)[3], (count, 1))
        features = np.zeros((count, len(FEATURES)))
        visible = np.zeros(count)
        certainty = np.zeros(count)
        for place, number in enumerate(numbers):
            if number in estimates:
                pose[place] = poses[number]
                features[place] = features_of(estimates[number], bool(steady[number]))
                features[place, _LEAD] = min(features[place, _LEAD], most[place])
                visible[place] = estimates[number].visible
                certainty[place] = self._certainty(features[place])
        seen = certainty >= LEAST_CERTAIN
        there = {number: pose[place] for place, number in enumerate(numbers) if seen[place]}
        labels = tuple(look.label for look in self._as_expected(looks, there))
        return FoundScene(
            tuple(asked), pose, seen, np.where(seen, certainty, 0.0), features, visible, labels
        )

    def _seek_in_the_rest(
        self, looks: Sequence[View], unsure: Sequence[int], estimates: dict[int, PoseEstimate]
    ) -> None:
        """Each thing that none of `estimates` explains is taken for the unsure object that fits it best.

        So an object is found that the segmenter took for another.
        """
        left = [
            number for number in unsure if number not in estimates or estimates[number].score < SURE
        ]
        while left:
            found = self._at({k: each.pose for k, each in estimates.items()})
            for masks in find_unexplained(looks, found, self._top, _FEWEST)[: len(left)]:
                shown = list(zip(looks, masks, strict=True))
                tried = ((k, self.estimator(k, [_as(k, *each) for each in shown])) for k in left)
                fits = [(k, each) for k, each in tried if each is not None and each.score >= SURE]
                if fits:
                    # What was wrongly said to be here leaves something else unexplained.
                    number, estimates[number] = max(fits, key=lambda each: each[1].score)
                    left.remove(number)
                    break
            else:
                return

    def _as_expected(self, looks: Sequence[View], poses: dict[int, np.ndarray]) -> list[View]:
        return correct_masks(looks, self._at(poses))

    def _at(self, poses: dict[int, np.ndarray]) -> dict[int, tuple[ObjectModel, np.ndarray]]:
        return {k: (ObjectModel.of(self._objects[k]), matrix_of(pose)) for k, pose in poses.items()}

    def _pool_poses(self, estimates: dict[int, PoseEstimate]) -> tuple[np.ndarray, np.ndarray]:
        """f64[K, 7], bool[K]: where the objects of the pool are said to be, and which of them are."""
        poses = np.tile(np.eye(7)[3], (len(self.names), 1))
        is_placed = np.zeros(len(self.names), bool)
        for number, estimate in estimates.items():
            poses[number] = estimate.pose
            is_placed[number] = True
        return poses, is_placed


def _poses_by_number(
    known: Sequence[str], names: Sequence[str], poses: np.ndarray
) -> dict[int, np.ndarray]:
    """Poses f64[n, 7] of objects by their numbers; those that are nan are left out."""
    told = ((known.index(name), pose) for name, pose in zip(names, poses, strict=True))
    return {number: pose for number, pose in told if not np.isnan(pose).any()}


def _as(number: int, look: View, mask: np.ndarray) -> View:
    """A look in which the mask bool[H, W] alone shows an object."""
    label = np.where(look.mask(number), BACKGROUND, look.label)
    return replace(
        look, label=np.where(mask, FIRST_OBJECT + number, label).astype(look.label.dtype)
    )


def upright_at_its_place(depth: np.ndarray, camera: Camera, grid: Grid) -> Camera:
    """The camera turned and raised so that the table that it sees lies level, its place in plan as stated.

    What a wrong orientation does to far points is centimetres, what a wrong position does is not: so the
    tilt that is seen is taken for an error of orientation alone (`level_camera` of sensing turns about the
    table instead).

    Args:
      depth: f32[H, W], metres, nan where nothing was measured.
    """
    found = level_camera(depth, camera, grid)
    T = found.T_world_camera.copy()
    T[:2, 3] = camera.eye[:2]
    return replace(found, T_world_camera=T)


def load_finder(
    segmenter: str | Path, objects: Sequence[ObjectAsset], support: SupportAsset
) -> SceneFinder:
    """A finder with a trained segmenter, and with the rule of certainty that lies beside it.

    Args:
      segmenter: a pool's name or a folder (`segmenter.segmenter_folder`).

    Raises:
      PoolError: there is no such segmenter, or it is damaged.
      ConfigError: it knows other objects.
      MissingExtraError: the extra `perception` is not installed.
    """
    certainty = read_certainty(segmenter_folder(segmenter))
    return SceneFinder(objects, support, load_segmenter(segmenter), certainty=certainty)


@cache
def finder_hash() -> str:
    """Hex digest of how objects and their poses are found in pictures, but for the network's weights."""
    parts = (corrections, object_model, registration, segmenters)
    return constants_hash(sys.modules[__name__], *parts)
