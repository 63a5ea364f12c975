"""What a scene costs against the number of its objects, of the scenes, and of the convex parts.

    python -m studies.benchmarks.cost [--write]

CPU-seconds of the whole process, all threads. Compilation and the first block of 256 scenes are left out.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.generation import Sampler, make_sampler
from cluttergen_jax.placement.rollout import BLOCK_SIZE, blocks_of, sample_blocks
from cluttergen_jax.plots import new_figure, prepare, save
from studies.benchmarks.section import IMAGES, prose, report, table
from studies.plots import add_legend

_POOL = "all"
_SUPPORT = "table-0.80x1.00"
_TEN = 10
_MILLISECONDS = (20, 50, 100, 200, 500)
"""Ticks of the picture."""


@dataclass(frozen=True)
class Cost:
    """Measure what scenes cost.

    Attributes:
      methods: that make them.
      objects: numbers of objects in a scene.
      scenes: numbers of scenes made in one go.
      groups: of the pool's objects, sorted by their convex parts; each fills tables.
      write: renew this program's section of reports/benchmarks.md, and its picture.
    """

    methods: tuple[str, ...] = ("clear", "guided")
    objects: tuple[int, ...] = (5, 10, 20, 30, 40)
    scenes: tuple[int, ...] = (256, 512, 1024, 2048)
    groups: int = 5
    write: bool = False


@dataclass(frozen=True)
class Point:
    """One measurement: at `x`, CPU-milliseconds a scene that was made, and the share that stands."""

    x: float
    milliseconds: float
    success: float


def measured(sampler: Sampler, num_scenes: int, x: float) -> Point:
    """The cost of scenes after a block that is not counted."""
    started = 0.0
    good = 0
    for block, _, scenes in sample_blocks(
        sampler.steps, blocks_of(BLOCK_SIZE + num_scenes), seed=0
    ):
        if block == 0:
            started = time.process_time()
        else:
            good += int(scenes.is_success.sum())
    return Point(x, 1e3 * (time.process_time() - started) / num_scenes, good / num_scenes)


def against_objects(method: str, numbers: Sequence[int]) -> list[Point]:
    """Scenes of so many objects of all pools on a wide table."""
    made = (
        make_sampler(pool=_POOL, support=_SUPPORT, method=method, num_objects=each)
        for each in numbers
    )
    return [
        measured(sampler, BLOCK_SIZE, each) for sampler, each in zip(made, numbers, strict=True)
    ]


def against_scenes(method: str, numbers: Sequence[int]) -> list[Point]:
    """So many scenes of ten objects of dining in one go."""
    sampler = make_sampler(pool="dining", method=method)
    return [measured(sampler, each, each) for each in numbers]


def against_parts(method: str, groups: int) -> list[Point]:
    """Scenes of ten objects, by the number of convex parts of the ten."""
    ordered = sorted(find_pool(_POOL).objects, key=lambda asset: len(asset.parts))
    points = []
    for group in np.array_split(np.arange(len(ordered)), groups):
        chosen = [ordered[index] for index in group[:_TEN]]
        sampler = make_sampler(
            pool=_POOL,
            objects=tuple(asset.name for asset in chosen),
            support=_SUPPORT,
            method=method,
        )
        points.append(measured(sampler, BLOCK_SIZE, sum(len(asset.parts) for asset in chosen)))
    return points


def slope(points: Sequence[Point]) -> float:
    """The power of x with which the cost grows: a straight line through the logarithms."""
    x, y = (np.log([getattr(point, name) for point in points]) for name in ("x", "milliseconds"))
    return float(np.polyfit(x, y, 1)[0])


def _section(title: str, about: str, of: str, found: dict[str, list[Point]]) -> str:
    points = next(iter(found.values()))
    header = [
        of,
        *(f"{name}: CPU ms a scene" for name in found),
        *(f"{name}: stand" for name in found),
    ]
    rows = [
        [
            f"{point.x:,.0f}",
            *(f"{each[place].milliseconds:.1f}" for each in found.values()),
            *(f"{each[place].success:.3f}" for each in found.values()),
        ]
        for place, point in enumerate(points)
    ]
    powers = ", ".join(f"{slope(each):.2f} with `{name}`" for name, each in found.items())
    words = f"The cost of a scene grows with the power {powers} of the number of {of}."
    return "\n\n".join([f"### {title}", prose(about), table(header, rows), words])


def _draw(found: dict[str, dict[str, list[Point]]], stem: Path) -> None:
    figure = new_figure(9.0, 3.0)
    for place, (of, methods) in enumerate(found.items()):
        axis = figure.add_subplot(1, len(found), place + 1)
        prepare(axis, f"against {of}", of, "CPU ms a scene")
        for name, points in methods.items():
            axis.plot(
                [each.x for each in points],
                [each.milliseconds for each in points],
                marker="o",
                label=name,
            )
        axis.set_xscale("log")
        axis.set_yscale("log")
        # Ticks where it was measured: Matplotlib's own, of powers of ten, are too few here.
        places = sorted({point.x for points in methods.values() for point in points})
        axis.set_xticks(places, [f"{x:g}" for x in places])
        axis.set_yticks(_MILLISECONDS, [f"{y:g}" for y in _MILLISECONDS])
        axis.minorticks_off()
    add_legend(figure)
    save(figure, stem, ("png",))


def main(options: Cost) -> None:
    """Measures, prints, and renews the section and the picture if asked."""
    found = {
        "objects": {name: against_objects(name, options.objects) for name in options.methods},
        "scenes": {name: against_scenes(name, options.scenes) for name in options.methods},
        "convex parts": {name: against_parts(name, options.groups) for name in options.methods},
    }
    abouts = {
        "objects": f"""{BLOCK_SIZE} scenes of objects of all pools on {_SUPPORT}; those that fail are counted,
        too.""",
        "scenes": "Ten objects of dining on the usual table, in blocks of 256.",
        "convex parts": f"""{BLOCK_SIZE} scenes of ten objects of all pools on {_SUPPORT}: those with the
        fewest convex parts, the next ones, and so on; the number is that of all ten together.""",
    }
    parts = [_section(f"Against {of}", abouts[of], of, methods) for of, methods in found.items()]
    text = "\n\n".join(["## What a scene costs", *parts])
    report("cost", f"{text}\n\n![Cost of a scene](images/cost.png)", write=options.write)
    if options.write:
        _draw(found, IMAGES / "cost")


if __name__ == "__main__":
    main(tyro.cli(Cost))
