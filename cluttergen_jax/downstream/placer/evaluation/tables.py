"""The figures of a placer, and rows of placers as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.placer.evaluation.bench import ProposalOutcomes
from cluttergen_jax.downstream.placer.pairs.store import PairLabels
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict

UNSEEN = (0.0, 0.1, 0.2, 0.3, 1.0)
"""Bounds of classes by the share of the region that the camera did not see."""
MANY = 7
"""So many standing objects or more."""
_BINS = 10


def figures_of(
    outcome: ProposalOutcomes, labels: PairLabels, names: Sequence[str]
) -> dict[str, Any]:
    """Everything that a table tells of one row; shares are of all queries unless it is said of which.

    Args:
      names: the world's objects.
    """
    first = outcome.verdict[:, 0]
    is_good = first == int(Verdict.STABLE)
    standing = labels.num_standing
    unseen = labels.unseen
    error = np.abs(outcome.z_error[np.isfinite(outcome.z_error)])
    return {
        "success": proportion(is_good),
        "best_of_all": proportion((outcome.verdict == int(Verdict.STABLE)).any(1)),
        "with_margin": proportion(outcome.has_margin),
        "paper": proportion(outcome.is_quiet),
        "verdicts": {v.label: float((first == int(v)).mean()) for v in Verdict if v >= 0},
        "z_error": {
            "median": finite(float(np.median(error))) if len(error) else None,
            "p90": finite(float(np.percentile(error, 90))) if len(error) else None,
        },
        "many": _share(is_good, standing >= MANY),
        "by_standing": [
            {"standing": int(k)} | _share(is_good, standing == k) for k in np.unique(standing)
        ],
        "by_object": [
            {"object": names[k]} | _share(is_good, labels.object_index == k)
            for k in np.unique(labels.object_index)
        ],
        "by_unseen": [
            {"from": low, "to": high} | _share(is_good, np.digitize(unseen, UNSEEN[1:-1]) == place)
            for place, (low, high) in enumerate(pairwise(UNSEEN))
        ],
        "unseen": float(unseen.mean()),
        "calibration": _calibration(outcome.score[:, 0], is_good),
    }


def _share(is_good: np.ndarray, which: np.ndarray) -> dict[str, Any]:
    """The share among some queries, and how many these are; None of none."""
    number = int(which.sum())
    empty = {"share": None, "low95": None, "high95": None}
    return (proportion(is_good[which]) if number else empty) | {"queries": number}


def _calibration(score: np.ndarray, is_good: np.ndarray) -> dict[str, Any] | None:
    """How far the scores are the chances that they say: the mean squared error, and the mean gap by tenths.

    None of placers that tell no chances.
    """
    if not np.isfinite(score).all():
        return None
    place = np.clip((score * _BINS).astype(int), 0, _BINS - 1)
    bins = []
    gap = 0.0
    for each in np.unique(place):
        which = place == each
        told = float(score[which].mean())
        found = float(is_good[which].mean())
        bins.append({"told": told, "found": found, "queries": int(which.sum())})
        gap += which.mean() * abs(told - found)
    return {"brier": float(((score - is_good) ** 2).mean()), "gap": float(gap), "bins": bins}


Row = dict[str, Any]
_SHOWN = (Verdict.DISPLACED, Verdict.PENETRATING, Verdict.UNSETTLED, Verdict.OUTSIDE)
_NAMES = {
    "drop": "drop (full state)",
    "guided": "guided (full state)",
    "policy": "policy (full state)",
}


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """The main table, then shares by number standing, by what is unseen, and by object."""
    asked = rows[0]["trial"]
    place = (
        f"{asked['queries']} queries of {asked['pool']} on {asked['support']}, {_cameras(asked)}"
    )
    notes = [
        *NOTES,
        "full state: a method that sees the scene itself, five attempts; it is no placer",
    ]
    cells = tuple((*_head(row), *main_cells(row["figures"])) for row in rows)
    main = Table(place, ("placer", "noise", *MAIN), cells, tuple(notes))
    return [
        main,
        _by_the_paper(rows),
        _by(
            rows,
            "by_standing",
            "By number of objects that stand",
            lambda each: str(each["standing"]),
        ),
        _by(
            rows,
            "by_unseen",
            "By share of the region unseen",
            lambda e: f"{e['from']:.0%}-{e['to']:.0%}",
        ),
        _by(rows, "by_object", "By object", lambda each: each["object"]),
    ]


def _cameras(asked: dict[str, Any]) -> str:
    number = asked.get("cameras", 1)
    return (
        f"{number} cameras {asked['camera']}, fused" if number > 1 else f"camera {asked['camera']}"
    )


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
    columns = (
        "placer",
        "noise",
        "stands",
        "paper's count",
        "paper's count, invalid pairs left out",
    )
    notes = (
        "paper's count: every object is quiet for 20 steps within 60, at 2 deg/s; neighbours may be pushed",
        "left out: pairs in which neither the proposal nor the scene's own pose counts",
    )
    return Table("By the paper's own count", columns, tuple(cells), notes)


def _by(rows: Sequence[Row], name: str, title: str, word: Callable[[Row], str]) -> Table:
    """A table of shares with a column for each class of queries, and how many queries each has."""
    classes = rows[0]["figures"][name]
    columns = ("placer", "noise", *(f"{word(each)} ({each['queries']})" for each in classes))
    cells = tuple(
        (*_head(row), *(cell(each["share"]) for each in row["figures"][name])) for row in rows
    )
    return Table(f"{title} (queries)", columns, cells)


def _head(row: Row) -> tuple[str, str]:
    placer = row["trial"]["placer"]
    return _NAMES.get(placer, Path(placer).name), f"{row['trial']['noise']:g}"


def cell(share: float | None) -> str:
    """A share; "-" of nothing."""
    return "-" if share is None else f"{share:.3f}"


def with_interval(figure: Mapping[str, float]) -> str:
    """A share with its interval."""
    return f"{figure['share']:.3f} [{figure['low95']:.3f}, {figure['high95']:.3f}]"
