"""Whether memory stays flat as a bank grows: peaks of commands on banks of 10^4 to 10^6 rows.

    python -m studies.benchmarks.million_rows [--write]

The banks are made first, by the writer that `generate` uses, of the scenes of one real bank over and over.
No two copies are equal: x of each pose differs by units in the last place, so that nothing is a duplicate.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import tyro

import cluttergen_jax as cg
from cluttergen_jax.files import write_atomically
from cluttergen_jax.placement.rollout import blocks_of
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.progress import track
from cluttergen_jax.scene.bank import Bank, BankWriter, read_bank
from studies.benchmarks.section import ROOT, prose, report, table

_COMMAND = ("-m", "cluttergen_jax")
_OPEN = "import cluttergen_jax as cg; bank = cg.read_bank({bank!r}); "
WAYS: dict[str, tuple[str, ...]] = {
    "`cluttergen --version`": (*_COMMAND, "--version"),
    "`stats`": (*_COMMAND, "stats", "{bank}"),
    "`verify`, of {files} files": (*_COMMAND, "verify", "{bank}", "--seconds", "1"),
    "`export --format mjlab`": (
        *_COMMAND,
        "export",
        "{bank}",
        "--format",
        "mjlab",
        "--out",
        "{out}",
    ),
    "`export --format mjcf --scenes 0-99`": (
        *(*_COMMAND, "export", "{bank}", "--format", "mjcf"),
        *("--scenes", "0-99", "--out", "{out}"),
    ),
    "`export --format mjcf`": (*_COMMAND, "export", "{bank}", "--format", "mjcf", "--out", "{out}"),
    "`cut --scenes all`": (*_COMMAND, "cut", "{bank}", "--scenes", "all", "--out", "{out}"),
    "`bank[len(bank) // 2]`": ("-c", _OPEN + "bank[len(bank) // 2]"),
    "`for scene in bank`": ("-c", _OPEN + "print(sum(1 for scene in bank))"),
    "`for scene in bank_reader.Bank(...)`": (
        "-c",
        "from cluttergen_jax.bank_reader import Bank; print(sum(1 for scene in Bank({bank!r})))",
    ),
}
"""Arguments of Python by what they measure; `{bank}`, `{out}` and `{files}` are filled in."""
_FILE_A_SCENE = ("`export --format mjcf`",)
"""Ways that write a file for each scene."""
_LAUNCHER = """
import json, os, subprocess, sys
# A process's peak begins with that of the process that started it: this one is small.
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
said = child.stderr.read()
_, status, used = os.wait4(child.pid, 0)
if status:
    sys.exit(said.decode()[-2000:])
