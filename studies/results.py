"""Results of studies as they are stored: what a measure found, and the page's part of each study."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, TypedDict

from cluttergen_jax.evaluation.records import Machine, Row, RunInfo


class Measured(TypedDict):
    """What a study's measure found (`studies.study.Findings`)."""

    rows: list[Row]
    pictures: list[str]
    notes: list[str]


class Result(TypedDict, total=False):
    """A study's result; of a study with `brings_tables` it has its `tables`."""

    format: int
    suite: str
    name: str
    title: str
    place: int
    command: str
    quick: bool
    size: int
    trials: list[int]
    date: str | None
    machine: Machine | None
    commit: str | None
    also_made: list[RunInfo]
    records: list[Row]
    measure: Measured | None
    pictures: list[str]
    tables: list[Mapping[str, Any]]
    earlier: list[Result]


def made_rows(rows: Iterable[Row]) -> list[Row]:
    """Those that have figures."""
    return [row for row in rows if "figures" in row]


def origins_of(made: Iterable[Row]) -> list[RunInfo]:
    """When and where several things were made: an entry for each machine, the latest first.

    Args:
      made: things with what `origin` said of them; those that older versions kept lack it.

    Returns:
      `date`, a day or "FIRST to LAST", `machine`, and `commit`, all of them in a row; None, and last, for
      things that lack them.
    """
    machines: dict[str, Machine] = {}
    days: dict[str, list[str]] = {}
    commits: dict[str, dict[str, None]] = {}
    unknown: list[RunInfo] = []
    for each in made:
        if "machine" in each:
            name = json.dumps(each["machine"], sort_keys=True)
            machines.setdefault(name, each["machine"])
            days.setdefault(name, []).append(each["date"])
            commits.setdefault(name, {})[each.get("commit") or ""] = None
        else:
            unknown = [{"date": None, "machine": None, "commit": None}]
    latest_first = sorted(days, key=lambda name: max(days[name]), reverse=True)
    spans = {
        name: " to ".join(dict.fromkeys((min(days[name]), max(days[name]))))
        for name in latest_first
    }
    return [
        RunInfo(
            date=span,
            machine=machines[name],
            commit=", ".join(filter(None, commits[name])) or None,
        )
        for name, span in spans.items()
    ] + unknown


def sentence(facts: Machine) -> str:
    """A machine for people."""
    parts = [f"{facts['cores']} {'core' if facts['cores'] == 1 else 'cores'} of {facts['cpu']}"]
    parts += [facts["accelerator"]] if facts["accelerator"] else []
    parts += [
        f"Python {facts['python']}",
        *(f"{name} {v}" for name, v in facts["versions"].items()),
    ]
    return ", ".join(parts)
