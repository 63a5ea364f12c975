"""Rows of placers as tables: the main one, by the paper's count, by kinds of queries, and of chains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cluttergen_jax.downstream.placer.evaluation.figures import MANY
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict

Row = dict[str, Any]
_SHOWN = (Verdict.DISPLACED, Verdict.PENETRATING, Verdict.UNSETTLED, Verdict.OUTSIDE)
_NAMES = {"drop": "drop (full state)", "guided": "guided (full state)", "policy": "policy (full state)"}


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """The main table, then shares by number standing, by what is unseen, and by object."""
    asked = rows[0]["trial"]
    place = f"{asked['queries']} queries of {asked['pool']} on {asked['support']}, {_cameras(asked)}"
    notes = [*NOTES, "full state: a method that sees the scene itself, five attempts; it is no placer"]
    cells = tuple((*_head(row), *main_cells(row["figures"])) for row in rows)
    main = Table(place, ("placer", "noise", *MAIN), cells, tuple(notes))
    return [
        main,
        _by_the_paper(rows),
        _by(rows, "by_standing", "By number of objects that stand", lambda each: str(each["standing"])),
        _by(rows, "by_unseen", "By share of the region unseen", lambda e: f"{e['from']:.0%}-{e['to']:.0%}"),
        _by(rows, "by_object", "By object", lambda each: each["object"]),
    ]


def _cameras(asked: dict[str, Any]) -> str:
    number = asked.get("cameras", 1)
    return f"{number} cameras {asked['camera']}, fused" if number > 1 else f"camera {asked['camera']}"


def chain_table(chains: Sequence[Row]) -> Table:
    """How many tables were filled, and the share of placements that found a place, by slot."""
    slots = range(max(len(row["by_slot"]) for row in chains))
    cells = []
    for row in chains:
        shares = [cell(each["share"]) for each in row["by_slot"]]
        filled = (*_head(row), with_interval(row["success"]), f"{row['placed']:.2f}")
        cells.append((*filled, *shares, *("-" for _ in slots[len(shares) :])))
    columns = (
        "placer",
        "noise",
        "filled and standing",
        "placed",
        *(f"{slot} standing" for slot in slots),
    )
    notes = (
        "each object is placed on what the camera sees after the last, five proposals each; a table is "
        "given up at the first object for which none is stable",
    )
    title = f"{chains[0]['trial']['chains']} tables filled from nothing"
    return Table(title, columns, tuple(cells), notes)


MAIN = (
    "stands [95 %]",
    f"{MANY} or more standing",
    f"best of {NUM_PROPOSALS}",
    "with margin",
    "paper's count",
    "z error mm",
    *(verdict.label for verdict in _SHOWN),
    "other",
)
"""What the main table tells of each row."""
NOTES = (
    "stands: the first proposal comes to rest as docs/contract.md asks, and then the whole scene stands",
    "z error: median distance of the proposed height from that of a release on the true map",
)


def main_cells(figures: dict[str, Any]) -> tuple[str, ...]:
    """The cells of `MAIN`."""
    verdicts = figures["verdicts"]
    told = {verdict.label for verdict in (*_SHOWN, Verdict.STABLE)}
    other = sum(share for name, share in verdicts.items() if name not in told)
    error = figures["z_error"]["median"]
    return (
        with_interval(figures["success"]),
        cell(figures["many"]["share"]),
        cell(figures["best_of_all"]["share"]),
        cell(figures["with_margin"]["share"]),
        cell(figures["paper"]["share"]),
        "-" if error is None else f"{1000 * error:.1f}",
        *(cell(verdicts[verdict.label]) for verdict in _SHOWN),
        cell(other),
    )


def _by_the_paper(rows: Sequence[Row]) -> Table:
    """The share that counts as in the paper, of all queries and as its code tells it."""
    cells = [
        (
            *_head(row),
            with_interval(row["figures"]["success"]),
            with_interval(row["figures"]["paper"]),
            with_interval(row["figures"]["paper_without_invalid"]),
        )
        for row in rows
    ]
    columns = ("placer", "noise", "stands", "paper's count", "paper's count, invalid pairs left out")
    notes = (
        "paper's count: every object is quiet for 20 steps within 60, at 2 deg/s; neighbours may be pushed",
        "left out: pairs in which neither the proposal nor the scene's own pose counts",
    )
    return Table("By the paper's own count", columns, tuple(cells), notes)


def _by(rows: Sequence[Row], name: str, title: str, word: Callable[[Row], str]) -> Table:
    """A table of shares with a column for each class of queries, and how many queries each has."""
    classes = rows[0]["figures"][name]
    columns = ("placer", "noise", *(f"{word(each)} ({each['queries']})" for each in classes))
    cells = tuple((*_head(row), *(cell(each["share"]) for each in row["figures"][name])) for row in rows)
    return Table(f"{title} (queries)", columns, cells)


def _head(row: Row) -> tuple[str, str]:
    placer = row["trial"]["placer"]
    return _NAMES.get(placer, Path(placer).name), f"{row['trial']['noise']:g}"


def cell(share: float | None) -> str:
    """A share; "-" of nothing."""
    return "-" if share is None else f"{share:.3f}"


def with_interval(figure: dict[str, float]) -> str:
    """A share with its interval."""
    return f"{figure['share']:.3f} [{figure['low95']:.3f}, {figure['high95']:.3f}]"
