"""What a million scenes take on 1, 16 and 256 workers, from small runs on a local Ray cluster of 1 and 2.

    python -m studies.benchmarks.plan [--write]

It needs the extra `ray`. What was measured and what is derived stands in tables of their own.
"""

from __future__ import annotations

import math
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank.blocks import SHARD_BLOCKS
from studies.benchmarks.big_bank import Sample, watch
from studies.benchmarks.section import prose, report, table

_EVERY = 2.0
_MEASURED = (1, 2)


@dataclass(frozen=True)
class Rates:
    """What a run showed, from the first scenes that were told to the last.

    Attributes:
      a_second: scenes a second of all workers, by the clock.
      a_core_second: scenes for a second of the workers' processor time, which other load hardly changes.
      driver: seconds of the command's own processor time for a scene.
    """

    a_second: float
    a_core_second: float
    driver: float


@dataclass(frozen=True)
class Plan:
    """Measure small runs, and derive what large ones take, if a worker has a core to itself.

    Attributes:
      out: where banks are made; they are made anew.
      num_scenes: of a measured run; num_planned: of what is derived.
      workers: of what is derived.
      pool, method: of `cluttergen generate`.
      core_hour: price of a core for an hour.
      write: put the section into reports/benchmarks.md.
    """

    out: Path = Path("out/plan")
    num_scenes: int = 8192
    num_planned: int = 1_000_000
    workers: tuple[int, ...] = (1, 16, 256)
    pool: str = "dining"
    method: str = "guided"
    core_hour: float = 0.04
    write: bool = False

    def run(self) -> None:
        """Runs both, and prints the tables."""
        found = {number: self.measure(number) for number in _MEASURED}
        report("plan", self.section(found), write=self.write, packages=_PACKAGES)

    def bank(self, workers: int) -> Path:
        """The bank that so many workers made."""
        return self.out / f"by_{workers}"

    def measure(self, workers: int) -> Rates:
        """What a run with so many workers shows."""
        shutil.rmtree(self.bank(workers), ignore_errors=True)
        options = {
            "out": self.bank(workers),
            "num-scenes": self.num_scenes,
            "pool": self.pool,
            "method": self.method,
            "cluster": "local",
            "workers": workers,
            "max-files": 0,
        }
        words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
        command = [sys.executable, "-m", "cluttergen_jax", "generate", *words]
        return rates_of(watch(command, _EVERY))

    def section(self, found: dict[int, Rates]) -> str:
        """What was found, in Markdown."""
        one = found[_MEASURED[0]]
        files = [each for each in self.bank(1).rglob("*") if each.is_file()]
        rows = [each for each in files if each.name.startswith("scenes-")]
        size = sum(each.stat().st_size for each in rows) / self.num_scenes
        others = sum(each.stat().st_size for each in files) - size * self.num_scenes
        folders = sum(each.is_dir() for each in self.bank(1).rglob("*")) + 1
        num_blocks = math.ceil(self.num_planned / BLOCK_SIZE)
        num_shards = math.ceil(num_blocks / SHARD_BLOCKS)
        num_files = len(files) - len(rows) + num_shards
        seen = table(
            ("workers", "scenes a second", "a second of a core", "ms of the command a scene"),
            [
                (
                    number,
                    f"{each.a_second:.2f}",
                    f"{each.a_core_second:.2f}",
                    f"{1000 * each.driver:.3f}",
                )
                for number, each in found.items()
            ],
        )
        derived = table(
            ("workers", "core-hours", "hours", "price", "busy share of the command"),
            [self.derive(number, one) for number in self.workers],
        )
        intro = prose(
            f"""{self.num_scenes:,} scenes of ten objects of {self.pool} by `{self.method}` on a local Ray
            cluster, measured:"""
        )
        kept = prose(
            f"""Derived from the row of one worker, not measured: {self.num_planned:,} scenes are
            {num_files} files ({num_shards} of rows, where {num_blocks:,} blocks go into shards of
            {SHARD_BLOCKS}), {num_files + folders} inodes, and
            {(size * self.num_planned + others) / 1e6:,.0f} MB; while it runs, up to {SHARD_BLOCKS} files of
            blocks more. They take, at {self.core_hour:g} for a core-hour and one core a worker:"""
        )
        most = 1 / (one.a_core_second * one.driver)
        end = f"The command writes all blocks: above {most:,.0f} workers they would wait for it."
        return "\n\n".join(("## A million scenes, planned", intro, seen, kept, derived, end))

    def derive(self, workers: int, one: Rates) -> tuple[str, ...]:
        """A row: what so many workers take if each is as fast as one alone."""
        own = self.num_planned * one.driver
        seconds = max(self.num_planned / (one.a_core_second * workers), own)
        # Workers that wait are paid, too.
        hours = seconds * workers / 3600
        return (
            f"{workers}",
            f"{hours:,.1f}",
            f"{seconds / 3600:,.2f}",
            f"{hours * self.core_hour:,.2f}",
            f"{own / seconds:.1%}",
        )


_PACKAGES = ("mujoco", "jax", "ray")


def rates_of(samples: list[Sample]) -> Rates:
    """From when scenes were first told of to when the last were (SystemExit: too few are told of)."""
    # Workers end before the command does, and their processor time is gone with them.
    end = max(range(len(samples)), key=lambda place: samples[place].workers_seconds)
    told = [each for each in samples[: end + 1] if each.scenes]
    if not told or told[0].scenes == told[-1].scenes:
        raise SystemExit("the run ended before two numbers of scenes were told: make more scenes")
    first = told[0]
    last = next(each for each in told if each.scenes == told[-1].scenes)
    made = last.scenes - first.scenes
    return Rates(
        made / (last.seconds - first.seconds),
        made / (last.workers_seconds - first.workers_seconds),
        (last.driver_seconds - first.driver_seconds) / made,
    )


if __name__ == "__main__":
    tyro.cli(Plan).run()
