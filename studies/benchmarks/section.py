"""Sections of reports/benchmarks.md: each program writes its own, with command, date and machine."""

from __future__ import annotations

import datetime
import os
import platform
import re
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from cluttergen_jax.evaluation.records import cpu_model

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "reports/benchmarks.md"
IMAGES = ROOT / "reports/images"
_HEAD = "# Benchmarks\n\n"
_HEAD += "Every section is written by the command that stands in it; no figure is typed by hand.\n"


def report(
    name: str,
    body: str,
    *,
    write: bool,
    packages: Sequence[str] = ("mujoco", "jax"),
    page: Path = PAGE,
) -> None:
    """Prints a section, and with `write` puts it in the place of the old one.

    Args:
      name: the program's, such as "contact".
      body: Markdown, its own heading first.
      packages: whose versions matter to the figures.
    """
    text = f"{body.strip()}\n\n{provenance(name, packages)}"
    print(text)
    if write:
        replace_section(page, name, text)


def replace_section(page: Path, name: str, text: str) -> None:
    """Puts `text` between the markers of section `name`; a section that is not there yet goes to the end."""
    begin = f"<!-- {name}: begin -->"
    end = f"<!-- {name}: end -->"
    old = page.read_text(encoding="utf-8") if page.exists() else _HEAD
    section = f"{begin}\n{text.strip()}\n{end}"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    new, num_found = pattern.subn(lambda _: section, old)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(new if num_found else f"{old.rstrip()}\n\n{section}\n", encoding="utf-8")


def provenance(name: str, packages: Sequence[str] = ()) -> str:
    """Command, date and machine, in one paragraph."""
    command = shlex.join(["python", "-m", f"studies.benchmarks.{name}", *sys.argv[1:]])
    versions = ", ".join(f"{each} {version_of(each)}" for each in packages)
    return (
        f"`{command}`, {datetime.date.today().isoformat()}; {cpu_model()}, "
        f"{len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f} at the end; "
        f"Python {platform.python_version()}, {versions}."
    )


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table; the first column is text, the others are set flush right."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def prose(text: str) -> str:
    """A paragraph written over several indented lines, as one line."""
    return " ".join(text.split())


def version_of(package: str) -> str:
    """The package's version, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
