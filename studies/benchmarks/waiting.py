"""Where users wait: commands of this version and of an earlier one, side by side, in CPU-seconds.

The earlier one is a commit of this repository, checked out for as long as it takes. Both start with no
program compiled, and the commands of `AGAIN` are then run once more. A GPU is not used. An hour on two quiet
cores, most of it the two suites; `--only` takes some rows.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import tyro

from studies.benchmarks.section import ROOT, prose, report, table

COMMANDS: dict[str, tuple[str, ...]] = {
    "first scene": ("generate", "-n", "1", "--no-render", "--out", "OUT"),
    "20 scenes": ("generate", "-n", "20", "--no-render", "--out", "OUT"),
    "20 scenes and pictures": ("generate", "-n", "20", "--out", "OUT"),
    "verify": ("verify", "BANK"),
    "20 pictures": ("render", "BANK", "--scenes", "0-19", "--size", "640x480", "--out", "OUT"),
    "20 drafts": (
        *("render", "BANK", "--scenes", "0-19", "--size", "640x480", "--quality", "draft"),
        *("--out", "OUT"),
    ),
    "turntable": ("render", "BANK", "--turntable", "--no-picture", "--out", "OUT"),
    "heat map": ("render", "BANK", "--density", "--no-picture", "--out", "OUT"),
    "80 views": (
        *("dataset", "BANK", "--size", "320x240", "--num-scenes", "20", "--cameras", "free:4"),
        *("--out", "OUT"),
    ),
    "grasps of dining": ("robot", "grasps", "dining"),
}
"""By row; OUT is a new folder, and BANK one of twenty scenes."""
AGAIN = {"first scene", "20 scenes", "heat map"}
"""Of which much of the first time is compiling."""
_LONGEST = 3600.0


@dataclass(frozen=True)
class Waiting:
    """What is compared.

    Attributes:
      before: a commit.
      only: rows, by name; all if empty.
      write: put the table into reports/benchmarks.md.
    """

    before: str = "6db047c"
    only: tuple[str, ...] = ()
    write: bool = False

    def __post_init__(self) -> None:
        if unknown := set(self.only) - COMMANDS.keys():
            raise SystemExit(f"no rows {sorted(unknown)}: {', '.join(COMMANDS)}")


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """The files of a commit, in a folder of their own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "before")
        subprocess.run(
            ["git", "worktree", "add", "-q", "--detach", str(folder), commit], cwd=ROOT, check=True
        )
        try:
            yield folder
        finally:
            subprocess.run(
                ["git", "worktree", "remove", "--force", str(folder)], cwd=ROOT, check=True
            )


class Version:
    """A version of the package, with a home and a cache of programs of its own."""

    def __init__(self, code: Path, folder: Path) -> None:
        self.folder = folder
        self._env = os.environ | {
            "PYTHONPATH": str(code),
            "CLUTTERGEN_HOME": str(folder / "home"),
            "XDG_CACHE_HOME": str(folder / "cache"),
            "JAX_PLATFORMS": "cpu",
        }

    def seconds(self, words: Sequence[str]) -> float | None:
        """CPU-seconds of a command; None where this version does not know it."""
        out = self.folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        places = {"OUT": str(out), "BANK": str(self.folder / "bank")}
        if "BANK" in words and not (self.folder / "bank").is_dir():
            self.seconds(
                ("generate", "-n", "20", "--no-render", "--out", str(self.folder / "bank"))
            )
        command = [
            sys.executable,
            "-m",
            "cluttergen_jax",
            *(places.get(word, word) for word in words),
        ]
        before = _used()
        done = subprocess.run(
            command, env=self._env, cwd=self.folder, capture_output=True, timeout=_LONGEST
        )
        return None if done.returncode else _used() - before


def _used() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(config: Waiting) -> None:
    """Runs the commands in both versions."""
    rows = []
    with checkout(config.before) as code, tempfile.TemporaryDirectory() as name:
        versions = []
        for each in (code, ROOT):
            folder = Path(name, f"version-{len(versions)}")
            folder.mkdir()
            versions.append(Version(each, folder))
        for row in config.only or COMMANDS:
            # A first time in the one is beside a first time in the other.
            first = [version.seconds(COMMANDS[row]) for version in versions]
            again = [
                version.seconds(COMMANDS[row]) if row in AGAIN else None for version in versions
            ]
            rows.append([row, *map(_cell, (*first, *again))])
            print(rows[-1], file=sys.stderr, flush=True)
    header = ["", f"{config.before}, first", "now, first", f"{config.before}, again", "now, again"]
    text = prose("""
        CPU-seconds of whole commands. A first time compiles what no command before it compiled; a dash is a
        command that a version does not know, or that was run once.
    """)
    report("waiting", f"## Where users wait\n\n{text}\n\n{table(header, rows)}", write=config.write)


def _cell(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.1f}"


if __name__ == "__main__":
    main(tyro.cli(Waiting))
