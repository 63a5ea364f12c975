"""A trial, what one row of a table asks: a request of scenes, how many of them, and the seeds."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import public_name
from cluttergen_jax.assets.support import Rectangle, recorded_rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.methods.table import METHODS, TARGETS, entry_of
from cluttergen_jax.placement.region import find_change
from cluttergen_jax.spec import SceneSpec

MAX_TRIALS = 1_000_000
# Of rows whose rules are not their method's own.
RUIN = "ruin"
RANDOM_ORDER = "random order"
TIDY = "tidy"
ROBUST = "robust"
FREE_HEIGHT = "free height"

_PAPERS = SceneSpec(method="random", num_objects=10, setting="paper")
_PLACE = (
    "objects",
    "shelf",
    "weights",
    "theme",
    "graspable",
    "balance",
    "surface",
    "keep_out",
    "start",
)
"""Fields of a request that say what is placed where."""
_RULES = (
    "natural",
    "sense",
    "seat",
    "relations",
    "roles",
    "arrangements",
    "overhang",
    "containment",
    "for_engine",
    "clearance",
    "crowd",
)
"""Fields that say by which rules, beside those that every row has."""
_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
_SIDES = re.compile(f"{_NUMBER}x{_NUMBER}")
_MOST_TOLD = 40
"""Letters of a value in a row's name."""


@dataclass(frozen=True)
class Trial:
    """One row.

    Attributes:
      spec: what is asked for, by rules that are all decided; those of the paper unless given (`Trial.of`).
        The runner has the engine, its threads and the checkpoints: here they are at their defaults.
      trials: scenes.
      seed: of the scenes; training_seed: of the checkpoint, for learned methods.
      change: how the region is changed at random in every episode (`changes.REGION_CHANGES`).
      whole_attempts: run attempts to step 240 even when they can no longer succeed, so that stable steps are
        counted as the paper counts them. Verdicts are the same.
      paper_count: run it a second time with the paper's looser count (only the current object is judged, the
        others are put back by hand, no last check).
      other_method: of a stored row, the name of a method that is not at hand, a user's own or one of an
        earlier version; "" for none.
    """

    spec: SceneSpec = _PAPERS
    trials: int = 1000
    seed: int = 0
    training_seed: int = 0
    change: str = "none"
    whole_attempts: bool = False
    paper_count: bool = False
    other_method: str = ""

    def __post_init__(self) -> None:
        if not 1 <= self.trials <= MAX_TRIALS:
            raise ConfigError(f"trials = {self.trials}", f"1 to {MAX_TRIALS}", "trials=1000")
        if not 0 <= self.seed < 2**32:
            raise ConfigError(f"seed = {self.seed}", "0 to 4294967295")
        find_change(self.change)
        method = self.spec.method
        assert isinstance(method, str), "a trial is of a method"
        spec = self.spec.with_rules(method)
        decided = replace(
            spec,
            pool=spec.pool_text,
            exclude=(),
            checkpoint=None,
            engine="auto",
            num_threads=0,
        )
        object.__setattr__(self, "spec", decided)

    @staticmethod
    def of(**changes: Any) -> Trial:
        """Ten objects by the paper's rules, with some fields of its own or of the request replaced."""
        return Trial().replace(**changes)

    def replace(self, **changes: Any) -> Trial:
        """The trial with some fields, its own or those of its request, replaced."""
        own = {name: changes.pop(name) for name in _OWN if name in changes}
        return replace(self, spec=replace(self.spec, **changes), **own)

    @property
    def pool(self) -> str:
        """Its name or folder."""
        return str(self.spec.pool)

    @property
    def support(self) -> str:
        """Its name or folder."""
        return str(self.spec.support)

    @property
    def method(self) -> str:
        """Its name; of a user's own that is at hand, the `OwnMethod`, which is a name."""
        method = self.spec.method
        assert isinstance(method, str), "a trial is of a method"
        return self.other_method or method

    @property
    def num_objects(self) -> int:
        """Of a scene."""
        assert self.spec.num_objects is not None, "a trial is of so many objects"
        return self.spec.num_objects

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

    def fields(self) -> dict[str, Any]:
        """All of it as plain JSON, by the names of rows, which `trial_of` reads.

        Fields that few rows ask for (`_PLACE`, `_RULES`) are there where they are given.
        """
        spec = self.spec
        usual = {
            "pool": self.pool,
            "support": self.support,
            "method": str(self.method),
            "num_objects": self.num_objects,
            "attempts": spec.max_attempts,
            "trials": self.trials,
            "seed": self.seed,
            "training_seed": self.training_seed,
            "region": _plain_region(spec.region),
            "change": self.change,
            "repeat": spec.repeat,
            "whole_attempts": self.whole_attempts,
            "paper_count": self.paper_count,
            "min_margin": spec.min_margin,
            "order": spec.order,
            "ruin_after": spec.ruin_after,
            "budget": spec.budget,
            "robust": spec.robust,
            "both_detectors": spec.setting != "paper",
            "clutter": _plain_clutter(spec.clutter),
            "tidy": spec.tidy,
            "height": spec.height,
            "poses": spec.poses,
            "stability": str(spec.stability or ""),
        }
        given = {
            name: getattr(spec, name) for name in (*_PLACE, *_RULES) if name in spec.overrides()
        }
        if spec.relations and spec.relations_prefer:
            given["relations_prefer"] = True
        if spec.setting != "paper":
            # Rows of before are of scenes of which every attempt was simulated.
            given["decide_alone"] = True
        if spec.keep_out:
            given["keep_out"] = [_plain_box(box) for box in spec.keep_out]
        return usual | given

    def record(self) -> dict[str, Any]:
        """Its fields for results that others read."""
        return self.fields() | {"pool": self.pool_name, "support": self.support_name}

    @property
    def row_name(self) -> str:
        """What tables call its row: its method, and what sets its rules apart from that method's own."""
        spec = self.spec
        entry = entry_of(self.method)
        is_ruined = bool(spec.ruin_after)
        takes_away = entry.is_ordered and not entry.is_whole
        own, other = ("weighted", "random") if entry.is_ordered else ("random", "weighted")
        if is_ruined != takes_away and spec.order == other:
            words = [RUIN if is_ruined else RANDOM_ORDER]
        else:
            words = [f"order {spec.order}"] if spec.order != own else []
            words += [f"ruin after {spec.ruin_after}"] if is_ruined != takes_away else []
        return ", ".join([self.method, *words, *self._extra_rules])

    @property
    def _extra_rules(self) -> list[str]:
        spec = self.spec
        named = {TIDY: spec.tidy, FREE_HEIGHT: spec.height == "free", ROBUST: spec.robust}
        words = [name for name, is_asked in named.items() if is_asked]
        words += [str(spec.clutter)] if spec.clutter is not None else []
        words += [str(spec.stability)] if spec.stability else []
        words += [f"{spec.poses} poses"] if spec.poses != "upright" else []
        return words + self._tell(_RULES)

    @property
    def asked(self) -> list[str]:
        """What is placed where, beside pool and support: each field that is given, with its value."""
        return self._tell((*_PLACE, "region"))

    def _tell(self, names: tuple[str, ...]) -> list[str]:
        given = self.spec.overrides()
        return [_text_of(name, given[name]) for name in names if name in given]  # type: ignore[literal-required]

    @property
    def title(self) -> str:
        """For progress and file names."""
        spec = self.spec
        words = [self.pool_name, self.support_name, self.method]
        words += [f"seed {self.training_seed}"] if self.training_seed else []
        words += [self.change] if self.change != "none" else []
        words += [f"margin {1000 * spec.min_margin:g} mm"] if spec.min_margin else []
        words += self._extra_rules
        words += self._tell(_PLACE)
        words += [spec.order] if spec.order and spec.order != "random" else []
        words += [f"ruin after {spec.ruin_after}"] if spec.ruin_after else []
        words += [f"budget {spec.budget}"] if spec.budget else []
        return " ".join([*words, f"{self.num_objects} objects", f"{spec.max_attempts} attempts"])


