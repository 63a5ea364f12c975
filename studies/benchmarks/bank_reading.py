"""How a bank of a million scenes opens: seconds and memory, each way of reading in a process of its own.

    python -m studies.benchmarks.bank_reading [--write]

The bank is made first, by the writer that `generate` uses, of the scenes of one block over and over.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import tyro

import cluttergen_jax as cg
from cluttergen_jax.placement.rollout import blocks_of
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.progress import track
from cluttergen_jax.scene.bank import Bank, BankWriter, read_bank
from studies.benchmarks.section import ROOT, report, table

_BATCH = 1024


@dataclass(frozen=True)
class BankReading:
    """Measure how a big bank is read.

    Attributes:
      out: the bank's folder; what is there is not made again.
      num_scenes: in the bank.
      one_block: a bank of the block that is repeated; made by `clear` of dining if it is not there.
      write: put the section into reports/benchmarks.md.
    """

    out: Path = Path("out/bank_reading/bank")
    num_scenes: int = 1_000_000
    one_block: Path = Path("out/bank_reading/one_block")
    write: bool = False

    def run(self) -> None:
        """Makes the bank, and reads it in every way."""
        cg.generate(self.one_block, num_scenes=BLOCK_SIZE, method="clear", max_files=0)
        repeat(read_bank(self.one_block), self.out, self.num_scenes)
        files = list(self.out.glob("scenes-*.parquet"))
        size = sum(each.stat().st_size for each in files)
        rows = [(name, *measured(name, self.out)) for name in WAYS]
        text = (
            f"{self.num_scenes:,} scenes of ten objects of dining in {len(files)} files, {size / 1e6:,.0f} "
            "MB. Each row is a process of its own: seconds after imports, and the most memory that it held."
        )
        header = ("", "seconds", "MB resident", "scenes")
        report(
            "bank_reading",
            f"## Reading a big bank\n\n{text}\n\n{table(header, rows)}",
            write=self.write,
        )


def repeat(block: Bank, out: Path, num_scenes: int) -> None:
    """Writes what is missing of a bank whose blocks all hold the rows of the first one of another."""
    rows = block.table
    names = list(block.record["assets"]["objects"])
    objects = {name: block.object(name) for name in names}
    with BankWriter(out, block.record["recipe"], num_scenes, objects, block.support) as writer:
        missing = [each for each in blocks_of(num_scenes) if not writer.has_block(*each)]
        place = rows.schema.get_field_index("index")
        for number, wanted in track(missing, "writing", len(missing), "block"):
            index = pa.array(np.arange(wanted) + number * BLOCK_SIZE, pa.int32())
            writer.write_block(
                number, rows.slice(0, wanted).set_column(place, rows.schema.field(place), index)
            )
        writer.finish()


def _nothing(path: Path) -> Iterator[int]:
    yield 0


def _opened(path: Path) -> Iterator[int]:
    yield read_bank(path).num_scenes


def _one(path: Path) -> Iterator[int]:
    bank = read_bank(path)
    yield len(bank.rows([bank.num_scenes // 2]))


def _subset(number: int) -> Callable[[Path], Iterator[int]]:
    def read(path: Path) -> Iterator[int]:
        yield len(cg.load_bank(path, num_scenes=number))

    return read


def _stream(path: Path) -> Iterator[int]:
    for batch in cg.stream_bank(path, _BATCH):
        yield len(batch)


def _first(path: Path) -> Iterator[int]:
    yield len(next(cg.stream_bank(path, _BATCH)))


WAYS: dict[str, Callable[[Path], Iterator[int]]] = {
    "the package's imports alone": _nothing,
    "`read_bank`": _opened,
    "`read_bank(...).rows([number])`": _one,
    "`load_bank`, 1,000 at random": _subset(1000),
    "`load_bank`, 10,000 at random": _subset(10_000),
    "`load_bank`, 100,000 at random": _subset(100_000),
    "`stream_bank`, its first 1,024": _first,
    "`stream_bank`, all": _stream,
}
"""Ways to read a bank, which yield how many scenes they have read since they last did."""


def measured(name: str, path: Path) -> tuple[str, str, str]:
    """Seconds, megabytes and scenes of one of the `WAYS`, in a fresh process."""
    code = f"from studies.benchmarks.bank_reading import look; look({name!r}, {str(path.absolute())!r})"
    command = [sys.executable, "-c", code]
    told = subprocess.run(command, check=True, stdout=subprocess.PIPE, cwd=ROOT, text=True)
    found: dict[str, Any] = json.loads(told.stdout)
    return f"{found['seconds']:.2f}", f"{found['megabytes']:,.0f}", f"{found['scenes']:,}"


def look(name: str, path: str) -> None:
    """Reads a bank in one of the `WAYS`, and prints what that took as JSON."""
    started = time.perf_counter()
    scenes = sum(WAYS[name](Path(path)))
    seconds = time.perf_counter() - started
    # Of Linux. What `resource` tells begins with what the process that started this one held.
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    megabytes = int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    print(json.dumps({"seconds": seconds, "megabytes": megabytes, "scenes": scenes}))


if __name__ == "__main__":
    tyro.cli(BankReading).run()
