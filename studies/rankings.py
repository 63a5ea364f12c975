"""Rankings of a table's rows as sentences: whose figures are as good as those of `guided`.

Nothing here is written by hand: who is ahead is read from the rows, so that a table and the words below it
cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cluttergen_jax.evaluation.comparison import name_of, number, share_of, values_of
from cluttergen_jax.evaluation.records import Row

# The method that the sentences are about, and the same sampler without a network.
OURS = "guided"
TWIN = "spread"

Question = Callable[[Row], str]
"""What a row asks of all methods alike."""


@dataclass(frozen=True)
class Ranking:
    """How a method compares with the other rows of one question.

    Attributes:
      own: the method's row; better, equal, worse: names of the others, by whether the 95 % interval of their
        share lies above its own, overlaps it, or lies below.
    """

    own: Row
    better: tuple[str, ...]
    equal: tuple[str, ...]
    worse: tuple[str, ...]

    def sentence(self, question: str, share: str) -> str:
        """For a note below a table; `share` is the method's own with its interval."""
        named = {
            "better:": self.better,
            "as good (intervals overlap):": self.equal,
            "worse:": self.worse,
        }
        parts = [
            f"{what} {', '.join(f'`{name}`' for name in names)}"
            for what, names in named.items()
            if names
        ]
        return f"{question}: `{OURS}` {share}; {'; '.join(parts) or 'no other row'}"


def ranking_of(
    rows: Sequence[Row], figures: Callable[[Row], Mapping[str, Any]] = lambda row: row["figures"]
) -> Ranking | None:
    """How `guided` compares with the other rows of one question; None where it has no row with figures.

    Args:
      rows: one question's, of all methods; those that are missing are passed over.
      figures: of a row, with `low95` and `high95`.
    """
    made = [row for row in rows if "missing" not in row]
    own = next((row for row in made if name_of(row) == OURS), None)
    if own is None:
        return None
    low = figures(own)["low95"]
    high = figures(own)["high95"]
    others = [(name_of(row), figures(row)) for row in made if name_of(row) != OURS]
    better = [name for name, each in others if each["low95"] > high]
    worse = [name for name, each in others if each["high95"] < low]
    equal = [name for name, _ in others if name not in better and name not in worse]
    return Ranking(own, *(tuple(dict.fromkeys(each)) for each in (better, equal, worse)))


def by_question(rows: Iterable[Row], question: Question) -> dict[str, list[Row]]:
    """The rows of each question, in order."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(question(row), []).append(row)
    return groups


def success_notes(rows: Iterable[Row], question: Question) -> list[str]:
    """For each question, who succeeds as often as `guided`, and what it costs beside `spread`."""
    found = (
        (asked, group, ranking_of(group)) for asked, group in by_question(rows, question).items()
    )
    return [
        each.sentence(asked, share_of(each.own["figures"])) + _cost(each.own, group)
        for asked, group, each in found
        if each is not None
    ]


def share_notes(rows: Iterable[Row], question: Question) -> list[str]:
    """Likewise of findings, rows with a share and its interval of their own."""
    found = (
        (asked, ranking_of(group, dict)) for asked, group in by_question(rows, question).items()
    )
    return [
        each.sentence(asked, share_of(each.own, "share"))
        for asked, each in found
        if each is not None
    ]


def tally(rows: Sequence[Row], question: Question) -> str:
    """How often other rows are as good as `guided`, or better; "" where it has no row."""
    found = [each for group in by_question(rows, question).values() if (each := ranking_of(group))]
    if not found:
        return ""
    alone = sum(not each.better and not each.equal for each in found)
    parts = [f"`{OURS}` is ahead of all others in {alone} of {len(found)} comparisons"]
    for what, names in (
        ("as good", [name for each in found for name in each.equal]),
        ("better", [name for each in found for name in each.better]),
    ):
        counts = ", ".join(f"`{name}` in {names.count(name)}" for name in dict.fromkeys(names))
        parts += [f"{what}: {counts}"] if counts else []
    return "; ".join(parts)


def ranking(rows: Iterable[Row], name: str, digits: int, falls: bool = True) -> str:
    """The rows that have a figure, from the highest (or the lowest) on."""
    values = ((name_of(row), values_of(row).get(name)) for row in rows)
    known = [(method, value) for method, value in values if value is not None]
    ordered = sorted(known, key=lambda each: -each[1] if falls else each[1])
    return ", ".join(f"`{method}` {number(value, digits)}" for method, value in ordered)


def _cost(own: Row, rows: Sequence[Row]) -> str:
    """Of `guided` over that of `spread`; "" where one of them has no scene to show for it."""
    ours = own["figures"]
    theirs = next(
        (row["figures"] for row in rows if name_of(row) == TWIN and "figures" in row), None
    )
    if theirs is None or not (ours["num_success"] and theirs["num_success"]):
        return ""
    attempts, steps = (
        values_of(ours)[name] / values_of(theirs)[name]
        for name in ("attempts_per_valid_scene", "simulated_steps_per_valid_scene")
    )
    return (
        f"; attempts and steps per valid scene over those of `{TWIN}`: {attempts:.2f}, {steps:.2f}"
    )
