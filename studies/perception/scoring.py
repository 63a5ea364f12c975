"""Moments of a folder of views, judged: what was found of them, beside what is true."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cluttergen_jax.downstream.noise import NoiseConfig
from cluttergen_jax.downstream.perception.finder import SceneFinder
from cluttergen_jax.downstream.perception.object_model import Comparer, ObjectModel
from cluttergen_jax.downstream.perception.types import FIRST_OBJECT, num_classes
from cluttergen_jax.downstream.transforms import matrix_of, offset
from cluttergen_jax.sensing import View
from studies.perception.view_store import StoredView, simulate_camera

VISIBLE_PIXELS = 150
"""Of a picture of 320 x 240, from which on an object has to be found."""
HALF = 0.5
"""Intersection over union with its true mask from which on an object counts as found; and the share of a mask
that has to be the object's own."""
# Metres and radians, up to symmetry, below which a pose is right.
GOOD_ADDS = 0.005
GOOD_TURN = float(np.radians(5))


def confusion(found: np.ndarray, true: np.ndarray, num_objects: int) -> np.ndarray:
    """i64[C, C]: pixels of each true class (rows) that were taken for each class (columns)."""
    number = num_classes(num_objects)
    index = true.astype(np.int64).ravel() * number + found.astype(np.int64).ravel()
    return np.bincount(index, minlength=number * number).reshape(number, number)


def iou_of(confused: np.ndarray) -> np.ndarray:
    """f64[C]: intersection over union of each class of a confusion i64[C, C]; nan where there is neither."""
    both = np.diag(confused)
    either = confused.sum(0) + confused.sum(1) - both
    return np.where(either > 0, both / np.maximum(either, 1), np.nan)


def intersection_over_union(found: np.ndarray, true: np.ndarray, num_objects: int) -> np.ndarray:
    """f64[C]: of labels [...] and true ones; over all pixels together."""
    return iou_of(confusion(found, true, num_objects))


@dataclass(frozen=True)
class JudgedMoment:
    """What was found of one moment, seen by one camera or several.

    Lists have an entry for each object of which some camera shows `VISIBLE_PIXELS` or more.

    Attributes:
      moment: its number. has_arm: the arm was in view.
      confused: of each picture the pixels of each true class that the segmenter took for each class, row by
        row.
      corrected: the same by `finder.FoundScene.labels`.
      objects: names. share: of their silhouettes that is seen, truly.
      adds: metres (ADD-S on surfaces); turn: radians up to symmetry; shift: metres; None where not seen.
      certainty, features: see `finder.FoundScene`.
      is_estimate_right: of each estimate, whether it is believed or not; False where there is none.
      cpu: seconds of this process.
    """

    moment: int
    has_arm: bool
    confused: list[list[int]]
    corrected: list[list[int]]
    objects: list[str]
    share: list[float]
    adds: list[float | None]
    turn: list[float | None]
    shift: list[float | None]
    certainty: list[float]
    features: list[list[float]]
    cpu: float
    is_estimate_right: list[bool]

    @property
    def is_right(self) -> list[bool]:
        """Of each object, whether its pose is."""
        return [is_good(adds, turn) for adds, turn in zip(self.adds, self.turn, strict=True)]


_NO_ERRORS: tuple[None, None, None] = (None, None, None)


