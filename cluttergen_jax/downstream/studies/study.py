"""A study of the suite `downstream`: what it asks, and the folder in which its data and rows are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from cluttergen_jax.config import MAX_PAIRS, PlacerHead, PlacerNoise, SensedFrom, check_range
from cluttergen_jax.downstream.placer.api import placer_data
from cluttergen_jax.downstream.placer.evaluation.evaluate import PlacerTrials
from cluttergen_jax.downstream.placer.evaluation.tables import Row
from cluttergen_jax.downstream.placer.examples import ExampleSource
from cluttergen_jax.downstream.placer.pairs.store import PairSet
from cluttergen_jax.downstream.placer.training import PlacerTraining, preset
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import MAX_TRIALS
from cluttergen_jax.tables import Table

NOISES = (0.0, 1.0)
NUM_OBJECTS = 10
_SCENES, _QUICK_SCENES = 100, 2
VALIDATING = (60, 600)
"""Scenes and pairs of the split `val` beside a training set."""
_QUICK_PAIRS, _QUICK_EPOCHS = 100, 1
_SEEDS = 3
MOST_SEED = 999_999
"""Of pairs, whose splits' banks have seeds in ranges of their own."""


@dataclass(frozen=True)
class PlacementSet:
    """Queries that placers are compared on: scenes of a pool on a support, one camera a query.

    Attributes:
      camera: `free` draws one for each query; see `cluttergen_jax.placer_data`.
    """

    name: str
    pool: str
    support: str = "table"
    camera: SensedFrom = "free"


SETS = (
    PlacementSet("household", "household"),
    PlacementSet("small-table", "household", "table-0.40x0.50"),
    PlacementSet("dining", "dining"),
    PlacementSet("kitchen", "kitchen"),
    PlacementSet("office", "office"),
    PlacementSet("study", "study"),
)
HOUSEHOLD = SETS[0]


@dataclass(frozen=True)
class Scale:
    """How much is to be done.

    Attributes:
      quick: a look at everything within minutes; its figures say nothing.
      num_scenes: of each test set, ten queries and one chain each, or episodes of a robot, or moments that
        perception sees; the study's own number if None.
      num_pairs: the most that a placer learns from; what each study asks for if None.
      seeds: training seeds; 3 if None, 1 if quick.
      heads: that are trained where a study asks for some; its own if empty.
      pools: of the sets of `placement`; all if empty.
      bank: made by hand, for `source`.
      seed: of scenes, noise and proposals.
    """

    quick: bool = False
    num_scenes: int | None = None
    num_pairs: int | None = None
    seeds: int | None = None
    heads: tuple[str, ...] = ()
    pools: tuple[str, ...] = ()
    bank: Path | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.num_scenes is not None:
            check_range("trials", self.num_scenes, 1, MAX_TRIALS, 1000)
        if self.num_pairs is not None:
            check_range("num_pairs", self.num_pairs, 1, MAX_PAIRS, 5000)
        check_range("seed", self.seed, 0, MOST_SEED, 0)
        for head in self.heads:
            if head not in get_args(PlacerHead):
                known = get_args(PlacerHead)
                raise ConfigError(f"head {head!r}", ", ".join(known), meant=closest(head, known))

    @property
    def training_seeds(self) -> range:
        """Of trained placers."""
        return range(self.seeds or (1 if self.quick else _SEEDS))

    @property
    def noises(self) -> tuple[float, ...]:
        """Of the camera, that trained placers are judged with; the usual one alone if quick."""
        return NOISES[-1:] if self.quick else NOISES

    @property
    def most_pairs(self) -> int | None:
        """That a placer learns from."""
        return self.num_pairs or (_QUICK_PAIRS if self.quick else None)

    def scenes(self, full: int = _SCENES, quick: int = _QUICK_SCENES) -> int:
        """Of a test set."""
        return self.num_scenes or (quick if self.quick else full)

    def capped(self, num_pairs: int) -> int:
        """So many pairs, or as many as are allowed."""
        return min(num_pairs, self.most_pairs or num_pairs)

    def chosen(self, *heads: str) -> tuple[str, ...]:
        """The heads of a study: those that were asked for, else its own."""
        return self.heads or heads


