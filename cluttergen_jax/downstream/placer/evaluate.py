"""Placers side by side on the queries of one split: figures that are kept, and their tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.digests import folder_hash, json_digest
from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE, NoiseConfig
from cluttergen_jax.downstream.placer.bench import Bench, Chains, ProposalOutcomes
from cluttergen_jax.downstream.placer.map_from_depth import check_cameras
from cluttergen_jax.downstream.placer.pairs import (
    PairLabels,
    PairSet,
    load_queries,
    of_tenths,
)
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes
from cluttergen_jax.downstream.placer.proposers import FullState, find_placer
from cluttergen_jax.downstream.placer.query import (
    NUM_PROPOSALS,
    PlacementQuery,
    Placer,
    PlainPlacer,
)
from cluttergen_jax.downstream.placer.scored import placer_folder
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import Store, versions
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning import checkpoint_of
from cluttergen_jax.own_parts import part_label, part_name
from cluttergen_jax.physics import Verdict
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Bank, read_bank
from cluttergen_jax.statistics import proportion
from cluttergen_jax.tables import Table

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
            "median": float(np.median(error)) if len(error) else None,
            "p90": float(np.percentile(error, 90)) if len(error) else None,
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


AnyPlacer = str | Path | Placer | PlainPlacer
"""By name, by folder, or one of the user's own."""


@dataclass(frozen=True)
class PlacerComparison:
    """What became of placers on the queries of one split.

    Attributes:
      rows: one for each placer and noise: `trial`, `sources` and `figures` (`figures_of`).
      tables: the same for people.
      chains: figures of tables that placers filled by themselves (`bench.Chains.run`), if asked for.
    """

    rows: list[Row]
    tables: list[Table]
    chains: list[Row] = field(default_factory=list)

    def __str__(self) -> str:
        return "\n\n".join(f"{table.title}\n\n{table.markdown()}" for table in self.tables)

    def write(self, folder: Path) -> None:
        """Writes table.md and results.json."""
        write_atomically(folder / "table.md", f"{self}\n".encode())
        made = {"results.json": self.rows, "chains.json": self.chains}
        for name, rows in made.items():
            if rows or name == "results.json":
                text = json.dumps(rows, indent=1, allow_nan=False)
                write_atomically(folder / name, f"{text}\n".encode())


