"""How different a method's scenes are: sets of scenes, maps of objects, and what passes less often."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.evaluation.comparison import Column, request_columns
from cluttergen_jax.evaluation.diversity import embed
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from cluttergen_jax.plots import FONT, PAGE, colour, grid_of_panels, save
from cluttergen_jax.statistics import finite
from studies.cells import HEAD, SCENES, number_column
from studies.measures import diversity as measures
from studies.measures.acceptance import Bias, acceptance_bias
from studies.methods.density import SIZES, table_sizes
from studies.methods.table1 import ALL_METHODS, CLUTTERGEN
from studies.plots import label_of
from studies.rankings import by_question, ranking
from studies.rules import RULES, own_rules
from studies.study import Findings, Scale, Study, Successes, each_success, measure_each, row_of

TIGHT = table_sizes(SIZES[2])[0]
_LEAST_SHARE = 0.25
"""A method that hardly ever succeeds would leave the others too few scenes to be compared."""
_BOXES = number_column("bounding box, m^2", "box_area", 3)
_EVENNESS = number_column("evenness", "evenness", 3)


def papers_scenes(scale: Scale, full: int, quick: int) -> tuple[Trial, ...]:
    """All methods on a table of the paper's region and on a tight one, by the paper's rules."""
    base = scale.trial(full, quick)
    supports = table_sizes(SIZES[0], SIZES[2])
    return grid(base, pool=scale.pools_or("dining"), support=supports, method=ALL_METHODS)


def scenes_of(scale: Scale, full: int, quick: int) -> tuple[Trial, ...]:
    """The same, each method by its own rules."""
    return tuple(map(own_rules, papers_scenes(scale, full, quick)))


def _measure_sets(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Spatial entropy, nearest neighbours, Vendi score and boxes, all methods at equal counts."""
    rows: list[Row] = []
    groups: dict[tuple[str, str], list[tuple[Trial, Successes]]] = {}
    for trial, scenes in each_success(runner, trials, rows, _LEAST_SHARE):
        groups.setdefault((trial.pool_name, trial.support_name), []).append((trial, scenes))
    for group in groups.values():
        count = min(len(scenes) for _, scenes in group)
        rows += [row_of(trial, _set_figures(scenes, count)) for trial, scenes in group]
    note = "Figures depend on the number of scenes: each group is compared at equal counts."
    return Findings(rows, notes=[note])


def _set_figures(scenes: Successes, count: int) -> Row:
    world = scenes.world
    region = scenes.region
    poses = scenes.poses
    is_placed = scenes.is_placed
    vectors = embed(world.objects, poses, is_placed, region, world.support.top)

    def mean(figure: Callable[[np.ndarray], float]) -> float | None:
        return finite(measures.at_equal_count(figure, len(scenes), count)[0])

    def evenness(some: np.ndarray) -> float:
        return np.nanmean(measures.plan_entropy(poses[some], is_placed[some], region).evenness)

    return Row(
        scenes=count,
        evenness=mean(evenness),
        nearest=mean(lambda some: measures.nearest_distance(vectors[some]).mean()),
        vendi=mean(lambda some: measures.vendi_score(measures.scene_kernel(vectors[some], region))),
        box_area=mean(
            lambda some: np.nanmean(measures.plan_box_area(poses[some], is_placed[some], region))
        ),
    )


def _set_notes(rows: list[Row]) -> list[str]:
    return [
        "evenness: entropy of an object's position over 5 cm cells, 1 for an even spread, mean over objects",
        "nearest scene: distance to the most similar other scene; Vendi score: effective number of different "
        "scenes",
        "bounding box: the paper's measure, decided by outliers",
        *RULES,
        *(
            f"Vendi score on {support}, highest first: {ranking(group, 'vendi', 1)}"
            for support, group in by_question(rows, lambda row: row["support"]).items()
        ),
    ]


DIVERSITY = Study(
    "diversity",
    "How different the scenes of a method are",
    512,
    # Enough scenes that the rarer places are seen.
    lambda scale: scenes_of(scale, 512, 16),
    (
        *HEAD,
        SCENES,
        _EVENNESS,
        number_column("nearest scene, m", "nearest", 3),
        number_column("Vendi score", "vendi", 1),
        _BOXES,
    ),
    _set_notes,
    _measure_sets,
    says_margin=True,
)

# Where each object lies: plan views of the scenes of several methods side by side.

_MAP_SCENES = 500


def _papers_maps(scale: Scale) -> tuple[Trial, ...]:
    """The paper's setting, five objects of its first group; chance and ours beside its two heads."""
    base = scale.trial(_MAP_SCENES, 6, pool=scale.pools_or("dining")[0], num_objects=5)
    return grid(base, method=("random", "normal", CLUTTERGEN, "policy", "guided"))


