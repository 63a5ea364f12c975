"""A study's result as JSON, Markdown, CSV and LaTeX, and all results as one page, `reports/results.md`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.comparison import values_of
from cluttergen_jax.evaluation.records import RunInfo
from cluttergen_jax.evaluation.store import FORMAT, json_bytes
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.files import write_atomically
from cluttergen_jax.tables import Table
from studies.methods.table1 import IMPORTED
from studies.rankings import OURS, TWIN, tally
from studies.results import Result, made_rows, sentence
from studies.study import Scale
from studies.suites import STUDIES


def tables_of(result: Result) -> list[Table]:
    """The study's tables; if fewer trials were made than it asks for, their titles say so.

    The result of a study with `brings_tables` has them.
    """
    if "tables" in result:
        return [_table(**each) for each in result["tables"]]
    return [
        replace(table, title=_title(result, table.title))
        for table in STUDIES[result["name"]].tables(result)
    ]


def _table(title: str, columns: list, rows: list, notes: list) -> Table:
    """A table from JSON."""
    return Table(title, tuple(columns), tuple(map(tuple, rows)), tuple(notes))


def _title(result: Result, title: str) -> str:
    made = sorted(
        {number for each in (result, *result.get("earlier", ())) for number in each["trials"]}
    )
    if min(made) >= result["size"]:
        return title
    trials = " or ".join(map(str, made))
    return f"{title} ({_quick_words(result)}{trials} trials a row instead of {result['size']})"


def _quick_words(result: Result) -> str:
    """Whether a result is quick, and has fewer rows than the whole study."""
    if not result["quick"]:
        return ""
    quick, whole = (
        len(STUDIES[result["name"]].trials(Scale(quick=each))) for each in (True, False)
    )
    return "quick: fewer rows, " if quick < whole else "quick: "


def provenance(result: Result) -> str:
    """How the figures came about, in one paragraph; rows that were kept, by the machine that made them."""
    made, *earlier = (_how_made(each) for each in (result, *result.get("earlier", ())))
    commands: dict[str, dict[str, None]] = {}
    for command, date, how in earlier:
        commands.setdefault(how, {})[f"{command} ({date})" if date else command] = None
    kept = "; ".join(f"{', '.join(each)}: {how}" for how, each in commands.items())
    command, date, how = made
    text = ", ".join(filter(None, (command, date, how)))
    return f"{text}." + (f" Rows that it did not make again: {kept}." if kept else "")


def _how_made(result: Result) -> tuple[str, str, str]:
    """The command, the day, if it is known, and where and with how many trials."""
    trials = " or ".join(f"{each:,}" for each in result["trials"])
    others = "".join(
        f"; other rows {', '.join(filter(None, _when_and_where(each)))}"
        for each in result.get("also_made", ())
    )
    date, where = _when_and_where(result)
    return f"`{result['command']}`", date, f"{trials} trials a row, {where}{others}"


def _when_and_where(origin: RunInfo | Result) -> tuple[str, str]:
    if origin["machine"] is None:
        return "", "kept by an older version, which did not note when and where it made them"
    commit = f" at {origin['commit']}" if origin.get("commit") else ""
    return origin["date"] or "", f"on {sentence(origin['machine'])}{commit}"


def with_earlier_rows(result: Result, earlier: Result) -> Result:
    """A study with the rows of an earlier result of it that it has not made again, pool by pool.

    Rows of methods that the study no longer asks for are left out. Pictures are not drawn again
    (`redraw`).

    Raises:
      ConfigError: the study's rows cannot be told apart here: it brings its tables along, or it measures all
        its trials together.
    """
    if "tables" in result or not result["records"]:
        raise ConfigError(
            f"rows of the study {result['name']!r} to be kept",
            "studies whose tables are made here, of rows",
            "`python -m studies.make_results FOLDER`; a study made again into FOLDER keeps its rows itself",
        )
    made = made_rows(result["records"])
    before = made_rows(earlier["records"])
    # Whether a study of imported objects asks for a method is seen where there are some.
    given = [
        row["trial"]
        for row in (*made, *before)
        if str(row["trial"].get("pool")).startswith(IMPORTED)
    ]
    scale = Scale(imported=tuple((trial["pool"], trial["num_objects"]) for trial in given))
    asked = {trial.method for trial in STUDIES[result["name"]].trials(scale)}
    before = [row for row in before if row["trial"]["method"] in asked]
    # An earlier version may have named fewer of a trial's settings: it knew of no others than the defaults.
    usual = Trial().fields()
    rows = {json.dumps({**usual, **row["trial"]}, sort_keys=True): row for row in (*before, *made)}
    if len(rows) == len(made):
        return result
    order = list(dict.fromkeys(row["trial"].get("pool") for row in rows.values()))
    names = ("command", "trials", "date", "machine", "commit", "also_made")
    origin: Any = {name: values_of(earlier)[name] for name in names if name in earlier}
    return result | Result(
        records=sorted(rows.values(), key=lambda row: order.index(row["trial"].get("pool"))),
        earlier=[origin, *earlier.get("earlier", ())],
    )


def redraw(result: Result, folder: Path) -> list[str]:
    """Draws a study's plot of all its rows into a folder; its file names, none if it has no plot."""
    plot = STUDIES[result["name"]].plot
    rows = made_rows(result["records"])
    return plot(rows, folder / result["name"]) if plot and rows else []


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
    notes = [f"- {note}" for note in (result["measure"]["notes"] if result["measure"] else ())]
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


