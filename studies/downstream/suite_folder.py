"""A study of the suite `downstream`: what it asks, and the folder in which its data and rows are kept."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from cluttergen_jax.config import check_range
from cluttergen_jax.downstream.fitting import FitConfig
from cluttergen_jax.downstream.perception.registration import need_gicp
from cluttergen_jax.downstream.placer.api import placer_data
from cluttergen_jax.downstream.placer.evaluate import PlacerTrials
from cluttergen_jax.downstream.placer.pairs import PairSet
from cluttergen_jax.downstream.placer.scored import head_of_name
from cluttergen_jax.downstream.placer.training import ExampleSource, PlacerTraining
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.words import MAX_PAIRS, PlacerHead, PlacerNoise, SensedFrom
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import MAX_TRIALS
from cluttergen_jax.scene.bank import read_bank
from studies.study import Scale, Study

NOISES = (0.0, 1.0)
NUM_OBJECTS = 10
_SCENES = 100
_QUICK_SCENES = 2
VALIDATING = (60, 600)
"""Scenes and pairs of the split `val` beside a training set."""
_QUICK_PAIRS = 100
_QUICK_EPOCHS = 1
MOST_SEED = 999_999
"""Of pairs, whose splits' banks have seeds in ranges of their own."""


@dataclass(frozen=True)
class PlacementSet:
    """Queries that placers are compared on: scenes of a pool on a support, one camera a query.

    Attributes:
      camera: `free` draws one for each query; see `cluttergen_jax.placer.data`.
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
class DownstreamScale(Scale):
    """How much is to be done by the suite `downstream`.

    `trials` are test scenes, ten queries and one chain each, or episodes of a robot, or moments that
    perception sees; `pools` choose among `SETS`; `seed` is also that of noise and proposals.

    Attributes:
      num_pairs: the most that a placer learns from; what each study asks for if None.
      heads: that are trained where a study asks for some; its own if empty.
      bank: made by hand, for `source`.
    """

    num_pairs: int | None = None
    heads: tuple[str, ...] = ()
    bank: Path | None = None

    def __post_init__(self) -> None:
        if self.trials is not None:
            check_range("trials", self.trials, 1, MAX_TRIALS, 1000)
        if self.num_pairs is not None:
            check_range("num_pairs", self.num_pairs, 1, MAX_PAIRS, 5000)
        check_range("seed", self.seed, 0, MOST_SEED, 0)
        known = get_args(PlacerHead)
        pools = list(dict.fromkeys(one.pool for one in SETS))
        for name in self.pools:
            if name not in pools:
                raise ConfigError(
                    f"pools = {name!r} with suite 'downstream'",
                    ", ".join(pools),
                    meant=closest(name, pools),
                )
        if self.bank is not None:
            read_bank(self.bank)
        for head in self.heads:
            if head not in known:
                raise ConfigError(f"head {head!r}", ", ".join(known), meant=closest(head, known))

    @property
    def noises(self) -> tuple[float, ...]:
        """Of the camera, that trained placers are judged with; the usual one alone if quick."""
        return NOISES[-1:] if self.quick else NOISES

    @property
    def most_pairs(self) -> int | None:
        """That a placer learns from."""
        return self.num_pairs or (_QUICK_PAIRS if self.quick else None)

    def pairs(self, number: int) -> int:
        """So many pairs, or as many as are allowed."""
        return min(number, self.most_pairs or number)

    def heads_or(self, *default: str) -> tuple[str, ...]:
        """The heads that were asked for, else a study's own."""
        return self.heads or default

    def sets(self, *some: PlacementSet) -> list[PlacementSet]:
        """Those of some sets whose pools were asked for; the first alone if quick."""
        return [one for one in some if one.pool in self.pools_or(one.pool)][
            : 1 if self.quick else None
        ]


def need_extras(studies: Iterable[Study]) -> None:
    """MissingExtraError if one of some studies needs a robot or perception without their extras."""
    if any(study.needs_robot for study in studies):
        find_robot()
        need_gicp()


@dataclass(frozen=True)
class SuiteFolder:
    """Where a suite's data, trained placers and rows are kept; what is there is not made again.

    Attributes:
      folder: `data/` (pairs, views, and their banks), `runs/` (trained placers), `results/` (rows of
        placers), `episodes/` (of the robot), `moments/` (of perception).
      scale: how much is to be done; num_threads: 0 takes every core; fresh: make rows again.
    """

    folder: Path
    scale: DownstreamScale = field(default_factory=DownstreamScale)
    num_threads: int = 0
    fresh: bool = False

    def test_set(
        self, asked: PlacementSet = HOUSEHOLD, num_scenes: int | None = None, **more: Any
    ) -> PairSet:
        """The queries of a set."""
        number = num_scenes or self.scale.number(_SCENES, _QUICK_SCENES)
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
            num_scenes = min(num_scenes, _QUICK_PAIRS // NUM_OBJECTS)
            num_pairs = min(num_pairs, _QUICK_PAIRS)
            validating = validating and (2, 20)
        asked = {"pool": "household", **settings}
        place = f"{name}-train-{num_scenes}"
        pairs = self._pairs(
            place, **asked, num_scenes=num_scenes, num_pairs=num_pairs, split="train"
        )
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
        place = self.folder / "data" / f"{name}-{self.scale.seed}"
        seed = self.scale.seed
        return placer_data(place, seed=seed, num_threads=self.num_threads, **settings)

    def train(
        self,
        name: str,
        pairs: PairSet | Sequence[PairSet],
        head: str,
        num_pairs: int | None = None,
        noise: PlacerNoise = "both",
        held_out: Literal["scenes", "pairs"] = "scenes",
        num_epochs: int | None = None,
    ) -> dict[int, Path]:
        """Placers by training seed, `runs/NAME-SEED`: as `placer_train` makes them, from disk or now."""
        sets = (pairs,) if isinstance(pairs, PairSet) else tuple(pairs)
        runs = {}
        for seed in self.scale.training_seeds:
            found = head_of_name(head)
            epochs = _QUICK_EPOCHS if self.scale.quick else num_epochs
            config = FitConfig().replace_given(num_epochs=epochs, seed=seed)
            source = ExampleSource(
                tuple(each.path for each in sets), noise, seed, num_pairs, held_out
            )
            runs[seed] = self.folder / "runs" / f"{name}-{seed}"
            PlacerTraining(found, config, source, runs[seed]).run()
        return runs

    def trials(
        self, pairs: PairSet, split: str = "test", num_cameras: int = 1, tenth: int | None = None
    ) -> PlacerTrials:
        """The rows of some queries."""
        store = Store(self.folder / "results")
        return PlacerTrials(
            pairs,
            split,
            None,
            self.scale.seed,
            store,
            self.fresh,
            self.num_threads,
            num_cameras,
            tenth,
        )
