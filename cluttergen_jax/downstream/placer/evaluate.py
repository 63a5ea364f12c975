"""Placers side by side on the queries of one split: rows that are kept, and their tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.placer.bench import Bench, Outcome
from cluttergen_jax.downstream.placer.figures import MANY, figures_of
from cluttergen_jax.downstream.placer.pairs import PairLabels, PairSet, load_queries
from cluttergen_jax.downstream.placer.proposers import FullState, find_placer
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS, PlacementQuery, Placer
from cluttergen_jax.evaluation.machine import versions
from cluttergen_jax.evaluation.store import Store, json_bytes
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.methods import checkpoint_of
from cluttergen_jax.progress import Progress
from cluttergen_jax.proportions import proportion
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE, NoiseConfig
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict

Row = dict[str, Any]
_SHOWN = (Verdict.DISPLACED, Verdict.PENETRATING, Verdict.UNSETTLED, Verdict.OUTSIDE)
_NAMES = {"drop": "drop (full state)", "guided": "guided (full state)", "policy": "policy (full state)"}


@dataclass(frozen=True)
class PlacerComparison:
    """What became of placers on the queries of one split.

    Attributes:
      rows: one for each placer and noise: `trial`, `sources` and `figures` (`figures.figures_of`).
      tables: the same for people.
    """

    rows: list[Row]
    tables: list[Table]

    def __str__(self) -> str:
        return "\n\n".join(f"{table.title}\n\n{table.markdown()}" for table in self.tables)

    def write(self, folder: Path) -> None:
        """Writes table.md and results.json."""
        write_atomically(folder / "table.md", f"{self}\n".encode())
        write_atomically(folder / "results.json", json_bytes(self.rows))


class Trials:
    """Makes and keeps the rows of one split; queries are read and worlds compiled when a row needs them.

    Args:
      pairs, split: the queries; num_pairs: the first so many, all if None.
      seed: of noise and proposals; store: where rows are kept; fresh: make them again.
      num_threads: 0 takes every core.

    Raises:
      ConfigError: there is no such split.
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
    ) -> None:
        self.pairs, self.split, self.made = pairs, split, pairs.split(split)
        self.num_pairs = num_pairs or int(self.made["num_pairs"])
        self.seed, self.store, self.is_fresh, self._num_threads = seed, store, fresh, num_threads
        self._seen: tuple[float, PlacementQuery, PairLabels] | None = None

    def row(self, placer: str, noise: float, on_made: Callable[[int], None] = lambda number: None) -> Row:
        """A placer's row: from disk, or made now.

        Raises:
          ConfigError, PoolError: there is no such placer, or it is damaged.
        """
        found = find_placer(placer)
        trial = self._trial(placer, noise)
        sources = self._sources(placer, found)
        text = json.dumps({"trial": trial, "sources": sources}, sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:20]
        title = f"{Path(placer).name} noise {noise:g} {self.split} {trial['pool']} {trial['support']}"
        known = None if self.is_fresh else self.store.read(title, key)
        if known is None:
            figures, outcome = self._made(found, noise)
            row = {"trial": trial, "sources": sources, "figures": figures}
            known = self.store.write(title, key, row, outcome._asdict())
        on_made(self.num_pairs)
        return known

    def _trial(self, placer: str, noise: float) -> dict[str, Any]:
        recipe = self.made["recipe"]
        return {
            "placer": placer,
            "noise": noise,
            "split": self.split,
            "queries": self.num_pairs,
            "seed": self.seed,
            "pool": Path(str(recipe["pool"])).name,
            "support": Path(str(recipe["support"])).name,
            "camera": self.made["camera"],
            "method": recipe["method"],
        }

    def _sources(self, placer: str, found: Placer | FullState) -> dict[str, Any]:
        """Hashes of what decides the figures beside the trial."""
        if isinstance(found, FullState):
            checkpoint = checkpoint_of(found.method, self.made["recipe"]["pool"])
            weights = None if checkpoint is None else checkpoint.hash
        else:
            weights = _folder_hash(Path(placer)) if Path(placer).is_dir() else None
        told = {name: value for name, value in self.made.items() if name != "num_pairs"}
        text = json.dumps([told, self.pairs.record["assets"]], sort_keys=True)
        return {
            "pairs": hashlib.sha256(text.encode()).hexdigest(),
            "placer": weights,
            "versions": versions(),
        }

    def _made(self, placer: Placer | FullState, noise: float) -> tuple[dict[str, Any], Outcome]:
        queries, labels = self._queries(noise)
        outcome = self._bench.judge(self._bench.proposals(placer, queries, self.seed))
        # The published code leaves out pairs where the scene's own pose does not count either.
        is_asked = outcome.is_quiet | self._is_own_quiet
        figures = figures_of(outcome, labels, self._bench.problem.world.names)
        figures["paper_without_invalid"] = proportion(outcome.is_quiet[is_asked])
        figures["stands_without"] = float(self._stands_alone.mean())
        return figures, outcome

    def _queries(self, noise: float) -> tuple[PlacementQuery, PairLabels]:
        if self._seen is None or self._seen[0] != noise:
            loaded = load_queries(
                self.pairs, noise_of(noise), self.seed, self.split, self.num_pairs, self._num_threads
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

    @cached_property
    def _stands_alone(self) -> np.ndarray:
        return self._bench.stands_alone()


def compare_placers(
    trials: Trials, placers: Sequence[str], noises: Sequence[float], folder: Path | None
) -> PlacerComparison:
    """The rows of placers and their tables, written into the folder if there is one; by noise, then placer.

    Raises:
      ConfigError, PoolError: there is no such placer, or it is damaged.
    """
    for placer in placers:
        # Before an hour of work.
        find_placer(placer)
    total = len(placers) * len(noises) * trials.num_pairs
    with Progress("judging", total, "query") as progress:
        rows = [trials.row(placer, noise, progress.update) for noise in noises for placer in placers]
    found = PlacerComparison(rows, tables_of(rows))
    if folder is not None:
        found.write(folder)
    return found


def noise_of(factor: float) -> NoiseConfig:
    """So many times the noise of a depth camera; 0 for none."""
    return REALSENSE.scaled(factor) if factor else NOISE_OFF


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """The main table, then shares by number standing, by what is unseen, and by object."""
    asked = rows[0]["trial"]
    place = f"{asked['queries']} queries of {asked['pool']} on {asked['support']}, camera {asked['camera']}"
    columns = (
        "placer",
        "noise",
        "stands [95 %]",
        f"{MANY} or more standing",
        f"best of {NUM_PROPOSALS}",
        "with margin",
        "paper's count",
        "z error mm",
        *(verdict.label for verdict in _SHOWN),
        "other",
    )
    notes = [
        "stands: the first proposal comes to rest as docs/contract.md asks, and then the whole scene stands",
        "z error: median distance of the proposed height from that of a release on the true map",
        "full state: a method that sees the scene itself, five attempts; it is no placer",
    ]
    main = Table(place, columns, tuple(map(_main, rows)), tuple(notes))
    return [
        main,
        _by(rows, "by_standing", "By number of objects that stand", lambda each: str(each["standing"])),
        _by(rows, "by_unseen", "By share of the region unseen", lambda e: f"{e['from']:.0%}-{e['to']:.0%}"),
        _by(rows, "by_object", "By object", lambda each: each["object"]),
    ]


def _main(row: Row) -> tuple[str, ...]:
    figures = row["figures"]
    verdicts = figures["verdicts"]
    told = {verdict.label for verdict in (*_SHOWN, Verdict.STABLE)}
    other = sum(share for name, share in verdicts.items() if name not in told)
    error = figures["z_error"]["median"]
    return (
        *_head(row),
        _with_interval(figures["success"]),
        _cell(figures["many"]["share"]),
        _cell(figures["best_of_all"]["share"]),
        _cell(figures["with_margin"]["share"]),
        _cell(figures["paper"]["share"]),
        "-" if error is None else f"{1000 * error:.1f}",
        *(_cell(verdicts[verdict.label]) for verdict in _SHOWN),
        _cell(other),
    )


def _by(rows: Sequence[Row], name: str, title: str, word: Callable[[Row], str]) -> Table:
    """A table of shares with a column for each class of queries, and how many queries each has."""
    classes = rows[0]["figures"][name]
    columns = ("placer", "noise", *(f"{word(each)} ({each['queries']})" for each in classes))
    cells = tuple((*_head(row), *(_cell(each["share"]) for each in row["figures"][name])) for row in rows)
    return Table(f"{title} (queries)", columns, cells)


def _head(row: Row) -> tuple[str, str]:
    placer = row["trial"]["placer"]
    return _NAMES.get(placer, Path(placer).name), f"{row['trial']['noise']:g}"


def _cell(share: float | None) -> str:
    return "-" if share is None else f"{share:.3f}"


def _with_interval(figure: dict[str, float]) -> str:
    return f"{figure['share']:.3f} [{figure['low95']:.3f}, {figure['high95']:.3f}]"


def _folder_hash(folder: Path) -> str:
    """The digest of a checkpoint's files."""
    files = sorted(each for each in folder.rglob("*") if each.is_file())
    parts = [f"{each.relative_to(folder)}".encode() + each.read_bytes() for each in files]
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()
