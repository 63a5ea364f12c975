"""The evaluation of perception: moments judged one after another, kept as they are made; and tables."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from cluttergen_jax.downstream.digests import folder_hash, json_digest
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.perception.finder import (
    CERTAINTY_FILE,
    FEATURES,
    Certainty,
    SceneFinder,
    finder_hash,
    read_certainty,
)
from cluttergen_jax.downstream.perception.registration import RegistrationEstimator
from cluttergen_jax.downstream.perception.segmenter import (
    embedded_segmenters,
    load_segmenter,
    segmenter_folder,
)
from cluttergen_jax.downstream.perception.types import Segmentation, Segmenter
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import versions
from cluttergen_jax.files import write_atomically
from cluttergen_jax.schema import with_checksum
from cluttergen_jax.sensing import Camera
from cluttergen_jax.statistics import share_of
from cluttergen_jax.stores import RowStore
from cluttergen_jax.tables import aligned_table
from studies.perception.scoring import (
    GOOD_ADDS,
    GOOD_TURN,
    JudgedMoment,
    MaskFigures,
    judge_moment,
    mask_figures,
)
from studies.perception.view_store import StoredView, ViewSet

TRUE_MASKS = "true"
"""In place of a segmenter: the true labels."""
WELL_SEEN = 0.3
"""Share of an object's silhouette that is seen, from which on its pose is asked for."""
_FORMAT = 4
"""Of rows on disk: those of another are left alone."""
_SHARES = ((0.0, 0.1), (0.1, WELL_SEEN), (WELL_SEEN, 0.6), (0.6, 1.01))


