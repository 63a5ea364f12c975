"""Pools of 10 to 3,000 objects: how long scenes of a bank take, and how much memory.

Objects are the embedded ones over again under other names. Each row is a process of its own, with no program
compiled before. Ten minutes on two quiet cores.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro

from cluttergen_jax.assets.pool import Pool, find_pool, write_pool
from studies.benchmarks.section import prose, report, table

NUM_OBJECTS = 10
_HEADER = (
    *("objects", "on a shelf", "first scenes s", "as many more s", "scenes per CPU-second", "MB"),
    *("success", "a scene is read in s"),
)


@dataclass(frozen=True)
class Library:
    """How much.

    Attributes:
      sizes: objects of each pool.
      num_scenes: of each of two calls, which make one bank.
      write: put the table into reports/benchmarks.md.
      case: measure one pool, into a folder, in this process.
    """

    sizes: tuple[int, ...] = (10, 100, 200, 1000, 3000)
    num_scenes: int = 512
    write: bool = False
    case: tuple[str, str] | None = None


def make_pool(folder: Path, number: int) -> Path:
    """A pool of so many objects."""
    base = find_pool("all").objects
    objects = tuple(
        replace(
            base[place % len(base)], name=f"{base[place % len(base)].name}-{place // len(base)}"
        )
        for place in range(number)
    )
    return write_pool(folder / f"objects-{number}", Pool(f"objects-{number}", objects))


def measure(pool: str, folder: str, num_scenes: int) -> dict[str, Any]:
    """A row, of this process: a bank begun, and as much again."""
    import cluttergen_jax as cg

    out = Path(folder, "bank")
    seconds = []
    used = 0.0
    for number in (num_scenes, 2 * num_scenes):
        begun = time.perf_counter()
        used = time.process_time()
        bank = cg.generate(
            out, pool, num_scenes=number, num_objects=NUM_OBJECTS, seed=1, max_files=0
        )
        seconds.append(time.perf_counter() - begun)
        used = time.process_time() - used
    begun = time.perf_counter()
    cg.read_bank(out).rows([num_scenes])
    opens = time.perf_counter() - begun
    return {
        "objects": len(find_pool(pool)),
        "shelf": bank.recipe.get("shelf", 0),
        "seconds": seconds,
        "rate": num_scenes / used,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000,
        "success": sum(bank.table["is_success"].to_pylist()) / bank.table.num_rows,
        "opens": opens,
    }


def main(config: Library) -> None:
    """Runs every pool in a process of its own."""
    if config.case:
        print(json.dumps(measure(*config.case, config.num_scenes)))
        return
    rows = []
    for size in config.sizes:
        with tempfile.TemporaryDirectory() as folder:
            pool = make_pool(Path(folder), size)
            done = subprocess.run(
                [
                    *(
                        sys.executable,
                        "-m",
                        "studies.benchmarks.library",
                        "--case",
                        str(pool),
                        folder,
                    ),
                    *("--num-scenes", str(config.num_scenes)),
                ],
                env=os.environ | {"JAX_COMPILATION_CACHE_DIR": f"{folder}/programs"},
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            )
        told = json.loads(done.stdout.splitlines()[-1])
        first, second = told["seconds"]
        numbers = (
            f"{first:.0f}",
            f"{second:.0f}",
            f"{told['rate']:.1f}",
            f"{told['megabytes']:,.0f}",
        )
        checked = (f"{told['success']:.3f}", f"{told['opens']:.2f}")
        rows.append((f"{told['objects']:,}", told["shelf"] or "all", *numbers, *checked))
        print(rows[-1], file=sys.stderr, flush=True)
    text = prose(f"""
        Scenes of {NUM_OBJECTS} objects by `guided`, {config.num_scenes} and as many more by a second call,
        which finds its programs compiled. From more than 200 objects each block of 256 scenes draws a shelf.
    """)
    report("library", f"## Large pools\n\n{text}\n\n{table(_HEADER, rows)}", write=config.write)


if __name__ == "__main__":
    main(tyro.cli(Library))
