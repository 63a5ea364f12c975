"""Scenes of ours and of other projects by `cluttergen judge`, and whether a plain second judge agrees.

Folders are made by `cluttergen generate` and `studies/benchmarks/public_scenes.py`, whose about.json says
what is in them; joints of robots are held. Each folder is a row, which is kept: the same command resumes.

    python -m studies.benchmarks.judge --folders out/libero out/robosuite --write
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import tyro

import cluttergen_jax as cg
from studies.benchmarks.plain_judge import judge as judge_plainly
from studies.benchmarks.rows import OutOfTimeError, Row, Rows
from studies.benchmarks.section import prose, report, table

_FLAGS = ("is_still_1s", "is_deep", "floats", "falls")


@dataclass(frozen=True)
class Judging:
    """What is judged.

    Attributes:
      folders: of scenes.
      max_starts: of a file.
      rows: where rows are kept.
      minutes: after which no row is begun.
      write: put the table into reports/benchmarks.md.
    """

    folders: tuple[Path, ...]
    max_starts: int = 3
    rows: Path = Path("out/judge.json")
    minutes: float = 9.0
    write: bool = False


def agreement(folder: Path, starts: int) -> tuple[int, int]:
    """How many flags of bodies both judges set, and how many of them alike, over one second, native."""
    found = cg.judge(
        folder, seconds=(1.0,), hold_joints=True, detectors=("native",), max_starts=starts
    )
    ours = {(row["file"], row["start"], row["body"]): row for row in found.rows.to_pylist()}
    flags = [
        (ours[str(file), own["start"], own["body"]][name] == own[name])
        for file in sorted({each.file for each in found.starts})
        for own in judge_plainly(file, seconds=(1.0,), hold_joints=True, most=starts)
        for name in _FLAGS
    ]
    return len(flags), sum(flags)


def judged_row(folder: Path, config: Judging) -> Row:
    """One folder, with both detectors."""
    about = folder / "about.json"
    said = (
        json.loads(about.read_text())
        if about.is_file()
        else {"set": folder.name, "package": "ours"}
    )
    found = cg.judge(folder, hold_joints=True, max_starts=config.max_starts)
    asked, alike = agreement(folder, config.max_starts)
    return {
        **said,
        "unread": len([why for why in found.unread.values() if "moves freely" not in why]),
        "asked": asked,
        "alike": alike,
        **{name: found.shares(name) for name in ("native", "libccd")},
        "bodies": found.shares("native", of_bodies=True),
    }


def main(config: Judging) -> None:
    """Judges what is missing, and prints the table."""
    rows = Rows(config.rows, config.minutes)
    cases: list[tuple[str, Callable[[], Row]]] = [
        (folder.name, partial(judged_row, folder, config)) for folder in config.folders
    ]
    try:
        rows.make("judge", iter(cases))
    except OutOfTimeError as late:
        print(f"no time left for {late}: the same command resumes")
    made = rows.of("judge")
    names = [folder.name for folder in config.folders if folder.name in made]
    shown = [name for name in next(iter(made.values()))["native"] if name != "number"]
    cells = []
    for name in names:
        row = made[name]
        for kind in ("native", "libccd", "bodies"):
            share = row[kind]
            what = (
                f"{row['set']} ({row['package']}), {'bodies, native' if kind == 'bodies' else kind}"
            )
            alike = f"{row['alike']} of {row['asked']}" if kind == "native" else ""
            cells.append(
                [what, f"{share['number']:.0f}", *(f"{share[each]:.3f}" for each in shown), alike]
            )
    asked, alike = (sum(made[name][key] for name in names) for key in ("asked", "alike"))
    text = prose(f"""
        Shares of scenes (or of free bodies) that are still up to each horizon, and in which bodies overlap
        by more than 1 mm or float at the start, or fall: `cluttergen judge`, from rest, everything awake,
        each file's own options, joints of robots held, at most {config.max_starts} starts a file.
        LIBERO's own evaluations take ten empty steps first; here its starts are judged as they are stored.
        Agreement: flags of bodies (still 1 s, overlap, float, fall; native) that the plain judge sets
        alike, in all {alike} of {asked}, {alike / asked:.4f}.
    """)
    header = ["", "number", *shown, "agreement"]
    report(
        "judge",
        f"## Scenes of other projects\n\n{text}\n\n{table(header, cells)}",
        write=config.write,
    )


if __name__ == "__main__":
    main(tyro.cli(Judging))
