"""The study `perception`: known objects found in noisy images, by this project's own segmenter."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.downstream.perception.evaluation.evaluate import (
    TRUE_MASKS,
    PerceptionResult,
    PerceptionRow,
)
from cluttergen_jax.downstream.placer.evaluation.tables import Row, with_interval
from cluttergen_jax.downstream.studies.study import DownstreamStudy, Found, SuiteFolder
from cluttergen_jax.proportions import counted, proportion
from cluttergen_jax.tables import Table

POOL = "household"
_VIEWS, _QUICK_VIEWS = 300, 4
_COLUMNS = (
    *("masks", "cameras", "noise", "moments", "mean IoU", "found", "false", "ADD-S < 5 mm", "turn < 5 deg"),
    *("both", "CPU-s"),
)
_NOTES = (
    "scenes, table textures and cameras that training has not seen; masks `true`: the true ones, so that "
    "poses alone are judged",
    "found: objects of 150 pixels or more of which the mask overlaps the true one by half; false: masks "
    "mostly of something else",
    "poses of objects of which 30 % or more of the silhouette is seen; turns up to symmetry",
)


def run(suite: SuiteFolder) -> Found:
    """True masks, then the segmenter's; one camera and two; noise off and on."""
    number, seed = suite.scale.scenes(_VIEWS, _QUICK_VIEWS), suite.scale.seed
    views = suite.calls.perception_data(
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
    asked = (TRUE_MASKS, POOL)
    found = [suite.calls.perception_eval(views.path, each, seed=seed, out=out) for each in asked]
    rows = [row_of(result, row) for result in found for row in result.rows]
    return Found(rows, [_table(rows)])


def row_of(result: PerceptionResult, row: PerceptionRow) -> Row:
    """What was found in the moments of one setting."""
    figures = {"adds": row.right()[:, 0], "turn": row.right()[:, 1], "both": row.right()[:, 2]}
    shares: dict[str, object] = {name: proportion(each) for name, each in figures.items()}
    if result.segmenter != TRUE_MASKS:
        found, visible, false, masks = (
            sum(getattr(each, name) for each in row.moments)
            for name in ("found", "visible", "false", "masks")
        )
        shares["mean_iou"] = row.mean_iou
        shares["found"] = counted(found, visible)
        shares["false"] = counted(false, masks)
    shares["cpu"] = float(np.mean([each.cpu for each in row.moments]))
    trial = {
        "segmenter": result.segmenter,
        "cameras": row.cameras,
        "noise": row.noise,
        "moments": len(row.moments),
    }
    return {"trial": trial, "figures": shares}


def _table(rows: list[Row]) -> Table:
    cells = []
    for row in rows:
        asked, figures = row["trial"], row["figures"]
        masks = (
            (f"{figures['mean_iou']:.3f}", with_interval(figures["found"]), with_interval(figures["false"]))
            if "mean_iou" in figures
            else ("-",) * 3
        )
        poses = [with_interval(figures[name]) for name in ("adds", "turn", "both")]
        head = (asked["segmenter"], str(asked["cameras"]), f"{asked['noise']:g}", str(asked["moments"]))
        cells.append((*head, *masks, *poses, f"{figures['cpu']:.2f}"))
    return Table(f"Objects of {POOL} in images of two cameras", _COLUMNS, tuple(cells), _NOTES)


PERCEPTION = DownstreamStudy("perception", "Known objects and their poses in noisy images", run, True)
