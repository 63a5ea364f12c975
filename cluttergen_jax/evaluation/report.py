"""A study's result as files: JSON, Markdown, CSV and LaTeX."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cluttergen_jax.evaluation.layouts import LAYOUTS
from cluttergen_jax.evaluation.machine import sentence
from cluttergen_jax.evaluation.store import json_bytes
from cluttergen_jax.evaluation.tables import Table
from cluttergen_jax.files import write_atomically

Result = dict[str, Any]


def tables_of(result: Result) -> list[Table]:
    """The study's tables; if fewer trials were made than it asks for, their titles say so."""
    tables = LAYOUTS[result["layout"]](result)
    return [Table(_title(result, table.title), table.columns, table.rows, table.notes) for table in tables]


def _title(result: Result, title: str) -> str:
    if min(result["trials"]) >= result["size"]:
        return title
    trials = " or ".join(str(each) for each in result["trials"])
    return (
        f"{title} ({'quick: ' if result['quick'] else ''}{trials} trials a row instead of {result['size']})"
    )


def provenance(result: Result) -> str:
    """How the figures came about, in one paragraph."""
    trials = " or ".join(f"{each:,}" for each in result["trials"])
    return (
        f"`{result['command']}`, {trials} trials a row, {result['date']}, on {sentence(result['machine'])}."
    )


def markdown(result: Result, level: int = 2, link: str = "") -> str:
    """The study for people.

    Args:
      level: of its heading.
      link: what comes before the names of pictures.
    """
    lines = [f"{'#' * level} {_title(result, result['title'])}", ""]
    tables = tables_of(result)
    for table in tables:
        if len(tables) > 1:
            lines += [f"**{table.title}**", ""]
        lines += [table.markdown(), ""]
    notes = [f"- {note}" for note in (result["measure"] or {}).get("notes", ())]
    lines += [*notes, ""] if notes else []
    for name in shown_pictures(result):
        lines += [f"![{result['title']}]({link}{name})", ""]
    return "\n".join([*lines, provenance(result), ""])


def shown_pictures(result: Result) -> list[str]:
    """File names of the pictures that stand in Markdown."""
    return [name for name in result["pictures"] if name.endswith(".png")]


def write_report(result: Result, folder: Path) -> None:
    """NAME.json, NAME.md, and NAME.csv and NAME.tex, numbered where a study has more than one table."""
    stem = folder / result["name"]
    write_atomically(stem.with_suffix(".json"), json_bytes(result))
    write_atomically(stem.with_suffix(".md"), markdown(result, level=1).encode())
    tables = tables_of(result)
    for place, table in enumerate(tables):
        name = result["name"] if len(tables) == 1 else f"{result['name']}-{place + 1}"
        write_atomically(folder / f"{name}.csv", table.csv().encode())
        write_atomically(folder / f"{name}.tex", table.latex().encode())
