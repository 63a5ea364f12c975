"""The study `perception`: known objects found in noisy images, by this project's own segmenter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.placer.evaluate import Row, with_interval
from cluttergen_jax.statistics import proportion, share_row
from cluttergen_jax.tables import Table
from studies.downstream.suite_folder import SuiteFolder
from studies.perception.api import perception_data, perception_eval
from studies.perception.evaluate import TRUE_MASKS, PerceptionResult, PerceptionRow
from studies.perception.scoring import MaskFigures
from studies.study import Findings, Study

POOL = "household"
_HEAD = ("masks", "cameras", "noise", "moments")
_MASKS = ("mean IoU", "found", "false")
_POSES = ("ADD-S < 5 mm", "turn < 5 deg", "both", "CPU-s")
_NOTES = (
    "scenes, table textures and cameras that training has not seen",
    "masks `true`: the true ones, so that poses alone are judged",
    "poses of objects of which 30 % or more of the silhouette is seen; turns up to symmetry",
)
_MASK_NOTES = (
    "found: objects of 150 pixels or more of which the mask overlaps the true one by half; false: masks "
    "mostly of something else",
    "corrected by poses: a pixel whose depth is that of an object where it was found shows that object; "
    "poses are sought of those objects that are there, which the segmenter alone is not told",
)


def _find_objects(suite: SuiteFolder, masks: Sequence[str], stem: Path) -> Findings:
    """True masks, then the segmenter's; one camera and two; noise off and on."""
    number = suite.scale.number(300, 2)
    seed = suite.scale.seed
    views = perception_data(
        suite.folder / "data" / f"views-{number}-{seed}",
        pool=POOL,
        num_views=number,
        split="test",
        seed=seed,
        num_threads=suite.num_threads,
    )
    out = suite.folder / "moments"
    if suite.fresh:
        for old in out.glob("*.jsonl"):
            old.unlink()
    found = [perception_eval(views.path, each, seed=seed, out=out) for each in masks]
    rows = [row_of(result, row) for result in found for row in result.rows]
    return Findings(rows, tables=tables_of(rows))


def row_of(result: PerceptionResult, row: PerceptionRow) -> Row:
    """What was found in the moments of one setting."""
    right = dict(zip(("adds", "turn", "both"), row.right().T, strict=True))
    figures: Any = {name: proportion(each) for name, each in right.items()}
    if result.segmenter != TRUE_MASKS:
        figures |= {
            "segmenter": _masks(row.masks()),
            "corrected": _masks(row.masks(corrected=True)),
        }
    figures["cpu"] = float(np.mean([each.cpu for each in row.moments]))
    trial = {
        "segmenter": result.segmenter,
        "cameras": row.cameras,
        "noise": row.noise,
        "moments": len(row.moments),
    }
    return {"trial": trial, "figures": figures}


def _masks(figures: MaskFigures) -> Row:
    return {
        "mean_iou": figures.mean_iou,
        "found": share_row(figures.found, figures.visible),
        "false": share_row(figures.false, figures.masks),
    }


def tables_of(rows: list[Row]) -> list[Table]:
    """Of masks, by the segmenter alone and as poses correct them; and of poses."""
    masks = []
    poses = []
    for row in rows:
        asked = row["trial"]
        figures = row["figures"]
        name, *setting = (
            asked["segmenter"],
            str(asked["cameras"]),
            f"{asked['noise']:g}",
            str(asked["moments"]),
        )
        for kind, title in (("segmenter", name), ("corrected", f"{name}, corrected by poses")):
            if kind in figures:
                found = figures[kind]
                shares = (with_interval(found[each]) for each in ("found", "false"))
                masks.append((title, *setting, f"{found['mean_iou']:.3f}", *shares))
        right = (with_interval(figures[each]) for each in ("adds", "turn", "both"))
        poses.append((name, *setting, *right, f"{figures['cpu']:.2f}"))
    return [
        Table(
            f"Pixels of objects of {POOL}",
            (*_HEAD, *_MASKS),
            tuple(masks),
            (_NOTES[0], *_MASK_NOTES),
        ),
        Table(f"Poses of objects of {POOL}", (*_HEAD, *_POSES), tuple(poses), _NOTES),
    ]


PERCEPTION = Study(
    "perception",
    "Known objects and their poses in noisy images",
    1,
    # The true masks, then the segmenter's.
    lambda scale: (TRUE_MASKS, POOL),
    measure=_find_objects,
    brings_tables=True,
    needs_robot=True,
)
