"""All that is to be known of a GPU, in parts that fit in nine minutes each.

    python -m studies.benchmarks.gpu [--parts doctor agreement ...] [--out FOLDER]
    python -m studies.benchmarks.gpu --parts scenes --engines warp --lanes 8192
    python -m studies.benchmarks.gpu --write

A row is stored in `--out` as soon as it is made, and not made again. A call ends between two rows, before its
minutes are over; the same command goes on. Give large numbers of scenes side by side a call each: one that
went through all of them ran out of the GPU's memory. `--small` is the miniature that any machine can run; its
rows and runs lie in `small/` below `--out`, apart from those of full size.
"""

from __future__ import annotations

import datetime
import re
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import shorten

import jax
import tyro

from cluttergen_jax.assets.pool import Pool, find_pool, write_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.records import machine
from cluttergen_jax.physics.mjx import room_for
from cluttergen_jax.placement.world import make_world
from studies.benchmarks import gpu_engines, gpu_training
from studies.benchmarks.bodies import box
from studies.benchmarks.rows import Cases, OutOfTimeError, Row, Rows, columns
from studies.benchmarks.section import PAGE, prose, replace_section, table, version_of
from studies.results import sentence

PARTS = ("doctor", "agreement", "steps", "scenes", "share", "tune", "paper")


@dataclass(frozen=True)
class Gpu:
    """Measure what a GPU does.

    Attributes:
      parts: which, in this order; all if none is named.
      lanes: scenes side by side, in place of 512, 2,048, 8,192 and 16,384.
      engines: of `gpu_engines.WARP`, and native; all if none is named.
      out: where rows and runs are kept.
      minutes: after which a call ends.
      small: a miniature of everything on three boxes, for any machine; its figures say nothing.
      retry: make rows again that failed.
      write: no measurement; put the rows that are there into reports/benchmarks.md.
    """

    parts: tuple[str, ...] = ()
    lanes: tuple[int, ...] = ()
    engines: tuple[str, ...] = ()
    out: Path = Path("out/gpu")
    minutes: float = 9.0
    small: bool = False
    retry: bool = False
    write: bool = False

    @property
    def folder(self) -> Path:
        """Of rows and runs: those of a miniature bear the same names as those of full size."""
        return self.out / "small" if self.small else self.out


@dataclass(frozen=True)
class Scales:
    """How much of everything."""

    engines: gpu_engines.Scale = field(default_factory=gpu_engines.Scale)
    training: gpu_training.Scale = field(default_factory=gpu_training.Scale)


def small(out: Path) -> Scales:
    """Three boxes, two scenes side by side, updates of a few attempts."""
    boxes = [box(f"box-{side}", (0.03, 0.03, side / 100), 0.2) for side in (2, 3, 4)]
    pool = str(write_pool(out / "pool", Pool("boxes", tuple(boxes)), overwrite=True))
    ppo = {"num_envs": 4, "num_steps": 4, "num_minibatches": 2, "num_epochs": 1}
    network = {"object_points": 64, "object_features": 8, "scene_points": 64, "scene_features": 8}
    network |= {"num_centroids": 8, "group_size": 4}
    return Scales(
        gpu_engines.Scale(
            pool=pool,
            num_objects=2,
            num_attempts=2,
            block=2,
            lanes=(2,),
            begun=2,
            engines=("native", "warp", "warp, not compacted"),
            cases=(("clear", "whole check"),),
            awake_steps=2,
        ),
        gpu_training.Scale(
            pool=pool,
            num_objects=2,
            engine="native",
            num_envs=(None,),
            repeats=1,
            num_attempts=32,
            paper_attempts=16,
            runs=gpu_training.SWEEP[:1],
            ppo=tuple(ppo.items()),
            network=tuple(network.items()),
            evaluates=4,
        ),
    )


def doctor(scale: gpu_engines.Scale, is_small: bool) -> Cases:
    """What the machine is, what is installed, and how much room a scene is given."""

    def devices() -> Row:
        command = [sys.executable, "-m", "cluttergen_jax", "doctor"]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        print(said)
        memory = jax.devices()[0].memory_stats() or {}
        return {
            "machine": f"{sentence(machine())}, warp-lang {version_of('warp-lang')}",
            "small": is_small,
            "date": datetime.date.today().isoformat(),
            "devices": [str(device) for device in jax.devices()],
            "GB": memory.get("bytes_limit", 0) / 1e9,
            "says": said.splitlines(),
        }

    def room() -> Row:
        objects = find_pool(scale.pool).objects
        support = find_support(scale.support)
        world = make_world(objects, support, StabilityConfig(), ContactConfig())
        contacts, rows = room_for(world.layout)
        return {"contacts": contacts, "constraint rows": rows, "objects": world.num_objects}

    yield "machine", devices
    yield "room of a scene", room


def parts_of(scales: Scales, rows: Rows, is_small: bool) -> dict[str, Cases]:
    """The cases of every part, none of them made yet."""
    engines = scales.engines
    training = scales.training
    runs = rows.file.parent / "runs"

    def left() -> float:
        return rows.seconds_left

    return {
        "doctor": doctor(engines, is_small),
        "agreement": gpu_engines.agreement(engines),
        "steps": gpu_engines.steps(engines),
        "scenes": gpu_engines.scenes(engines),
        "share": gpu_training.share(training),
        "tune": gpu_training.tune(training, runs, left),
        "paper": gpu_training.paper(training, runs, left),
    }