def _measure_objects(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """The paper's bounding boxes, and how even the positions of each object are."""
    rows: list[Row] = []
    shown = []
    for trial, scenes in each_success(runner, trials, rows):
        of = (scenes.poses, scenes.is_placed, scenes.region)
        clusters, heaped = measures.plan_clusters(*of)
        figures = {
            "box_area": measures.plan_box_area(*of),
            "evenness": measures.plan_entropy(*of).evenness,
            "edges": measures.edge_share(*of),
            "clusters": clusters,
            "heaped": heaped,
        }
        shown.append((trial.method, scenes))
        for k, name in enumerate(scenes.world.names):
            found = {each: finite(values[k]) for each, values in figures.items()}
            rows.append(row_of(trial, object=name, scenes=len(scenes), **found))
    return Findings(rows, _maps(shown, stem) if shown else [])


def _maps(shown: Sequence[tuple[str, Successes]], stem: Path) -> list[str]:
    """Plan views of each object over at most 500 scenes, a row for each method."""
    names = shown[0][1].world.names
    figure, axes = grid_of_panels(len(shown) * len(names), len(names), PAGE / len(names), 0.9)
    panels = iter(axes)
    for method, scenes in shown:
        positions = measures.region_positions(scenes.poses[:_MAP_SCENES], scenes.region)
        for k, name in enumerate(names):
            axis = next(panels)
            here = scenes.is_placed[:_MAP_SCENES, k]
            if here.any():
                title = name.replace("_", " ") if method == shown[0][0] else ""
                _plan_view(axis, positions[here, k], scenes.region, colour(method), title)
            if k == 0:
                axis.set_ylabel(f"{label_of(method)}\nn = {here.sum():,}", fontsize=FONT)
    sides = (2 * each for each in shown[0][1].region.half_extents)
    figure.supxlabel(f"each region {' x '.join(f'{side:.2f}' for side in sides)} m", fontsize=FONT)
    return save(figure, stem)


def _plan_view(axis: Any, positions: np.ndarray, region: Rectangle, shade: str, title: str) -> None:
    """Positions f[N, 2] (region frame, metres) as dots, with the region and the box of extremes."""
    from matplotlib.patches import Rectangle as Patch

    (x, y) = region.half_extents
    low = positions.min(0)
    axis.add_patch(Patch((-x, -y), 2 * x, 2 * y, fill=False, color="#444444", linewidth=0.8))
    size = np.ptp(positions, axis=0)
    axis.add_patch(Patch(tuple(low), *size, fill=False, color=shade, linewidth=0.8, linestyle="--"))
    axis.plot(*positions.T, ".", markersize=2.6, alpha=0.5, color=shade, markeredgewidth=0)
    axis.set_xlim(-1.15 * x, 1.15 * x)
    axis.set_ylim(-1.15 * y, 1.15 * y)
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_visible(False)
    axis.set_title(title, fontsize=FONT - 1, pad=1)


DIVERSITY_MAPS = Study(
    "diversity_maps",
    "Where each object lies: Beta beside Normal",
    _MAP_SCENES,
    _papers_maps,
    (
        *request_columns("pool", "method"),
        Column("object", lambda row: row.get("object", "-"), is_asked=True),
        SCENES,
        _BOXES,
        _EVENNESS,
        # Results of older versions have none of these.
        number_column("along the edges", "edges", 3),
        number_column("clusters", "clusters", 0),
        number_column("in them", "heaped", 3),
    ),
    (
        "bounding box: the paper's measure, decided by outliers; evenness: entropy over 5 cm cells, 1 for an "
        "even spread; the picture shows at most 500 scenes",
        "along the edges: within a tenth of the region's side from an edge, "
        f"{1 - (1 - 2 * measures.EDGE_BAND) ** 2:.2f} for an even spread",
        "clusters: groups of 5 cm cells that the object is in more than three times too often, and how often "
        "it lies in one of them",
    ),
    _measure_objects,
)

# Acceptance bias: what passes less often than it is proposed.


def _biases(runner: Runner, trial: Trial, scenes: Successes) -> Iterator[Row]:
    """Lifts of objects, places, turns and slots: every proposal, and those that stand in valid scenes."""
    arrays = scenes.arrays
    action = arrays["attempt_action"]
    scene = arrays["attempt_scene"]
    sortings = acceptance_bias(
        scenes.world.names,
        arrays["attempt_object"],
        (2 * action[:, :2] - 1) * np.asarray(scenes.region.half_extents),
        2 * np.pi * action[:, 3],
        arrays["attempt_slot"],
        arrays["attempt_is_stable"] & arrays["is_success"][scene],
        scene,
        scenes.region,
    )
    for sorting, bias in sortings.items():
        proposals = int(bias.proposed.sum())
        passed = int(bias.passed.sum())
        yield Row(sorting=sorting, under=_under(bias), proposals=proposals, passed=passed)


def _under(bias: Bias) -> list[Row]:
    """What is under-represented, with the intervals of its lift."""
    return [
        {
            "label": bias.labels[c],
            "lift": float(bias.lift[c]),
            "low95": float(bias.low[c]),
            "high95": float(bias.high[c]),
        }
        for c in (bias.labels.index(label) for label in bias.under_represented)
    ]


def _under_text(row: Row) -> str:
    found = (
        f"{e['label']} {e['lift']:.2f} [{e['low95']:.2f}, {e['high95']:.2f}]"
        for e in row["under"][:5]
    )
    return "; ".join(found) or "nothing"


ACCEPTANCE = Study(
    "acceptance",
    "What passes less often than it is proposed",
    512,
    # By the paper's rules: every object proposed in its turn, none taken away.
    lambda scale: papers_scenes(scale, 512, 16),
    (
        *HEAD,
        Column("sorted by", lambda row: row["sorting"]),
        Column("proposals", lambda row: str(row["proposals"])),
        Column("passed", lambda row: str(row["passed"])),
        Column("under-represented: lift [95 %]", _under_text),
    ),
    (
        "lift: share among proposals that stand in a valid scene over share among all proposals; 1 is "
        "no bias",
        "shown are at most five whose whole interval lies below 1; intervals are bootstrapped over scenes",
    ),
    measure_each(_biases),
)
