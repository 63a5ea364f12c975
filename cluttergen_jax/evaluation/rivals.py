"""Rivals of a method: rows of a table whose figures are as good as its own, as sentences.

Nothing here is written by hand: who is ahead is read from the rows, so that a table and the words below it
cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from cluttergen_jax.evaluation.cells import Row, name_of, number, share_of

OURS, TWIN = "guided", "spread"
"""The method that the sentences are about, and the same sampler without a network."""


@dataclass(frozen=True)
class Ranking:
    """Where a method stands among the rows of one question.

    Attributes:
      own: the method's row; better, equal, worse: names of the others, by whether the 95 % interval of their
        share lies above its own, overlaps it, or lies below.
    """

    own: Row
    better: tuple[str, ...]
    equal: tuple[str, ...]
    worse: tuple[str, ...]

    def sentence(self, question: str, share: Callable[[Row], str]) -> str:
        """For a note below a table."""
        parts = [
            f"{what} {', '.join(f'`{name}`' for name in names)}"
            for what, names in (
                ("better:", self.better),
                ("as good (intervals overlap):", self.equal),
                ("worse:", self.worse),
            )
            if names
        ]
        return f"{question}: `{OURS}` {share(self.own)}; {'; '.join(parts) or 'no other row'}"


def _figures(row: Row) -> Row:
    figures: Row = row["figures"]
    return figures


def ranking_of(rows: Sequence[Row], figures: Callable[[Row], Row] = _figures) -> Ranking | None:
    """Where `guided` stands among rows of one question; None where it has no row with figures.

    Args:
      rows: one question's, of all methods; those that are missing are passed over.
      figures: of a row, with `low95` and `high95`.
    """
    made = [row for row in rows if "missing" not in row]
    own = next((row for row in made if name_of(row) == OURS), None)
    if own is None:
        return None
    low, high = figures(own)["low95"], figures(own)["high95"]
    others = [(name_of(row), figures(row)) for row in made if name_of(row) != OURS]
    better = [name for name, each in others if each["low95"] > high]
    worse = [name for name, each in others if each["high95"] < low]
    equal = [name for name, _ in others if name not in better and name not in worse]
    return Ranking(own, *(tuple(dict.fromkeys(each)) for each in (better, equal, worse)))


def by_question(rows: Iterable[Row], question: Callable[[Row], str]) -> dict[str, list[Row]]:
    """The rows by what is asked of all methods alike, in order."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(question(row), []).append(row)
    return groups


def success_notes(rows: Iterable[Row], question: Callable[[Row], str]) -> list[str]:
    """For each question, who succeeds as often as `guided`, and what it costs beside `spread`."""
    notes = []
    for asked, group in by_question(rows, question).items():
        found = ranking_of(group)
        if found is not None:
            said = found.sentence(asked, lambda row: share_of(row["figures"]))
            notes.append(said + _cost(found.own, group))
    return notes


def share_notes(rows: Iterable[Row], question: Callable[[Row], str], name: str = "share") -> list[str]:
    """Likewise of findings, rows with a share and its interval of their own."""
    notes = []
    for asked, group in by_question(rows, question).items():
        found = ranking_of(group, lambda row: row)
        if found is not None:
            notes.append(found.sentence(asked, lambda row: share_of(row, name)))
    return notes


def tally(rows: Sequence[Row], question: Callable[[Row], str]) -> str:
    """How often other rows are as good as `guided`, or better; "" where it has no row."""
    found = [each for group in by_question(rows, question).values() if (each := ranking_of(group))]
    if not found:
        return ""
    alone = sum(not each.better and not each.equal for each in found)
    parts = [f"`{OURS}` is ahead of all others in {alone} of {len(found)} comparisons"]
    for what, rivals in (
        ("as good", [name for each in found for name in each.equal]),
        ("better", [name for each in found for name in each.better]),
    ):
        counts = ", ".join(f"`{name}` in {rivals.count(name)}" for name in dict.fromkeys(rivals))
        parts += [f"{what}: {counts}"] if counts else []
    return "; ".join(parts)


def ranking(rows: Iterable[Row], name: str, digits: int, falls: bool = True) -> str:
    """The rows that have a figure, from the highest (or the lowest) on."""
    known = [row for row in rows if row.get(name) is not None]
    ordered = sorted(known, key=lambda row: -row[name] if falls else row[name])
    return ", ".join(f"`{name_of(row)}` {number(row[name], digits)}" for row in ordered)


def _cost(own: Row, rows: Sequence[Row]) -> str:
    """Of `guided` over that of `spread`; "" where one of them has no scene to show for it."""
    twin = next((row for row in rows if name_of(row) == TWIN and "figures" in row), None)
    if twin is None or not (own["figures"]["num_success"] and twin["figures"]["num_success"]):
        return ""
    attempts, steps = (
        own["figures"][name] / twin["figures"][name]
        for name in ("attempts_per_valid_scene", "simulated_steps_per_valid_scene")
    )
    return f"; attempts and steps per valid scene over those of `{TWIN}`: {attempts:.2f}, {steps:.2f}"