_OWN = tuple(field.name for field in fields(Trial) if field.name != "spec")


def _plain_clutter(clutter: Any) -> str:
    """As text that gives the same numbers back."""
    targets = {} if clutter is None else clutter.targets
    words = []
    for name, value in targets.items():
        short = f"{value:g}"
        words.append(f"{name}={short if float(short) == value else repr(value)}")
    return ",".join(words)


def _plain_box(box: Rectangle | str) -> Any:
    return box if isinstance(box, str) else asdict(box)


def _plain_region(region: Rectangle | str | None) -> Any:
    """As rows have always had it: its sides, where it lies at the middle of the support's own."""
    if isinstance(region, str) and _SIDES.fullmatch(region):
        return [float(side) for side in region.split("x")]
    return None if region is None else _plain_box(region)


def _text_of(name: str, value: Any) -> str:
    """A field and its value in a row's name; of a long value the beginning."""
    words = name.replace("_", " ").removesuffix(" engine")
    if value is True:
        return words
    text = ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return f"{words} {text if len(text) <= _MOST_TOLD else text[: _MOST_TOLD - 3] + '...'}"


def trial_of(row: Mapping[str, Any]) -> Trial:
    """The trial of a stored row; settings that an older version did not know are the usual ones."""
    asked = dict(row["trial"])
    if asked.get("method", "random") not in METHODS:
        asked["other_method"] = asked.pop("method")
        # One that takes what was asked stands in its place.
        asked["method"] = "spread" if any(asked.get(name) for name in TARGETS) else "random"
    region = asked.get("region")
    if isinstance(region, Mapping):
        asked["region"] = recorded_rectangle(region)
    elif region is not None and not isinstance(region, str):
        asked["region"] = "x".join(repr(float(side)) for side in region)
    asked["keep_out"] = tuple(
        box if isinstance(box, str) else recorded_rectangle(box)
        for box in asked.get("keep_out", ())
    )
    asked["max_attempts"] = asked.pop("attempts", SceneSpec.max_attempts)
    asked["setting"] = "default" if asked.pop("both_detectors", False) else "paper"
    asked.pop("decide_alone", None)
    # Rows of relations of earlier versions preferred nothing.
    asked.setdefault("relations_prefer", not asked.get("relations"))
    asked["clutter"] = asked.get("clutter") or None
    asked["stability"] = asked.get("stability") or None
    return Trial.of(**asked)


def key_of(trial: Trial, sources: dict[str, Any]) -> str:
    """A result's name: equal for equal questions about equal content, wherever it lies.

    Args:
      sources: hashes of what the trial names (pool, support, checkpoint) and versions.
    """
    asked = trial.fields()
    # Pools and supports are told by their hashes.
    told = {name: value for name, value in asked.items() if name not in ("pool", "support")}
    text = json.dumps({"trial": told, "sources": sources}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def grid(base: Trial, **values: Iterable[Any]) -> tuple[Trial, ...]:
    """The trial with every combination of the given fields' values; the last field's vary fastest."""
    return tuple(
        base.replace(**dict(zip(values, each, strict=True))) for each in product(*values.values())
    )
