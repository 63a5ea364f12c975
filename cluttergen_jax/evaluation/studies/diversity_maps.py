"""Diversity maps: where each object lies, plan views of the scenes of several methods side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation import plots
from cluttergen_jax.evaluation.cells import Column, Row, asked, number, table_of
from cluttergen_jax.evaluation.measures.arrangement import region_positions
from cluttergen_jax.evaluation.measures.diversity import (
    EDGE_BAND,
    edge_share,
    plan_box_area,
    plan_clusters,
    plan_entropy,
)
from cluttergen_jax.evaluation.plots import colour, label_of, save
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.findings import Findings, Successes, each_standing, row_of
from cluttergen_jax.evaluation.studies.study import Result, Scale, Study, grid
from cluttergen_jax.evaluation.studies.table1 import CLUTTERGEN
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.statistics import finite
from cluttergen_jax.tables import Table

_MAP_SCENES = 500


def measure(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """The paper's bounding boxes, and how even the positions of each object are."""
    rows: list[Row] = []
    shown = []
    for trial, scenes in each_standing(runner, trials, rows):
        boxes = plan_box_area(scenes.poses, scenes.is_placed, scenes.region)
        entropy = plan_entropy(scenes.poses, scenes.is_placed, scenes.region)
        edges = edge_share(scenes.poses, scenes.is_placed, scenes.region)
        clusters, heaped = plan_clusters(scenes.poses, scenes.is_placed, scenes.region)
        shown.append((trial.method, scenes))
        rows += [
            row_of(
                trial,
                object=name,
                scenes=len(scenes),
                box_area=finite(boxes[k]),
                evenness=finite(entropy.evenness[k]),
                edges=finite(edges[k]),
                clusters=finite(clusters[k]),
                heaped=finite(heaped[k]),
            )
            for k, name in enumerate(scenes.world.names)
        ]
    return Findings(rows, _maps(shown, stem) if shown else [])


def _maps(shown: Sequence[tuple[str, Successes]], stem: Path) -> list[str]:
    """Plan views of each object over at most 500 scenes, a row for each method."""
    names = shown[0][1].world.names
    figure, axes = plots.grid(len(shown) * len(names), len(names), 1.25, 1.6)
    panels = iter(axes)
    for method, scenes in shown:
        positions = region_positions(scenes.poses[:_MAP_SCENES], scenes.region)
        for k, name in enumerate(names):
            axis, here = next(panels), scenes.is_placed[:_MAP_SCENES, k]
            if here.any():
                _plan_view(axis, positions[here, k], scenes.region, colour(method), name)
            if k == 0:
                axis.set_ylabel(label_of(method), fontsize=9)
    return save(figure, stem)


def _plan_view(axis: Any, positions: np.ndarray, region: Rectangle, shade: str, title: str) -> None:
    """Positions f[N, 2] (region frame, metres) as dots, with the region and the box between extremes."""
    from matplotlib.patches import Rectangle as Patch

    (x, y), low = region.half_extents, positions.min(0)
    axis.add_patch(Patch((-x, -y), 2 * x, 2 * y, fill=False, color="#444444", linewidth=0.8))
    size = np.ptp(positions, axis=0)
    axis.add_patch(Patch(tuple(low), *size, fill=False, color=shade, linewidth=0.8, linestyle="--"))
    axis.plot(*positions.T, ".", markersize=2.0, alpha=0.45, color=shade)
    axis.set_xlim(-1.15 * x, 1.15 * x)
    axis.set_ylim(-1.15 * y, 1.15 * y)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.set_title(title, fontsize=8)


def tables(result: Result) -> list[Table]:
    """A line for each object."""
    columns = (
        *asked("pool", "method"),
        Column("object", lambda row: row.get("object", "-"), is_asked=True),
        Column("scenes", lambda row: str(row["scenes"])),
        Column("bounding box, m^2", lambda row: number(row["box_area"], 3)),
        Column("evenness", lambda row: number(row["evenness"], 3)),
        # Results of older versions have none of these.
        Column("along the edges", lambda row: number(row.get("edges"), 3)),
        Column("clusters", lambda row: number(row.get("clusters"), 0)),
        Column("in them", lambda row: number(row.get("heaped"), 3)),
    )
    notes = (
        "bounding box: the paper's measure, decided by outliers; evenness: entropy over 5 cm cells, 1 for an "
        "even spread; the picture shows at most 500 scenes",
        "along the edges: within a tenth of the region's side from an edge, "
        f"{1 - (1 - 2 * EDGE_BAND) ** 2:.2f} for an even spread",
        "clusters: groups of 5 cm cells that the object is in more than three times too often, and how often "
        "it lies in one of them",
    )
    return [table_of(result["title"], columns, result["measure"]["rows"], notes)]


def trials(scale: Scale) -> tuple[Trial, ...]:
    """The paper's setting, five objects of its first group; chance and ours beside its two heads."""
    base = scale.trial(_MAP_SCENES, 6, pool=scale.chosen("dining")[0], num_objects=5)
    return grid(base, method=("random", "normal", CLUTTERGEN, "policy"))


DIVERSITY_MAPS = Study(
    "diversity_maps", "Where each object lies: Beta beside Normal", _MAP_SCENES, trials, tables, measure
)
