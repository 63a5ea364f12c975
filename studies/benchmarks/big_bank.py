"""A big bank on a local Ray cluster: scenes a second over time, memory, and what more of them would cost.

It starts `cluttergen generate` as a user would, and looks at it from outside every few seconds. The bank
stays; the same command again goes on with it, and then measures what was missing.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO

import numpy as np
import psutil
import tyro

from cluttergen_jax.files import write_atomically
from cluttergen_jax.scene.bank import read_bank
from studies.benchmarks.section import ROOT, report, table

PICTURE = Path("reports/images/big_bank.png")
_DONE = re.compile(r"placing: (\d+) of \d+ scenes")
_MILLIONS = (1, 10, 1000)


@dataclass(frozen=True)
class Sample:
    """What was seen of a run at one time.

    Attributes:
      seconds: since it was started; scenes: made until then.
      driver_mb, workers_mb: resident memory of the command, and of all workers together, 10^6 bytes.
      driver_seconds, workers_seconds: processor time of the command, and of all workers together.
    """

    seconds: float
    scenes: int
    driver_mb: float
    workers_mb: float
    driver_seconds: float
    workers_seconds: float


@dataclass(frozen=True)
class BigBank:
    """Measure a large bank on this machine.

    Attributes:
      out: the bank's folder; samples.json and rate.png go beside it.
      num_scenes, pool, method, workers: of `cluttergen generate`.
      every: seconds between two looks.
      core_hour: price of a core for an hour; gigabyte_month: of 10^9 bytes for a month; both in one currency.
      machine_cores: cores of a machine in the sums.
      write: put the section into reports/benchmarks.md, and the picture into reports/images.
    """

    out: Path = Path("out/big_bank/bank")
    num_scenes: int = 200_000
    pool: str = "dining"
    method: str = "guided"
    workers: int = 2
    every: float = 5.0
    core_hour: float = 0.04
    gigabyte_month: float = 0.023
    machine_cores: int = 64
    write: bool = False

    def run(self) -> None:
        """Runs it, and writes what was seen."""
        samples = watch(self.command(), self.every)
        folder = self.out.parent
        seen = [asdict(each) for each in samples]
        write_atomically(folder / "samples.json", (json.dumps(seen, indent=1) + "\n").encode())
        for picture in [folder / "rate.png", *([ROOT / PICTURE] if self.write else [])]:
            draw(samples, picture)
        bank = read_bank(self.out)
        size = sum(each.stat().st_size for each in self.out.glob("scenes-*.parquet"))
        report(
            "big_bank",
            self.section(samples, size / bank.num_scenes),
            write=self.write,
            packages=_PACKAGES,
        )

    def command(self) -> list[str]:
        """The command that is watched."""
        options = {
            "out": self.out,
            "num-scenes": self.num_scenes,
            "pool": self.pool,
            "method": self.method,
            "cluster": "local",
            "workers": self.workers,
            "max-files": 0,
        }
        words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
        return [sys.executable, "-m", "cluttergen_jax", "generate", *words]

    def section(self, samples: list[Sample], size: float) -> str:
        """What was found, in Markdown.

        Args:
          size: bytes of a scene on disk.
        """
        fifths = fifths_of(samples)
        first = fifths[0][0]
        last = fifths[-1][-1]
        rate = (last.scenes - first.scenes) / (last.seconds - first.seconds)
        own = (last.driver_seconds - first.driver_seconds) / (last.scenes - first.scenes)
        rows = [
            (
                f"{part[0].scenes:,} to {part[-1].scenes:,}",
                f"{(part[-1].scenes - part[0].scenes) / (part[-1].seconds - part[0].seconds):.2f}",
                f"{max(each.driver_mb for each in part):.0f}",
                f"{max(each.workers_mb for each in part):.0f}",
            )
            for part in fifths
        ]
        seen = table(("scenes", "a second", "command: most MB", "workers: most MB"), rows)
        sums = table(
            (
                "scenes",
                "core-hours",
                f"days of ten machines of {self.machine_cores}",
                "days of the one command",
                "GB",
                "price of the cores",
                "price a month",
            ),
            [self.sums(millions * 10**6, rate / self.workers, own, size) for millions in _MILLIONS],
        )
        paragraphs = [
            "## A big bank",
            f"{last.scenes:,} scenes of {self.pool} by `{self.method}`, {self.workers} workers of one core: "
            f"{rate:.2f} scenes a second, {rate / self.workers:.2f} a core; {size:.0f} bytes and "
            f"{1000 * own:.2f} ms of the command's own processor time a scene.",
            seen,
            f"What that makes of more, at {self.core_hour:g} for a core-hour and {self.gigabyte_month:g} for "
            "a GB and month. Whichever column of days is longer counts: one command writes for all workers.",
            sums,
        ]
        return "\n\n".join(paragraphs)

    def sums(self, scenes: int, rate: float, own: float, size: float) -> tuple[str, ...]:
        """A row: what so many scenes take.

        Args:
          rate: scenes a second and core; own: seconds of the command for a scene; size: bytes of a scene.
        """
        hours = scenes / rate / 3600
        gigabytes = scenes * size / 1e9
        return (
            f"{scenes:,}",
            f"{hours:,.0f}",
            f"{hours / (10 * self.machine_cores) / 24:,.2f}",
            f"{scenes * own / 86400:,.2f}",
            f"{gigabytes:,.1f}",
            f"{hours * self.core_hour:,.0f}",
            f"{gigabytes * self.gigabyte_month:,.2f}",
        )


_PACKAGES = ("mujoco", "jax", "ray")


def watch(command: list[str], every: float) -> list[Sample]:
    """Runs a command that makes scenes, and looks at it now and then until it ends.

    Raises:
      SystemExit: it failed.
    """
    started = time.monotonic()
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    done = [0]
    assert running.stderr is not None
    reader = threading.Thread(target=follow, args=(running.stderr, done))
    reader.start()
    samples = []
    while running.poll() is None:
        if (sample := look(running.pid, time.monotonic() - started, done[0])) is not None:
            samples.append(sample)
        time.sleep(every)
    reader.join()
    if running.returncode:
        raise SystemExit(running.returncode)
    return samples


def follow(lines: IO[str], done: list[int]) -> None:
    """Passes on what the command says, and keeps the latest number of scenes."""
    for line in lines:
        print(line, end="", file=sys.stderr)
        if match := _DONE.match(line):
            done[0] = int(match[1])


def look(process: int, seconds: float, scenes: int) -> Sample | None:
    """What is seen of a command and its workers now; None if it has just ended."""
    try:
        driver = psutil.Process(process)
        workers = 0
        workers_seconds = 0.0
        for each in driver.children(recursive=True):
            if is_worker(each):
                workers += each.memory_info().rss
                workers_seconds += each.cpu_times().user
        return Sample(
            seconds,
            scenes,
            driver.memory_info().rss / 1e6,
            workers / 1e6,
            driver.cpu_times().user,
            workers_seconds,
        )
    except psutil.Error:
        return None


def is_worker(process: psutil.Process) -> bool:
    """Whether Ray calls it one of ours."""
    return " ".join(process.cmdline()).startswith("ray::_Actor")


def fifths_of(samples: list[Sample]) -> list[list[Sample]]:
    """The samples in which scenes were made, in five parts, each beginning with the last one's end."""
    # The number is told every ten seconds: of equal ones the first is right.
    told = [each for before, each in pairwise(samples) if each.scenes > before.scenes]
    if len(told) < 6:
        raise SystemExit(f"{len(told)} different numbers of scenes were seen: make more scenes")
    ends = np.linspace(0, len(told) - 1, 6).astype(int)
    return [told[a : b + 1] for a, b in pairwise(ends)]


def draw(samples: list[Sample], path: Path) -> None:
    """Scenes a second and memory over time."""
    import matplotlib.pyplot as plt
    from matplotlib.figure import Figure

    told = [each for part in fifths_of(samples) for each in part[:-1]]
    figure: Figure
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), sharex=True, layout="constrained")
    minutes = [each.seconds / 60 for each in told]
    window = max(len(told) // 50, 1)
    rates = [
        (later.scenes - each.scenes) / (later.seconds - each.seconds)
        for each, later in zip(told, told[window:], strict=False)
    ]
    above.plot(minutes[window:], rates)
    above.set(ylabel="scenes a second", ylim=(0, None))
    minutes = [each.seconds / 60 for each in samples]
    below.plot(minutes, [each.driver_mb for each in samples], label="the command")
    below.plot(minutes, [each.workers_mb for each in samples], label="all workers")
    below.set(xlabel="minutes", ylabel="MB resident", ylim=(0, None))
    below.legend(loc="lower right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    tyro.cli(BigBank).run()