class _NoSegmenter:
    """Labels nothing: the true labels take the place of what it says."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def __call__(
        self, rgb: np.ndarray, depth: np.ndarray, camera: Camera, among: Sequence[str] | None = None
    ) -> Segmentation:
        return Segmentation(self.names, np.zeros(depth.shape, np.uint8))


@dataclass(frozen=True)
class PerceptionRow:
    """Moments of one setting.

    Attributes:
      cameras: that saw each. noise: times that of a usual camera.
      moments: what was found of each. names: of all objects.
    """

    cameras: int
    noise: float
    moments: tuple[JudgedMoment, ...]
    names: tuple[str, ...]

    def masks(self, corrected: bool = False) -> MaskFigures:
        """Of the segmenter's masks, or of those that poses and depth have corrected."""
        told = [each.corrected if corrected else each.confused for each in self.moments]
        return mask_figures([picture for each in told for picture in each], len(self.names))

    def right(
        self, low: float = WELL_SEEN, high: float = np.inf, only: str | None = None
    ) -> np.ndarray:
        """bool[n, 3] of objects with a visible share in [low, high): ADD-S, turn, and both are good.

        Args:
          only: one object's name; all if None.
        """
        rows = [
            (adds is not None and adds < GOOD_ADDS, turn is not None and turn < GOOD_TURN)
            for each in self.moments
            for name, share, adds, turn in zip(
                each.objects, each.share, each.adds, each.turn, strict=True
            )
            if low <= share < high and only in (None, name)
        ]
        found = np.array(rows, bool).reshape(-1, 2)
        return np.column_stack([found, found.all(1)])

    def certainties(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all poses that were told: chances f64[n], features f64[n, 7], and which are right bool[n]."""
        rows = [
            (chance, features, is_right)
            for each in self.moments
            for chance, features, is_right in zip(
                each.certainty, each.features, each.is_estimate_right, strict=True
            )
            if any(features)
        ]
        chance, features, right = zip(*rows, strict=True) if rows else ((), (), ())
        return (
            np.array(chance),
            np.array(features).reshape(-1, len(FEATURES)),
            np.array(right, bool),
        )


@dataclass(frozen=True)
class PerceptionResult:
    """What perception found; printed, tables; segmenter: its name. rows: one for each setting."""

    segmenter: str
    rows: tuple[PerceptionRow, ...]

    def __str__(self) -> str:
        columns = ("masks", "cameras", "noise", "moments", "mean IoU", "found", "false", "CPU-s")
        # Of true masks there is nothing to tell.
        kinds = (None,) if self.segmenter == TRUE_MASKS else (False, True)
        masks = [
            (
                self.segmenter + (", corrected by poses" if corrected else ""),
                str(row.cameras),
                f"{row.noise:g}",
                str(len(row.moments)),
                *(("-",) * 3 if corrected is None else _mask_shares(row.masks(corrected))),
                f"{np.mean([m.cpu for m in row.moments]):.2f}",
            )
            for row in self.rows
            for corrected in kinds
        ]
        limits = f"ADD-S < {1e3 * GOOD_ADDS:g} mm", f"turn < {np.degrees(GOOD_TURN):g} deg", "both"
        poses = [
            (
                f"{low:.0%} to {min(high, 1):.0%} seen",
                str(row.cameras),
                f"{row.noise:g}",
                *_shares(row, low, high),
            )
            for row in self.rows
            for low, high in _SHARES
        ]
        told = [
            (
                f"{mean:.2f} told",
                str(row.cameras),
                f"{row.noise:g}",
                f"{share:.2f} right",
                str(count),
            )
            for row in self.rows
            for mean, share, count in reliability(*row.certainties()[::2])
        ]
        return "\n\n".join(
            [
                aligned_table(columns, masks),
                aligned_table(("", "cameras", "noise", *limits), poses),
                aligned_table(("certainty", "cameras", "noise", "", "poses"), told),
                aligned_table(("object", "poses", *limits), self._by_object()),
            ]
        )

    def _by_object(self) -> list[tuple[str, ...]]:
        """Of each object, all settings together, where it is well seen."""
        rows = []
        for name in self.rows[0].names:
            found = np.concatenate([row.right(only=name) for row in self.rows])
            if len(found):
                rows.append((name, str(len(found)), *(f"{each.mean():.3f}" for each in found.T)))
        return rows


def _mask_shares(told: MaskFigures) -> tuple[str, str, str]:
    """Mean IoU, objects found, and false masks."""
    return (
        f"{told.mean_iou:.3f}",
        share_of(told.found, told.visible),
        share_of(told.false, told.masks),
    )


def _shares(row: PerceptionRow, low: float, high: float) -> tuple[str, str, str]:
    right = row.right(low, high)
    a, b, c = (share_of(int(each.sum()), len(right)) for each in right.T)
    return a, b, c


def evaluate_perception(
    views: ViewSet,
    split: str,
    segmenter: str,
    cameras: Sequence[int],
    noise: Sequence[float],
    num_views: int | None,
    seed: int,
    out: Path | None,
    calibrate: bool = False,
) -> PerceptionResult:
    true_masks = segmenter == TRUE_MASKS
    if true_masks and calibrate:
        # Before an hour of work.
        raise ConfigError(
            "calibration with true masks", "a trained segmenter", "segmenter='runs/segmenter'"
        )
    folder = None if true_masks else segmenter_folder(segmenter)
    if calibrate and folder in {segmenter_folder(path) for path in embedded_segmenters().values()}:
        given = f"calibration of {segmenter!r}, which comes with the package"
        raise ConfigError(
            given, "a segmenter of your own", "a copy of its folder: segmenter='my_segmenter'"
        )
    known: Segmenter = _NoSegmenter(views.names) if folder is None else load_segmenter(folder)
    certainty = Certainty() if folder is None else read_certainty(folder)
    estimator = RegistrationEstimator(views.objects, views.support)
    finder = SceneFinder(views.objects, views.support, known, estimator, certainty)
    recipe = {
        "format": _FORMAT,
        "views": views.digest(split),
        "segmenter": TRUE_MASKS
        if folder is None
        else folder_hash(folder, ("record.json", "weights.npz")),
        "certainty": list(certainty.weights),
        "registration": finder_hash(),
        "seed": seed,
        "versions": versions(),
    }
    rows = []
    for number in cameras:
        for factor in noise:
            setting = recipe | {"split": split, "cameras": number, "noise": factor}
            # Another network, or another rule of certainty, has rows of its own.
            digest = json_digest(setting, 8)
            name = f"{split}-{number}-cameras-noise-{factor:g}-{digest}.jsonl"
            path = None if out is None else out / name
            file = RowStore(path, setting, JudgedMoment, "python -m studies.perception eval")
            moments = _judge_all(
                views, split, number, factor, num_views, seed, finder, file, true_masks
            )
            rows.append(PerceptionRow(number, factor, tuple(moments), views.names))
    result = PerceptionResult(segmenter, tuple(rows))
    if calibrate and folder is not None:
        _calibrate(result, folder)
    return result


def _judge_all(
    views: ViewSet,
    split: str,
    cameras: int,
    factor: float,
    num_views: int | None,
    seed: int,
    finder: SceneFinder,
    file: RowStore[JudgedMoment],
    true_masks: bool,
) -> list[JudgedMoment]:
    total = (num_views or int(views.split(split)["num_views"])) // cameras
    if not total:
        raise ConfigError(f"{num_views} views for {cameras} cameras", "one moment or more")
    rows = file.read(total)
    if len(rows) == total:
        return rows
    estimator = finder.estimator
    models = [estimator.model(k) for k in range(len(views.names))]
    title = f"{cameras} cameras, noise {factor:g}"
    moments = islice(_moments(views, split, cameras, total), len(rows), None)

    def judge(_: int) -> JudgedMoment:
        return judge_moment(
            next(moments), finder, models, REALSENSE.scale(factor), seed, true_masks
        )

    return file.complete(rows, total, judge, title, "moment")


def _moments(views: ViewSet, split: str, cameras: int, total: int) -> Iterator[list[StoredView]]:
    """Views that belong together: views 2 i and 2 i + 1 show the same moment."""
    stored = views.views(split, total * cameras)
    while moment := list(islice(stored, cameras)):
        yield moment


def _calibrate(result: PerceptionResult, folder: Path) -> None:
    """Fits the rule of certainty to all poses, and stores it beside the segmenter."""
    parts = [row.certainties()[1:] for row in result.rows]
    features = np.concatenate([each[0] for each in parts])
    right = np.concatenate([each[1] for each in parts])
    if not len(features):
        raise ConfigError(
            "calibration without any pose", "views in which objects are found", "more views"
        )
    write_certainty(folder, fit_certainty(features, right))


_PRIOR = 2.0
"""Strength of what holds the weights near to the usual ones, in poses."""
_STEPS = 50


def fit_certainty(features: np.ndarray, is_right: np.ndarray) -> Certainty:
    """The rule that fits P poses best (Newton's method): their features f[P, 7], which are right bool[P]."""
    usual = np.array(Certainty().weights)
    weights = usual.copy()
    prior = _PRIOR * np.eye(len(usual)) / 4
    for _ in range(_STEPS):
        chance = 1 / (1 + np.exp(-features @ weights))
        slope = features.T @ (chance - is_right) + prior @ (weights - usual)
        bend = (features * (chance * (1 - chance))[:, None]).T @ features + prior
        change = np.linalg.solve(bend, slope)
        weights = weights - change / max(1.0, float(np.linalg.norm(change)))
        if np.linalg.norm(change) < 1e-8:
            break
    return Certainty(tuple(weights.tolist()), len(features))


def write_certainty(folder: Path, certainty: Certainty) -> None:
    """Stores the rule beside a segmenter."""
    weights = dict(zip(FEATURES, certainty.weights, strict=True))
    stored = with_checksum({"weights": weights, "number": certainty.number})
    write_atomically(folder / CERTAINTY_FILE, (json.dumps(stored, indent=1) + "\n").encode())


def reliability(
    chance: np.ndarray, is_right: np.ndarray, bins: int = 5
) -> list[tuple[float, float, int]]:
    """Of each bin of chances f[P] that holds any: their mean, the share that was right bool[P], how many."""
    place = np.minimum((chance * bins).astype(int), bins - 1)
    rows = []
    for each in range(bins):
        inside = place == each
        if inside.any():
            rows.append(
                (float(chance[inside].mean()), float(is_right[inside].mean()), int(inside.sum()))
            )
    return rows
