"""Training of a head: examples prepared once out of pairs, gradient steps, calibration, a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from cluttergen_jax.downstream.digests import json_digest
from cluttergen_jax.downstream.fitting import (
    FitConfig,
    FitRun,
    FitState,
    concatenate,
    in_parts,
    num_examples,
)
from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.downstream.placer.pairs import (
    PairFilter,
    PairLabels,
    PairSet,
    load_queries,
    of_tenths,
    read_pairs,
)
from cluttergen_jax.downstream.placer.query import Example, PlacementQuery, pad_map
from cluttergen_jax.downstream.placer.scored import KIND, ScoredHead
from cluttergen_jax.downstream.words import PlacerNoise
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning import Calibration, calibration, draw_calibration
from cluttergen_jax.physics import Verdict
from cluttergen_jax.placement import UnderSide
from cluttergen_jax.progress import Progress

_TENTH = 10
# The last digits of pairs that the paper's protocol tests and validates with; where there is no validation
# split, scenes whose numbers end in the latter are one.
TESTING = 8
VALIDATING = 9

_SAME = 1e-6
_NOISES = {"on": (REALSENSE,), "off": (NOISE_OFF,), "both": (NOISE_OFF, REALSENSE)}
"""Of odd pairs the candidates were drawn on noisy maps."""


@dataclass(frozen=True)
class ExampleSource:
    """Where examples come from.

    Attributes:
      data: folders that `placer data` made.
      noise: of the camera: "on", "off", or "both": every other pair is seen with noise.
      seed: of the noise.
      num_pairs: of each folder's training split, the first so many; all if None.
      held_out: what validates: "scenes" of their own (the split `val`, else every tenth of the training
        split's), or "pairs", as the paper has it: every tenth pair, and every tenth is left out to test with,
        so that all three are of the same scenes.
    """

    data: tuple[Path, ...]
    noise: PlacerNoise = "both"
    seed: int = 0
    num_pairs: int | None = None
    held_out: Literal["scenes", "pairs"] = "scenes"

    @cached_property
    def sets(self) -> tuple[PairSet, ...]:
        """The folders, opened."""
        return tuple(read_pairs(path) for path in self.data)

    @property
    def record(self) -> dict[str, object]:
        """What decides the examples: JSON values."""
        return {
            "pairs": [_digest(each) for each in self.sets],
            "noise": self.noise,
            "seed": self.seed,
            "num_pairs": self.num_pairs,
            "held_out": self.held_out,
        }

    def load(self, split: Literal["train", "val"]) -> Example:
        """All examples of a split, NumPy arrays with a leading axis.

        Raises:
          ConfigError: there are none, or the folders' maps have cells of different sizes.
          BankError: a folder holds no pairs, or damaged ones.
        """
        parts = [part for pairs in self.sets if (part := self._load(pairs, split)) is not None]
        if not parts:
            raise ConfigError(
                f"no pairs to {'learn from' if split == 'train' else 'validate with'} in "
                f"{', '.join(str(path) for path in self.data)}",
                "pairs of ten scenes or more",
                f"cluttergen placer data --split {split}",
            )
        return concatenate_examples(parts)

    def _load(self, pairs: PairSet, split: Literal["train", "val"]) -> Example | None:
        """The examples of one folder; None where it has none of the split."""
        source = "train"
        number = self.num_pairs
        wanted = self._filter_of(pairs, split)
        if wanted is None and split == "val":
            source = "val"
            number = None
        held = pairs.num_samples(source, number)
        if wanted is not None and not any(
            wanted(table).any() for table in pairs.tables(source, held)
        ):
            return None
        return examples_of(
            *load_queries(pairs, _NOISES[self.noise], self.seed, source, number, wanted=wanted)
        )

    def _filter_of(self, pairs: PairSet, split: Literal["train", "val"]) -> PairFilter | None:
        """Which pairs of the training split are of a part of it; None where all are."""
        if self.held_out == "pairs":
            return of_tenths(VALIDATING) if split == "val" else of_tenths(*range(TESTING))
        if "val" in pairs.splits:
            return None
        return lambda table: (np.asarray(table["scene"]) % _TENTH == VALIDATING) == (split == "val")


def _digest(pairs: PairSet) -> str:
    """Equal for equal examples: a test split may come later."""
    told = [
        pairs.record["assets"],
        *(pairs.record["splits"].get(name) for name in ("train", "val")),
    ]
    return json_digest(told, 20)


def examples_of(queries: PlacementQuery, labels: PairLabels) -> Example:
    """The examples of pairs, as `pairs.load_queries` gives them."""
    w = labels.target[:, 3]
    z = labels.target[:, 6]
    target = np.column_stack([labels.target[:, :3], 2 * np.arctan2(z, w)]).astype(np.float32)
    return Example(queries, target, labels.candidate, labels.verdict)


def concatenate_examples(parts: Sequence[Example]) -> Example:
    """Examples of several worlds as one, their maps and columns padded to one size.

    Raises:
      ConfigError: the maps have cells of different sizes.
    """
    if len(parts) == 1:
        return parts[0]
    cells = [part.query.heights.cell for part in parts]
    if np.ptp(np.array(cells), axis=0).max() > _SAME:
        raise ConfigError(
            f"pairs with cells of {cells} m", "cells of one size", "one folder at a time"
        )
    shapes = np.array([part.query.heights.height.shape[1:] for part in parts]).max(0)
    columns = max(part.query.under.is_column.shape[1] for part in parts)
    same = [
        _pad_examples(part, (int(shapes[0]), int(shapes[1])), columns, cells[0]) for part in parts
    ]
    return concatenate(same)


def _pad_examples(
    examples: Example, shape: tuple[int, int], num_columns: int, cell: tuple[float, float]
) -> Example:
    query = examples.query
    maps = {
        name: each.replace(height=pad_map(each.height, shape), cell=cell)
        for name, each in (("heights", query.heights), ("ceilings", query.ceilings))
    }
    under = query.under
    more = num_columns - under.is_column.shape[1]
    wider = UnderSide(
        xy=np.pad(under.xy, [(0, 0), (0, more), (0, 0)]),
        bottom=np.pad(under.bottom, [(0, 0), (0, more)]),
        is_column=np.pad(under.is_column, [(0, 0), (0, more)]),
        center_of_mass=under.center_of_mass,
    )
    return examples.replace(query=query.replace(**maps, under=wider))


_TEMPERATURES = np.exp(np.linspace(np.log(0.25), np.log(4.0), 129))


def best_temperature(logits: np.ndarray, label: np.ndarray) -> float:
    """By which logits f32[N] are divided so that their chances fit labels bool[N] best (least surprise)."""
    signed = np.where(label, 1.0, -1.0) * logits.astype(np.float64)
    surprise = [np.logaddexp(0.0, -signed / each).mean() for each in _TEMPERATURES]
    return float(_TEMPERATURES[int(np.argmin(surprise))])


_AT_ONCE = 32
"""Pairs that are prepared by one compiled call."""

# Heads are values: equal ones share what is compiled.
_prepare: Any = jax.jit(lambda head, examples: jax.vmap(head.prepare)(examples), static_argnums=0)


class PlacerTraining(FitRun):
    """A run that fits a placer's head; see `FitRun`. The checkpoint is in `placer/`.

    Args:
      head, config: what is fitted, and how.
      source: of the examples.
      folder, show: see `FitRun`.

    Raises:
      ConfigError: the folder holds a run with other settings.
    """

    kind = KIND
    unit = "pair"

    def __init__(
        self,
        head: ScoredHead,
        config: FitConfig,
        source: ExampleSource,
        folder: Path,
        show: Callable[[str], None] = print,
    ) -> None:
        self.head = head
        self.source = source
        recipe = {"head": head.kind, "data": source.record}
        super().__init__(head, config, recipe, folder, show)

    def examples(self, split: Any) -> Any:
        examples = self.source.load(split)
        parts = []
        with Progress(f"preparing {split}", num_examples(examples), "pair") as progress:
            for part in in_parts(partial(_prepare, self.head), examples, _AT_ONCE):
                parts.append(part)
                progress.update(num_examples(part))
        return concatenate(parts)

    def save(self, state: FitState, held_out: Any) -> Path:
        temperature, found = self._calibrate(state.best, held_out)
        self._show(f"validation {found}")
        picture = self.folder / self.kind / "calibration.png"
        picture.parent.mkdir(parents=True, exist_ok=True)
        draw_calibration({"stands": found}, picture, "poses of the validation split")
        # Last: a folder with a record is a run that is done.
        return self.store(state, {"calibration": asdict(found)}, temperature=temperature)

    def _calibrate(self, params: Any, held_out: Any) -> tuple[float, Calibration]:
        """The temperature of the head's chances, and how far they then hold."""
        score = jax.jit(self.head.scores)
        parts = [np.asarray(score(params, part)) for part in self.batches_of(held_out)]
        logits = np.concatenate(parts).ravel()
        stood = (held_out.verdict == int(Verdict.STABLE)).ravel()
        temperature = best_temperature(logits, stood)
        return temperature, calibration(logits / temperature, stood, held_out.is_on.ravel())
