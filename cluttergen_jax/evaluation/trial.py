"""A trial, what one row of a table asks: a method, objects on a support, judged how, and how often."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.table import entry_of
from cluttergen_jax.placement.region import find_change
from cluttergen_jax.spec import SceneSpec

MAX_TRIALS = 1_000_000
# Of rows whose rules are not their method's own.
RUIN = "ruin"
RANDOM_ORDER = "random order"
TIDY = "tidy"
ROBUST = "robust"
FREE_HEIGHT = "free height"


@dataclass(frozen=True)
class Trial:
    """One row.

    Attributes:
      pool, support: names or folders.
      method: a name of `placement.methods.table.METHODS`, or a user's own (`OwnMethod`).
      num_objects: objects per scene; attempts: per object.
      trials: scenes.
      seed: of the scenes; training_seed: of the checkpoint, for learned methods.
      region: the sides of the queried region in metres, at the middle of the support's own; None takes that.
      change: how the region is changed at random in every episode (`changes.REGION_CHANGES`).
      repeat: allow duplicates: an object may be placed more than once.
      whole_attempts: run attempts to step 240 even when they can no longer succeed, so that stable steps are
        counted as the paper counts them. Verdicts are the same.
      paper_count: run it a second time with the paper's looser count (only the current object is judged, the
        others are put back by hand, no last check).
      min_margin: metres of support margin asked of what is placed; 0 asks for nothing, as the paper does.
      robust: ask that what stands also stands under a slight tilt with less friction and softer contacts.
      both_detectors: the last check asks both of MuJoCo's detectors of convex collisions, as `generate` does;
        without, the native one alone (`config.DETECTORS`).
      clutter: what scenes should have on average, as text ("stack=3"); "" asks for nothing.
      tidy: take the best of the poses that are trusted, as `--tidy` does.
      height: at which `random` lets go, "rest" or "free" (`PlacementConfig`).
      poses: in which objects are released, "upright", "resting" or "any".
      stability: limits of "stable" that are not the usual ones (`config.stability_text`); "" if all are.
      order, ruin_after, budget: of a `PlacementConfig`; the paper's unless given.
    """

    pool: str = "dining"
    support: str = "table"
    method: str = "random"
    num_objects: int = 10
    attempts: int = 5
    trials: int = 1000
    seed: int = 0
    training_seed: int = 0
    region: tuple[float, float] | None = None
    change: str = "none"
    repeat: bool = False
    whole_attempts: bool = False
    paper_count: bool = False
    min_margin: float = 0.0
    order: str = "random"
    ruin_after: int = 0
    budget: int | None = None
    robust: bool = False
    both_detectors: bool = False
    clutter: str = ""
    tidy: bool = False
    height: str = "rest"
    poses: str = "upright"
    stability: str = ""

    def __post_init__(self) -> None:
        if not 1 <= self.trials <= MAX_TRIALS:
            raise ConfigError(f"trials = {self.trials}", f"1 to {MAX_TRIALS}", "trials=1000")
        if not 0 <= self.seed < 2**32:
            raise ConfigError(f"seed = {self.seed}", "0 to 4294967295")
        find_change(self.change)
        _ = self.placement

    @property
    def placement(self) -> PlacementConfig:
        """The rules of its scenes.

        Raises:
          ConfigError: there are no such rules.
        """
        return PlacementConfig(
            num_objects=self.num_objects,
            max_attempts=self.attempts,
            order=self.order,
            min_margin=self.min_margin,
            ruin_after=self.ruin_after,
            budget=self.budget,
            clutter=Clutter.of(self.clutter) if self.clutter else None,
            tidy=self.tidy,
            height=self.height,
            poses=self.poses,
        )

    @property
    def num_episodes(self) -> int:
        """Scenes to be made, both counts together."""
        return self.trials * (2 if self.paper_count else 1)

    @property
    def pool_name(self) -> str:
        """Without its folder, which a table does not show."""
        return public_name(self.pool)

    @property
    def support_name(self) -> str:
        """Likewise."""
        return Path(self.support).name

    def record(self) -> dict[str, Any]:
        """Its fields for results that others read."""
        plain = {"pool": self.pool_name, "support": self.support_name, "method": str(self.method)}
        return asdict(self) | plain

    @property
    def row_name(self) -> str:
        """What tables call its row: its method, and what sets its rules apart from that method's own."""
        is_trusted = entry_of(self.method).is_trusted
        is_ruined = self.ruin_after > 0
        own, other = ("weighted", "random") if is_trusted else ("random", "weighted")
        if is_ruined != is_trusted and self.order == other:
            words = [RUIN if is_ruined else RANDOM_ORDER]
        else:
            words = [f"order {self.order}"] if self.order != own else []
            words += [f"ruin after {self.ruin_after}"] if is_ruined != is_trusted else []
        return ", ".join([self.method, *words, *self._extra_rules])

    @property
    def _extra_rules(self) -> list[str]:
        named = {TIDY: self.tidy, FREE_HEIGHT: self.height == "free", ROBUST: self.robust}
        words = [name for name, is_asked in named.items() if is_asked] + [self.clutter] * bool(
            self.clutter
        )
        words += [self.stability] if self.stability else []
        return words + ([f"{self.poses} poses"] if self.poses != "upright" else [])

    @property
    def title(self) -> str:
        """For progress and file names."""
        words = [self.pool_name, self.support_name, self.method]
        words += [f"seed {self.training_seed}"] if self.training_seed else []
        words += [self.change] if self.change != "none" else []
        words += [f"margin {1000 * self.min_margin:g} mm"] if self.min_margin else []
        words += self._extra_rules
        words += [self.order] if self.order != "random" else []
        words += [f"ruin after {self.ruin_after}"] if self.ruin_after else []
        words += [f"budget {self.budget}"] if self.budget else []
        return " ".join([*words, f"{self.num_objects} objects", f"{self.attempts} attempts"])


def trial_of(row: Mapping[str, Any]) -> Trial:
    """The trial of a stored row; settings that an older version did not know are the usual ones."""
    return Trial(**row["trial"])


def key_of(trial: Trial, sources: dict[str, Any]) -> str:
    """A result's name: equal for equal questions about equal content, wherever it lies.

    Args:
      sources: hashes of what the trial names (pool, support, checkpoint) and versions.
    """
    names = [field.name for field in fields(Trial)]
    usual = Trial()
    later = names[names.index("min_margin") :]
    # Pools and supports by their hashes; the later settings only where they are not the usual ones.
    left_out = {
        "pool",
        "support",
        *(name for name in later if getattr(trial, name) == getattr(usual, name)),
    }
    asked = {name: value for name, value in asdict(trial).items() if name not in left_out}
    text = json.dumps({"trial": asked, "sources": sources}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def grid(base: Trial, **values: Iterable[Any]) -> tuple[Trial, ...]:
    """The trial with every combination of the given fields' values; the last field's vary fastest."""
    return tuple(
        replace(base, **dict(zip(values, each, strict=True))) for each in product(*values.values())
    )


def with_rules_of(trial: Trial, spec: SceneSpec) -> Trial:
    """The trial by the rules of a request, the method's own where it gives none."""
    decided = spec.with_rules(trial.method)
    return replace(
        trial,
        order=decided.order or trial.order,
        ruin_after=decided.ruin_after or 0,
        budget=decided.budget,
        min_margin=decided.min_margin or 0.0,
        height=spec.height if "height" in entry_of(trial.method).takes else "rest",
        poses=spec.poses,
        stability=str(spec.stability or ""),
    )
