"""Tables of text, written as Markdown, CSV, LaTeX or aligned columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {
    "&": r"\&",
    "%": r"\%",
    "#": r"\#",
    "_": r"\_",
    "$": r"\$",
    "{": r"\{",
    "}": r"\}",
    "~": r"\~{}",
}


@dataclass(frozen=True)
class Table:
    """Rows of text under headings.

    Attributes:
      title: a sentence without its full stop.
      columns: headings.
      rows: as many cells each as there are columns.
      notes: sentences that stand below.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        wrong = [row for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(
                f"{self.title}: {len(self.columns)} columns, a row of {len(wrong[0])}: {wrong[0]}"
            )

    def markdown(self) -> str:
        """The table, then its notes."""
        notes = ["", *(f"- {note}" for note in self.notes)] if self.notes else []
        return "\n".join([markdown_table(self.columns, self.rows), *notes])

    def csv(self) -> str:
        """Headings and rows."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return text.getvalue()

    def latex(self) -> str:
        """A `table` environment for the package booktabs."""
        body = [" & ".join(map(_latex, row)) + r" \\" for row in self.rows]
        return "\n".join(
            [
                r"\begin{table}",
                r"\centering",
                rf"\caption{{{_latex(self.title)}. {' '.join(_latex(note) + '.' for note in self.notes)}}}",
                rf"\begin{{tabular}}{{{'l' * len(self.columns)}}}",
                r"\toprule",
                " & ".join(map(_latex, self.columns)) + r" \\",
                r"\midrule",
                *body,
                r"\bottomrule",
                r"\end{tabular}",
                r"\end{table}",
                "",
            ]
        )


def markdown_table(columns: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Headings, a rule and rows."""
    return "\n".join([_line(columns), "|" + "---|" * len(columns), *map(_line, rows)])


def aligned_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns of equal width for a terminal; the first is flush left, the others flush right."""
    lines = [columns, *rows]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in lines
    )


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)
