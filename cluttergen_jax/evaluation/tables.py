"""A table, and how it is written: Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {"&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "$": r"\$", "{": r"\{", "}": r"\}", "~": r"\~{}"}


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
        lines = [self._line(self.columns), "|" + "---|" * len(self.columns), *map(self._line, self.rows)]
        notes = ["", *(f"- {note}" for note in self.notes)] if self.notes else []
        return "\n".join([*lines, *notes])

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

    @staticmethod
    def _line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)


def share(value: float | None) -> str:
    """A proportion with three digits."""
    return "-" if value is None else f"{value:.3f}"


def interval(value: float, low: float, high: float) -> str:
    """A proportion with its 95 % interval."""
    return f"{value:.3f} [{low:.3f}, {high:.3f}]"


def number(value: float | None, digits: int = 1) -> str:
    """A figure; a dash where there is none."""
    return "-" if value is None else f"{value:,.{digits}f}"


def mean_and_spread(spread: dict) -> str:
    """Mean and standard deviation of `proportion.spread_of`."""
    if spread["mean"] is None:
        return "-"
    return f"{spread['mean']:.1f} ± {spread['std']:.1f}"


def missing(row: dict) -> str:
    """Why there is no figure, and what to do about it."""
    hint = row.get("hint")
    return f"{row['missing']}; train it: {hint}" if hint else row["missing"]
