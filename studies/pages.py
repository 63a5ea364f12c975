"""Tables of README.md and reports/README.md, written between markers from reports/results: none is typed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cluttergen_jax.evaluation.comparison import interval, name_of, share, values_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.trial import trial_of
from cluttergen_jax.tables import Table
from studies.benchmarks.section import replace_section
from studies.methods.front import METHODS, SHORT, case_of
from studies.methods.table1 import CLUTTERGEN, PAPER
from studies.report import provenance
from studies.results import Result, made_rows

ROOT = Path(__file__).parents[1]

Block = Callable[[Result], str]
"""Markdown of one table, of a study's result."""


def pivot(
    rows: Iterable[Row],
    heading: str,
    line_of: Callable[[Row], str],
    names: Sequence[str] = (),
    headings: Mapping[str, str] | None = None,
) -> Table:
    """Success by question and method; of several training seeds one after another.

    Args:
      heading: of the first column, which `line_of` fills.
      names: of rows (`comparison.name_of`), a column each; all that there are if none.
      headings: of columns that are not called like their rows.
    """
    found: dict[str, dict[str, list[Row]]] = {}
    for row in made_rows(rows):
        found.setdefault(line_of(row), {}).setdefault(name_of(row), []).append(row)
    names = names or tuple(dict.fromkeys(name for line in found.values() for name in line))

    def cell(some: list[Row]) -> str:
        ordered = sorted(some, key=lambda row: row["trial"]["training_seed"])
        return ", ".join(share(row["figures"]["success"]) for row in ordered) or "-"

    words = headings or {}
    lines = [(line, *(cell(of.get(name, [])) for name in names)) for line, of in found.items()]
    return Table("", (heading, *(words.get(name, f"`{name}`") for name in names)), tuple(lines))


def block(table: Table, result: Result) -> str:
    """A table, and below it how its figures came about: of several commands the last."""
    earlier = result.get("earlier", [])
    latest: Any = {name: value for name, value in values_of(result).items() if name != "earlier"}
    text = provenance(latest)
    if earlier:
        days = sorted(day for each in earlier for day in (each["date"] or "").split(" to ") if day)
        span = " to ".join(dict.fromkeys((days[0], days[-1])))
        text += f" Other rows by {len(earlier)} commands of {span}, which stand in results.md."
    return f"{table.markdown()}\n\n{text}"


def _front(result: Result) -> str:
    return block(pivot(result["records"], "objects", case_of, METHODS), result)


def _some_of_front(result: Result) -> str:
    rows = [row for row in result["records"] if case_of(row) in SHORT]
    return block(pivot(rows, "objects", case_of, METHODS), result)


_RUIN = {"drop, ruin": "`drop`, rules of `guided`", "clear, ruin": "`clear`, rules of `guided`"}


def _crowds(result: Result) -> str:
    names = ("settle", "drop", "drop, ruin", "clear, ruin", "spread", "guided")
    rows = result["records"]
    table = pivot(rows, "objects", lambda row: str(row["trial"]["num_objects"]), names, _RUIN)
    return block(table, result)


def _density(result: Result) -> str:
    names = ("random", "settle", "policy", "drop", "drop, ruin", "spread", "guided")
    rows = [row for row in made_rows(result["records"]) if row["trial"]["pool"] == "dining"]

    def line_of(row: Row) -> str:
        size = trial_of(row).support.removeprefix("table-").replace("x", " x ")
        return f"{size} m, fill {row['figures']['fill']:.2f}"

    return block(pivot(rows, "table", line_of, names, _RUIN), result)


def _paper(result: Result) -> str:
    """The paper's method at its whole budget, one training seed, beside chance and the paper's figure."""
    budgets = [
        (row.get("policy") or {}).get("attempts", 0)
        for row in made_rows(result["records"])
        if row["trial"]["method"] == CLUTTERGEN
    ]
    most = max(budgets, default=0)
    lines = []
    for pool in dict.fromkeys(row["trial"]["pool"] for row in result["records"]):
        chance = _only(result, pool, "random", 0)
        theirs = _only(result, pool, CLUTTERGEN, most)
        if theirs is None or pool not in PAPER[CLUTTERGEN]:
            continue
        figures = theirs["figures"]
        lines.append(
            (
                pool,
                share(chance["figures"]["success"]) if chance else "-",
                interval(figures["success"], figures["low95"], figures["high95"]),
                share(figures["paper"]["success"]),
                share(PAPER[CLUTTERGEN][pool][0]),
            )
        )
    heads = ("pool", "`random`", f"`{CLUTTERGEN}`", f"`{CLUTTERGEN}`, paper's count", "the paper")
    return block(Table("", heads, tuple(lines)), result)


def _only(result: Result, pool: str, name: str, attempts: int) -> Row | None:
    """The first row of a pool by its name in tables, trained with so many attempts."""
    rows = (
        row
        for row in made_rows(result["records"])
        if row["trial"]["pool"] == pool
        and name_of(row) == name
        and (row.get("policy") or {}).get("attempts", 0) == attempts
    )
    return next(rows, None)


PAGES: dict[str, dict[str, Block]] = {
    "README.md": {"front": _some_of_front},
    "reports/README.md": {
        "front": _front,
        "crowds": _crowds,
        "density": _density,
        "table1": _paper,
    },
}
"""Of each page, its blocks by the study whose result they show."""


def write_pages(results: Iterable[Result], root: Path = ROOT) -> None:
    """Renews the blocks of all pages whose studies have a result."""
    by_name = {result["name"]: result for result in results}
    for page, blocks in PAGES.items():
        for name, make in blocks.items():
            if name in by_name:
                replace_section(root / page, name, make(by_name[name]))
