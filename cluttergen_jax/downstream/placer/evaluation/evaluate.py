"""Placers side by side on the queries of one split: rows that are kept, and their tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.downstream.digests import folder_hash, json_digest
from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE, NoiseConfig
from cluttergen_jax.downstream.placer.evaluation.bench import Bench, ProposalOutcomes
from cluttergen_jax.downstream.placer.evaluation.chain import Chains
from cluttergen_jax.downstream.placer.evaluation.tables import (
    Row,
    chain_table,
    figures_of,
    tables_of,
)
from cluttergen_jax.downstream.placer.heads.checkpoint import placer_folder
from cluttergen_jax.downstream.placer.pairs.store import (
    PairLabels,
    PairSet,
    load_queries,
    of_tenths,
)
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes
from cluttergen_jax.downstream.placer.proposers import FullState, find_placer
from cluttergen_jax.downstream.placer.query import PlacementQuery, Placer, PlainPlacer
from cluttergen_jax.downstream.placer.scene_cameras import check_cameras
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import Store, json_bytes, versions
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning import checkpoint_of
from cluttergen_jax.own_parts import part_label, part_name
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Bank, read_bank
from cluttergen_jax.statistics import proportion
from cluttergen_jax.tables import Table

AnyPlacer = str | Path | Placer | PlainPlacer
"""By name, by folder, or one of the user's own."""


@dataclass(frozen=True)
class PlacerComparison:
    """What became of placers on the queries of one split.

    Attributes:
      rows: one for each placer and noise: `trial`, `sources` and `figures` (`figures.figures_of`).
      tables: the same for people.
      chains: figures of tables that placers filled by themselves (`chain.Chains.run`), if asked for.
    """

    rows: list[Row]
    tables: list[Table]
    chains: list[Row] = field(default_factory=list)

    def __str__(self) -> str:
        return "\n\n".join(f"{table.title}\n\n{table.markdown()}" for table in self.tables)

    def write(self, folder: Path) -> None:
        """Writes table.md and results.json."""
        write_atomically(folder / "table.md", f"{self}\n".encode())
        write_atomically(folder / "results.json", json_bytes(self.rows))
        if self.chains:
            write_atomically(folder / "chains.json", json_bytes(self.chains))


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
        """How far a placer gets in filling tables by itself (`chain.Chains`); None of full-state methods."""
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
        figures["stands_without"] = float(self._stands_alone.mean())
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

    @cached_property
    def _stands_alone(self) -> np.ndarray:
        return self._bench.stands_alone()


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