class PlacerTrials:
    """Makes and keeps the rows of one split; queries are read and worlds compiled when a row needs them.

    Args:
      pairs, split: the queries; num_pairs: the first so many, all if None.
      seed: of noise and proposals; store: where rows are kept; fresh: make them again.
      num_threads: 0 takes every core.
      num_cameras: that look at each scene, their maps fused.
      tenth: only pairs whose numbers end in this digit; all if None.

    Raises:
      ConfigError: there is no such split, or there are not so many cameras.
    """

    def __init__(
        self,
        pairs: PairSet,
        split: str,
        num_pairs: int | None,
        seed: int,
        store: Store,
        fresh: bool = False,
        num_threads: int = 0,
        num_cameras: int = 1,
        tenth: int | None = None,
    ) -> None:
        self.pairs = pairs
        self.split = split
        self.made = pairs.split(split)
        check_cameras(num_cameras, self.made["camera"])
        self.num_cameras = num_cameras
        self.tenth = tenth
        self.num_pairs = int(self.made["num_pairs"]) if num_pairs is None else num_pairs
        self.seed = seed
        self.store = store
        self.is_fresh = fresh
        self._num_threads = num_threads
        self._seen: tuple[float, PlacementQuery, PairLabels] | None = None

    @property
    def num_queries(self) -> int:
        """How many are asked."""
        return self.num_pairs if self.tenth is None else len(range(self.tenth, self.num_pairs, 10))

    def row(
        self,
        placer: AnyPlacer,
        noise: float,
        on_made: Callable[[int], None] = lambda number: None,
        name: str | None = None,
    ) -> Row:
        """A placer's row: from disk, or made now.

        Args:
          name: what the row calls the placer; as it was asked for if None.

        Raises:
          ConfigError, PoolError: there is no such placer, or it is damaged.
        """
        found = find_placer(placer)
        name = name or _name_of(placer)
        trial = self._trial(name, noise)
        sources = self._sources(placer, found)
        key = json_digest({"trial": trial, "sources": sources}, 20)
        title = f"{Path(name).name} noise {noise:g} {self.split} {self._place(trial)}"
        known = None if self.is_fresh else self.store.read(title, key)
        if known is None:
            figures, outcome = self._evaluate(found, noise)
            row = {"trial": trial, "sources": sources, "figures": figures}
            known = self.store.write(title, key, row, outcome._asdict())
        on_made(self.num_queries)
        return known

    def bank(self) -> Bank:
        """The bank behind the split. Raises ConfigError: the folder does not hold it."""
        place = self.pairs.path / f"bank-{self.split}"
        if not place.is_dir():
            raise ConfigError(
                f"`chains` with {self.pairs.path}, which does not hold the bank behind {self.split!r}",
                "pairs whose bank was made along with them",
                "placer_data without `bank`, or leaving out `chains`",
            )
        return read_bank(place)

    def chain(self, placer: AnyPlacer, noise: float, number: int) -> Row | None:
        """How far a placer gets in filling tables by itself (`bench.Chains`); None of full-state methods."""
        found = find_placer(placer)
        if isinstance(found, FullState):
            return None
        name = _name_of(placer)
        trial = self._trial(name, noise) | {"chains": number}
        key = json_digest([trial, self._sources(placer, found)], 20)
        title = f"{number} chains by {Path(name).name} noise {noise:g} {self._place(trial)}"
        known = None if self.is_fresh else self.store.read(title, key)
        if known is not None:
            return known["figures"]
        scenes = PartialScenes(self.bank(), self._num_threads)
        chains = Chains(
            scenes,
            number,
            self.made["camera"],
            noise_of(noise),
            self.seed,
            self._num_threads,
            self.num_cameras,
        )
        figures = chains.run(found) | {"trial": trial | {"chains": chains.num_chains}}
        return self.store.keep(title, key, figures)

    def _place(self, trial: dict[str, Any]) -> str:
        """What a row's title tells of its queries."""
        cameras = f" {self.num_cameras} cameras" if self.num_cameras > 1 else ""
        tenth = "" if self.tenth is None else f" tenth {self.tenth}"
        return f"{trial['pool']} {trial['support']}{cameras}{tenth}"

    def _trial(self, placer: str, noise: float) -> dict[str, Any]:
        recipe = self.made["recipe"]
        # Only where they are asked for: rows of earlier versions are still found.
        more = {"cameras": self.num_cameras} if self.num_cameras > 1 else {}
        more |= {} if self.tenth is None else {"tenth": self.tenth}
        return {
            "placer": placer,
            "noise": noise,
            "split": self.split,
            "queries": self.num_queries,
            "seed": self.seed,
            "pool": Path(str(recipe["pool"])).name,
            "support": Path(str(recipe["support"])).name,
            "camera": self.made["camera"],
            "method": recipe["method"],
            **more,
        }

    def _sources(
        self, placer: AnyPlacer, found: Placer | PlainPlacer | FullState
    ) -> dict[str, object]:
        """Hashes of what decides the figures beside the trial."""
        if isinstance(found, FullState):
            trained = checkpoint_of(found.method, self.made["recipe"]["pool"])
            weights = None if trained is None else trained.hash
        elif not isinstance(placer, str | Path):
            weights = part_label(placer, "placers")
        else:
            folder = placer_folder(placer)
            weights = None if folder is None else folder_hash(folder)
        told = {name: value for name, value in self.made.items() if name != "num_pairs"}
        return {
            "pairs": json_digest([told, self.pairs.record["assets"]]),
            "placer": weights,
            "noise_seed": SPLITS[self.split] + self.seed,
            "versions": versions(),
        }

    def _evaluate(
        self, placer: Placer | PlainPlacer | FullState, noise: float
    ) -> tuple[dict[str, Any], ProposalOutcomes]:
        queries, labels = self._queries(noise)
        outcome = self._bench.judge(self._bench.proposals(placer, queries, self.seed))
        # The published code leaves out pairs where the scene's own pose does not count either.
        is_asked = outcome.is_quiet | self._is_own_quiet
        figures = figures_of(outcome, labels, self._bench.problem.world.names)
        num_asked = int(is_asked.sum())
        figures["paper_without_invalid"] = proportion(outcome.is_quiet[is_asked]) | {
            "queries": num_asked
        }
        return figures, outcome

    def _queries(self, noise: float) -> tuple[PlacementQuery, PairLabels]:
        if self._seen is None or self._seen[0] != noise:
            loaded = load_queries(
                self.pairs,
                noise_of(noise),
                self.seed,
                self.split,
                self.num_pairs,
                self._num_threads,
                self.num_cameras,
                None if self.tenth is None else of_tenths(self.tenth),
            )
            self._seen = (noise, *loaded)
        return self._seen[1], self._seen[2]

    @cached_property
    def _bench(self) -> Bench:
        assert self._seen is not None
        return Bench(self.pairs.setup(self.split), self._seen[2], self._num_threads)

    @cached_property
    def _is_own_quiet(self) -> np.ndarray:
        return self._bench.is_own_quiet()


def _name_of(placer: AnyPlacer) -> str:
    return str(placer) if isinstance(placer, str | Path) else part_name(placer)


def compare_placers(
    trials: PlacerTrials,
    placers: Sequence[AnyPlacer],
    noises: Sequence[float],
    folder: Path | None,
    num_chains: int = 0,
) -> PlacerComparison:
    """The rows of placers and their tables, written into the folder if there is one; by noise, then placer.

    Args:
      num_chains: tables that each placer fills by itself besides.

    Raises:
      ConfigError, PoolError: there is no such placer, or it is damaged.
    """
    for placer in placers:
        # Before an hour of work.
        if not isinstance(find_placer(placer), FullState) and not isinstance(placer, str | Path):
            part_label(placer, "placers")
    names = list(map(_name_of, placers))
    if twice := sorted({name for name in names if names.count(name) > 1}):
        given = f"placers of one name: {', '.join(twice)}"
        raise ConfigError(given, "each once", "an attribute `name` of your own ones")
    if num_chains:
        trials.bank()
    total = len(placers) * len(noises) * trials.num_queries
    with Progress("placing", total, "proposal") as progress:
        rows = [
            trials.row(placer, noise, progress.update) for noise in noises for placer in placers
        ]
    asked = [(placer, noise) for noise in noises for placer in placers] if num_chains else []
    chains = [row for each in asked if (row := trials.chain(*each, num_chains)) is not None]
    tables = tables_of(rows) + ([chain_table(chains)] if chains else [])
    found = PlacerComparison(rows, tables, chains)
    if folder is not None:
        found.write(folder)
    return found


def noise_of(factor: float) -> NoiseConfig:
    """So many times the noise of a depth camera; 0 for none."""
    return REALSENSE.scale(factor) if factor else NOISE_OFF