def chosen(scale: gpu_engines.Scale, args: Gpu) -> gpu_engines.Scale:
    """The scenes side by side and the engines that were asked for, where any were."""
    for engine in args.engines:
        if engine not in scale.engines:
            known = ", ".join(scale.engines)
            raise ConfigError(f"engine {engine!r}", known, meant=closest(engine, scale.engines))
    kept = {
        name: tuple(
            each for each in getattr(scale, name) if not args.engines or each in args.engines
        )
        for name in ("engines", "compared")
    }
    return replace(scale, lanes=args.lanes or scale.lanes, **kept)


def measure(args: Gpu) -> Rows:
    """Makes rows until all are there or the time is up."""
    for part in args.parts:
        if part not in PARTS:
            raise ConfigError(f"part {part!r}", ", ".join(PARTS), meant=closest(part, PARTS))
    args.folder.mkdir(parents=True, exist_ok=True)
    rows = Rows(args.folder / "rows.json", args.minutes, args.retry, say=_say)
    scales = small(args.folder) if args.small else Scales()
    scales = replace(scales, engines=chosen(scales.engines, args))
    cases = parts_of(scales, rows, args.small)
    try:
        for part in args.parts or PARTS:
            rows.make(part, cases[part])
    except OutOfTimeError as error:
        _say(f"time is up before {error}; the same command goes on")
    return rows


def _say(text: str) -> None:
    print(text, flush=True)


@dataclass(frozen=True)
class Layout:
    """How a part is shown: what it is, and its fields in order."""

    about: str
    fields: tuple[str, ...]


LAYOUTS = {
    "agreement": Layout(
        """Attempts recorded with native, given to each engine: `equal` have native's verdict; distances are
        of objects in those that both found stable.""",
        ("attempts", "equal", "overflow", "median mm", "99 % mm", "others"),
    ),
    "steps": Layout(
        """The engine alone, second call. `as used`: steps of attempts, each ended by its own verdict,
        `longest` the last of them; `awake`: finished scenes, everything awake.""",
        (
            "attempts/s",
            "steps/s as used",
            "longest",
            "steps/s awake",
            "overflow",
            "compile s",
            "MB",
        ),
    ),
    "scenes": Layout(
        """The whole program, with `generate`'s rules; so many scenes side by side, and where one is over the
        next takes its place. `no check`: one step in place of the last check.""",
        (
            "begun",
            "success",
            "attempts/s",
            "steps/s",
            "finished scenes/s",
            "compile s",
            "MB at most",
        ),
    ),
    "share": Layout(
        """Shares of an update of preset `gpu`, parts timed alone.""",
        (
            "attempts/s",
            "update s",
            "physics",
            "encoder and heads",
            "the rest of the rollout",
            "learning",
        ),
    ),
    "tune": Layout(
        """Runs of preset `gpu`, one thing changed in each, until the success while training over ten updates
        is 0.95; compilation is not counted.""",
        ("attempts to 0.95", "seconds to 0.95", "attempts", "seconds", "success", "whole check"),
    ),
    "paper": Layout(
        """Preset `paper` at full size.""",
        ("accuracy", "attempts", "seconds", "success", "whole check"),
    ),
}


def body_of(rows: Rows) -> str:
    """The section of reports/benchmarks.md, from the rows that are there."""
    facts = rows.of("doctor").get("machine", {})
    text = ["## GPU"] + ["A miniature: its figures say nothing."] * bool(facts.get("small"))
    for part, layout in LAYOUTS.items():
        found = {name: _flat(row) for name, row in sorted(rows.of(part).items(), key=_in_order)}
        if found:
            lines = table(["", *layout.fields], columns(found, layout.fields))
            text += [f"### {part}", prose(layout.about), lines]
    failed = [
        f"{part}: {name}: {shorten(row['failed'], 160)}"
        for part, made in rows.parts.items()
        for name, row in made.items()
        if "failed" in row
    ]
    if failed:
        text += ["Not made:", "\n".join(f"- {each}" for each in failed)]
    text += [
        f"`python -m studies.benchmarks.gpu`, {facts.get('date', '')}; "
        f"{facts.get('machine', 'machine unknown')}."
    ]
    return "\n\n".join(text)


def _in_order(named: tuple[str, Row]) -> list[str | int]:
    """Rows of an engine together, by the numbers in their names."""
    parts = re.split(r"(\d+)", named[0])
    return [int(part) if part.isdigit() else part for part in parts]


def _flat(row: Row) -> Row:
    """A row with what is nested in it in words."""
    return {
        name: ", ".join(f"{key}: {each}" for key, each in value.items())
        if isinstance(value, dict)
        else value
        for name, value in row.items()
    }


def main(args: Gpu, page: Path = PAGE) -> None:
    """Measures, or writes what was measured."""
    if not args.write:
        measure(args)
        return
    body = body_of(Rows(args.folder / "rows.json"))
    print(body)
    replace_section(page, "gpu", body)


if __name__ == "__main__":
    main(tyro.cli(Gpu))