_HEADINGS = {
    "paper": "The paper's tables and figures",
    "extended": "What the paper does not ask",
    "downstream": "What scenes are good for",
}
"""The suites in the order of the page; the studies of the last one bring their tables along."""
_INTRODUCTION = """# Results

Every number here was written by `python -m studies.make_results` from the JSON files in `reports/results`; a
test checks that the two agree. Each section names the command that made it, its trials and its machine. What
success means: *strict* is this project's `is_success` (nothing else is disturbed, and the finished scene
stands); *the paper's count* judges only the current object and puts the others back.
"""

_STANDING = f"""## Who is as good as `{OURS}`

Counted from the rows below: another row is as good where the 95 % intervals of success overlap, better or
worse where they do not. `{TWIN}` is the same sampler without a network.
"""


def read_results(folder: Path) -> list[Result]:
    """The studies in a folder, in the order of their suites.

    Raises:
      ConfigError: a file is damaged, or is no study's result.
    """
    results: list[Any] = []
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a folder", "one that `python evaluate.py --suite` made")
    for path in sorted(folder.glob("*.json")):
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{path} cannot be read ({getattr(error, 'strerror', None) or error})",
                hint="making it again",
            ) from error
        if not isinstance(result, dict) or result.get("format") != FORMAT or "suite" not in result:
            raise ConfigError(
                f"{path} is not the result of a study of format {FORMAT}", hint="removing it"
            )
        results.append(cast(Result, result))
    order = list(STUDIES)
    known = [result for result in results if result["name"] in order]
    known.sort(key=lambda result: order.index(result["name"]))
    return known + [
        result for result in results if result["name"] not in order and "tables" in result
    ]


def standing_section(results: list[Result]) -> list[str]:
    """Where other methods are as good as `guided`, study by study; nothing where it has no rows."""
    lines = []
    for result in results:
        if result["name"] not in STUDIES:
            continue
        question = STUDIES[result["name"]].question
        text = tally(made_rows(result["records"]), question) if question else ""
        lines += [f"- {result['name']}: {text}."] if text else []
    return [_STANDING, "\n".join(lines) + "\n"] if lines else []


def document(results: list[Result], notes: str = "", link: str = "results/") -> str:
    """The whole page; `notes`, Markdown, stand at its end."""
    parts = [_INTRODUCTION, *standing_section(results)]
    for suite in _HEADINGS:
        of_suite = [result for result in results if result["suite"] == suite]
        if of_suite:
            parts += [
                f"## {_HEADINGS[suite]}\n",
                *(markdown(result, 3, link) for result in of_suite),
            ]
    return "\n".join([*parts, notes] if notes else parts)