print(json.dumps({"peak": used.ru_maxrss * 1024, "cpu": used.ru_utime + used.ru_stime}))
"""


@dataclass(frozen=True)
class Use:
    """What a process used.

    Attributes:
      peak: bytes of resident memory, the most at any time.
      cpu: seconds of processor time, imports included.
    """

    peak: float
    cpu: float


@dataclass(frozen=True)
class MillionRows:
    """Measure commands on banks of more and more rows.

    Attributes:
      out: where banks are kept; those that are there are not made again.
      sizes: rows of the banks.
      ways: substrings of the `WAYS` to measure, all if none.
      num_real: scenes of the real bank, made by `clear` of dining; num_files: of those that have files.
      most_files: the largest bank of which a file for each scene is written.
      write: put the section into reports/benchmarks.md.
    """

    out: Path = Path("out/million_rows")
    sizes: tuple[int, ...] = (10_000, 100_000, 1_000_000)
    ways: tuple[str, ...] = ()
    num_real: int = 512
    num_files: int = 16
    most_files: int = 100_000
    write: bool = False

    def run(self) -> None:
        """Makes the banks, and measures every way on each."""
        real = self.out / "real"
        if not real.exists():
            cg.generate(real, num_scenes=self.num_real, method="clear", max_files=self.num_files)
        for size in self.sizes:
            multiply(read_bank(real), self.bank(size), size)
        wanted = [way for way in WAYS if not self.ways or any(each in way for each in self.ways)]
        found = {way: [self.use(way, size) for size in self.sizes] for way in wanted}
        report("million_rows", self.section(found), write=self.write, packages=_PACKAGES)

    def bank(self, size: int) -> Path:
        """The bank of so many rows."""
        return self.out / f"rows_{size}"

    def use(self, way: str, size: int) -> Use | None:
        """What one of the `WAYS` uses; None where it would write too many files."""
        if way in _FILE_A_SCENE and size > self.most_files:
            return None
        out = self.out / "written"
        shutil.rmtree(out, ignore_errors=True)
        places = {"bank": str(self.bank(size).absolute()), "out": str(out.absolute())}
        used = use_of([word.format(**places) for word in WAYS[way]])
        shutil.rmtree(out, ignore_errors=True)
        print(f"{way}, {size:,}: {used.peak / 1e6:.0f} MB, {used.cpu:.1f} s", file=sys.stderr)
        return used

    def section(self, found: dict[str, list[Use | None]]) -> str:
        """What was found, in Markdown."""
        header = [""]
        for size in self.sizes:
            header += [f"MB at {size:,}", "CPU s"]
        header.append("last peak / first")
        rows = []
        for way, uses in found.items():
            row = [way.format(files=self.num_files)]
            for each in uses:
                row += ["", ""] if each is None else [f"{each.peak / 1e6:,.0f}", f"{each.cpu:,.1f}"]
            known = [each for each in uses if each is not None]
            row.append(f"{known[-1].peak / known[0].peak:.2f}" if len(known) > 1 else "")
            rows.append(row)
        largest = self.bank(self.sizes[-1])
        files = [each for each in largest.rglob("*") if each.is_file()]
        size = sum(each.stat().st_size for each in files)
        text = prose(
            f"""Each figure is of a process of its own: the most resident memory, and processor time, imports
            included. The largest bank has {len(files)} files, {size / 1e6:,.0f} MB: {self.num_real} scenes
            of ten objects of dining, over and over, each copy's poses changed in their last bits. `verify`
            compares all files with their digests, and simulates those scenes that have a file, here for
            1 s. Where a file for each scene is written, at most {self.most_files:,} are."""
        )
        return f"## A million rows\n\n{text}\n\n{table(header, rows)}"


_PACKAGES = ("mujoco", "jax", "pyarrow")


def multiply(real: Bank, out: Path, num_scenes: int) -> None:
    """Writes what is missing of a bank that repeats the rows of another, whose number is one of whole blocks.

    The files of its first scenes are those of the other.
    """
    objects = {name: real.object(name) for name in real.record["assets"]["objects"]}
    with BankWriter(out, real.record["recipe"], num_scenes, objects, real.support) as writer:
        missing = [each for each in blocks_of(num_scenes) if not writer.has_block(*each)]
        rows = real.table
        num_blocks = rows.num_rows // BLOCK_SIZE
        for block, wanted in track(missing, "writing", len(missing), "block"):
            copy, part = divmod(block, num_blocks)
            some = rows.slice(part * BLOCK_SIZE, wanted)
            writer.write_block(block, changed(some, copy, block * BLOCK_SIZE))
        writer.finish()
        files = {
            name: digest
            for name, digest in (real.files or {}).items()
            if name.startswith("scenes/")
        }
        for name in files:
            (out / name).parent.mkdir(exist_ok=True)
            write_atomically(out / name, (real.path / name).read_bytes())
        writer.keep_digests(files)


def changed(rows: pa.Table, copy: int, first: int) -> pa.Table:
    """The rows numbered from `first`, every x of a pose changed by `copy` units in its last place."""
    rows = rows.combine_chunks()
    poses = rows["poses"].combine_chunks()
    numbers = np.array(pc.list_flatten(pc.list_flatten(poses)), np.float32).reshape(-1, 7)
    numbers.view(np.uint32)[:, 0] += np.uint32(copy)
    slots = pa.FixedSizeListArray.from_arrays(pa.array(numbers.ravel()), 7)
    lengths = np.array(pc.list_value_length(poses))
    offsets = pa.array(np.concatenate([[0], np.cumsum(lengths)]), pa.int32())
    columns = {
        "index": pa.array(np.arange(first, first + rows.num_rows), pa.int32()),
        "poses": pa.ListArray.from_arrays(offsets, slots),
    }
    for name, values in columns.items():
        place = rows.schema.get_field_index(name)
        rows = rows.set_column(
            place, rows.schema.field(place), values.cast(rows.schema.field(place).type)
        )
    return rows


def use_of(arguments: Sequence[str]) -> Use:
    """What Python with these arguments uses (SystemExit: it fails)."""
    command = [sys.executable, "-c", _LAUNCHER, sys.executable, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, cwd=ROOT, text=True)
    if done.returncode:
        raise SystemExit(done.returncode)
    return Use(**json.loads(done.stdout))


if __name__ == "__main__":
    tyro.cli(MillionRows).run()