@dataclass(frozen=True)
class SuiteFolder:
    """Where a suite's data, trained placers and rows are kept; what is there is not made again.

    Attributes:
      folder: `data/` (pairs, views, and their banks), `runs/` (trained placers), `results/` (rows of
        placers), `episodes/` (of the robot), `moments/` (of perception).
      scale: how much is to be done; num_threads: 0 takes every core; fresh: make rows again.
    """

    folder: Path
    scale: Scale = field(default_factory=Scale)
    num_threads: int = 0
    fresh: bool = False

    def test_set(
        self, asked: PlacementSet = HOUSEHOLD, num_scenes: int | None = None, **more: Any
    ) -> PairSet:
        """The queries of a set."""
        number = num_scenes or self.scale.scenes()
        return self._pairs(
            f"{asked.name}-{number}",
            pool=asked.pool,
            support=asked.support,
            camera=asked.camera,
            num_scenes=number,
            num_objects=NUM_OBJECTS,
            split="test",
            **more,
        )

    def training_set(
        self,
        name: str,
        num_scenes: int,
        num_pairs: int,
        validating: tuple[int, int] | None = None,
        **settings: Any,
    ) -> PairSet:
        """Pairs to learn from, all of them however many a placer is allowed.

        Args:
          name: of the folder, beside the number of scenes.
          validating: scenes and pairs of the split `val`; none if None.
          settings: of `placer_data`.
        """
        if self.scale.quick:
            num_scenes, num_pairs = min(num_scenes, _QUICK_PAIRS // NUM_OBJECTS), min(num_pairs, _QUICK_PAIRS)
            validating = validating and (2, 20)
        asked = {"pool": "household", **settings}
        place = f"{name}-train-{num_scenes}"
        pairs = self._pairs(place, **asked, num_scenes=num_scenes, num_pairs=num_pairs, split="train")
        if validating is None:
            return pairs
        scenes, number = validating
        return self._pairs(place, **asked, num_scenes=scenes, num_pairs=number, split="val")

    def household(self) -> PairSet:
        """5,000 pairs of 500 scenes to learn from, and 600 of 60 others to choose the epoch by."""
        return self.training_set("household", 500, 5000, VALIDATING)

    def hand_set(self, bank: Path, num_pairs: int) -> PairSet:
        """Pairs of a bank that is there."""
        place = self.folder / "data" / f"bank-{bank.name}-{self.scale.seed}"
        return placer_data(
            place, bank, num_pairs=num_pairs, seed=self.scale.seed, num_threads=self.num_threads
        )

    def _pairs(self, name: str, **settings: Any) -> PairSet:
        place, seed = self.folder / "data" / f"{name}-{self.scale.seed}", self.scale.seed
        return placer_data(place, seed=seed, num_threads=self.num_threads, **settings)

    def trained(
        self,
        name: str,
        pairs: PairSet | Sequence[PairSet],
        head: str,
        seed: int,
        num_pairs: int | None = None,
        noise: PlacerNoise = "both",
        held_out: Literal["scenes", "pairs"] = "scenes",
        encoder_weights: Path | None = None,
        num_epochs: int | None = None,
    ) -> Path:
        """A placer's run, `runs/NAME-SEED`: as `placer_train` makes it, from disk or now."""
        epochs = _QUICK_EPOCHS if self.scale.quick else num_epochs
        found, config = preset(head, "cpu", "printed", encoder_weights)
        config = config.replace_given(num_epochs=epochs, seed=seed)
        sets = (pairs,) if isinstance(pairs, PairSet) else tuple(pairs)
        source = ExampleSource(tuple(each.path for each in sets), noise, seed, num_pairs, held_out)
        run = self.folder / "runs" / f"{name}-{seed}"
        PlacerTraining(found, config, source, run).run()
        return run

    def trials(
        self, pairs: PairSet, split: str = "test", num_cameras: int = 1, tenth: int | None = None
    ) -> PlacerTrials:
        """The rows of some queries."""
        store = Store(self.folder / "results")
        return PlacerTrials(
            pairs, split, None, self.scale.seed, store, self.fresh, self.num_threads, num_cameras, tenth
        )


class Found(NamedTuple):
    """What a study found: rows as they are stored, and tables of them."""

    records: list[Row]
    tables: list[Table]


@dataclass(frozen=True)
class DownstreamStudy:
    """One question.

    Attributes:
      name: for `only` and files; title: for people.
      run: makes its rows and tables, or takes them from disk.
      needs_robot: the extras `robot` and `perception` must be there.
    """

    name: str
    title: str
    run: Callable[[SuiteFolder], Found]
    needs_robot: bool = False