def judge_moment(
    views: Sequence[StoredView],
    finder: SceneFinder,
    models: Sequence[ObjectModel],
    noise: NoiseConfig,
    seed: int,
    true_masks: bool,
) -> JudgedMoment:
    """What a finder makes of views of one moment.

    Args:
      models: of all objects. seed: of exposure and noise.
      true_masks: put the true labels in place of the segmenter's: poses alone are judged.
    """
    begun = time.process_time()
    number = len(models)
    seen = [simulate_camera(view, noise, seed) for view in views]
    looks = [finder.look(each.colours, each.depth, each.camera) for each in seen]
    if true_masks:
        looks = [replace(look, label=each.label) for look, each in zip(looks, seen, strict=True)]
    labels = [each.label for each in seen]
    pixels = np.max(
        [np.bincount(each.ravel(), minlength=num_classes(number)) for each in labels], axis=0
    )
    pixels = pixels[FIRST_OBJECT:]
    asked = [k for k in views[0].objects.tolist() if pixels[k] >= VISIBLE_PIXELS]
    scene = finder(looks, [finder.names[k] for k in asked])
    cpu = time.process_time() - begun
    true = dict(zip(views[0].objects.tolist(), matrix_of(views[0].poses), strict=True))
    exact = [View(view.view.depth, view.view.label, view.view.camera) for view in views]
    # An estimate that nobody believes teaches what is to be believed.
    estimates = [
        _errors(models[k], true[k], matrix_of(pose)) if any(features) else _NO_ERRORS
        for k, pose, features in zip(asked, scene.pose, scene.features, strict=True)
    ]
    errors = [
        found if is_seen else _NO_ERRORS
        for found, is_seen in zip(estimates, scene.seen, strict=True)
    ]
    return JudgedMoment(
        moment=views[0].number,
        has_arm=views[0].has_arm,
        confused=_confusions([look.label for look in looks], labels, number),
        corrected=_confusions(scene.labels, labels, number),
        objects=list(scene.names),
        share=[Comparer(models[k], k, exact).visible(true[k]) for k in asked],
        adds=[each[0] for each in errors],
        turn=[each[1] for each in errors],
        shift=[each[2] for each in errors],
        certainty=scene.certainty.tolist(),
        features=scene.features.tolist(),
        cpu=cpu,
        is_estimate_right=[is_good(adds, turn) for adds, turn, _ in estimates],
    )


def is_good(adds: float | None, turn: float | None) -> bool:
    """Whether a pose with these errors, metres and radians, is right; one that was not told is not."""
    return adds is not None and turn is not None and adds < GOOD_ADDS and turn < GOOD_TURN


def _errors(model: ObjectModel, true: np.ndarray, found: np.ndarray) -> tuple[float, float, float]:
    shift, turn = offset(found, true, model.symmetry)
    return model.surface_distance(true, found), turn, shift


def _confusions(
    labels: Sequence[np.ndarray], true: Sequence[np.ndarray], number: int
) -> list[list[int]]:
    found = [confusion(each, right, number) for each, right in zip(labels, true, strict=True)]
    return [each.ravel().tolist() for each in found]


class MaskFigures(NamedTuple):
    """How good the masks of some pictures are.

    Attributes:
      mean_iou: over the classes that are there, background and arm among them, all pixels together.
      visible: objects with `VISIBLE_PIXELS` or more, counted for each picture; found: of these, those with a
        good mask; masks: masks of as many pixels; false: of these, those mostly of something else.
    """

    mean_iou: float
    visible: int
    found: int
    masks: int
    false: int


def mask_figures(confused: Sequence[Sequence[int]], number: int) -> MaskFigures:
    """Of pictures of `number` objects; `confused` is a matrix for each, row by row (`JudgedMoment`)."""
    matrices = np.array(confused).reshape(-1, num_classes(number), num_classes(number))
    counts = np.sum([_mask_counts(each) for each in matrices], axis=0)
    return MaskFigures(float(np.nanmean(iou_of(matrices.sum(0)))), *map(int, counts))


def _mask_counts(confused: np.ndarray) -> tuple[int, int, int, int]:
    """The counts of `MaskFigures`, of one picture."""
    both = np.diag(confused)[FIRST_OBJECT:]
    true = confused.sum(1)[FIRST_OBJECT:]
    found = confused.sum(0)[FIRST_OBJECT:]
    is_visible = true >= VISIBLE_PIXELS
    is_mask = found >= VISIBLE_PIXELS
    is_found = is_visible & (both >= HALF * (true + found - both))
    is_false = is_mask & (both < HALF * found)
    return int(is_visible.sum()), int(is_found.sum()), int(is_mask.sum()), int(is_false.sum())
