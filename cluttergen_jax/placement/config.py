"""What is asked of an episode: how many objects, how often to try, where, and what it pays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, get_args

from cluttergen_jax.config import (
    Containment,
    DoorState,
    Height,
    Order,
    Overhang,
    Poses,
    Reward,
    Seat,
)
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.placement.arrangements import parse_arrangements, roles_and_relations
from cluttergen_jax.placement.clutter import CROWDED, Clutter
from cluttergen_jax.placement.relations import (
    Relation,
    conditions_of,
    object_names,
    parse_relations,
    parse_roles,
)

if TYPE_CHECKING:
    from cluttergen_jax.schema import Record

MAX_SLOTS = 128
MOST_UNASKED = 40
"""Objects of a scene, at most, where no number is given."""
MAX_ATTEMPTS = 10
MAX_SETS = 1_000_000
MAX_MARGIN = 0.1
MIN_MARGIN = 0.003
"""Metres of support margin that what is generated has by default (`PlacementConfig.min_margin`)."""
MAX_BUDGET = 10_000
# Metres between objects that are packed, unless another is asked for; and at most.
CLEARANCE = 0.003
MAX_CLEARANCE = 0.1

RUIN_AFTER = 5
"""Failed attempts in a row after which a scene is partly taken apart, where that is done."""
RUIN_AFTER_PACKED = 2
"""Likewise, where nothing may lie on others: what finds no room side by side finds none the next time."""
ORDER_POWER = 4.0
"""Of a footprint in the weights of the order "weighted"."""
_ALWAYS_RECORDED = (
    "num_objects",
    "max_attempts",
    "containment",
    "order",
    "reward",
    "history_stride",
    "motion_cost",
    "success_reward",
)
"""These come first in every record; the others where they are not at their defaults."""
_WORDS = {
    "containment": get_args(Containment),
    "order": get_args(Order),
    "reward": get_args(Reward),
    "overhang": get_args(Overhang),
    "height": get_args(Height),
    "poses": get_args(Poses),
    "doors": get_args(DoorState),
    "seat": get_args(Seat),
}
"""What settings of words allow."""


@dataclass(frozen=True, kw_only=True)
class PlacementRequest:
    """The rules of placing that a user may ask for: fields of `SceneSpec`, where each is explained.

    What is None here is decided by method and setting; a `PlacementConfig` has it decided.
    """

    num_objects: int | None = None
    sets: int | None = None
    max_attempts: int = 5
    containment: Containment = "center"
    order: Order | None = None
    min_margin: float | None = None
    ruin_after: int | None = None
    budget: int | None = None
    overhang: Overhang = "any"
    clutter: str | Mapping[str, float] | Clutter | None = None
    natural: bool = False
    sense: str = ""
    seat: Seat = "-y"
    tidy: bool = False
    height: Height = "rest"
    poses: Poses = "upright"
    relations: Sequence[str] = ()
    relations_prefer: bool = True
    roles: str | Mapping[str, str] | tuple[tuple[str, str], ...] = ""
    arrangements: Sequence[str] = ()
    clearance: float | None = None
    crowd: float = 0.0
    doors: DoorState | None = None


@dataclass(frozen=True, kw_only=True)
class PlacementConfig(PlacementRequest):
    """One episode of the decision process (paper, section 3): the rules of a request, all decided.

    The fields that are not explained here are those of `SceneSpec`; where nothing is given they are the
    paper's. The order "weighted" draws objects one by one, each with a weight of its footprint to the power
    `ORDER_POWER` (Plackett-Luce).

    Attributes:
      roles: each name with its condition.
      reward: "paper" (its equation 1), "code" (what its published code pays) or "compressed".
      history_stride: keep every so many rows of a failed attempt's trajectory, release first; 0 remembers no
        attempt at all, which is faster for methods that never look back.
      motion_cost: c of the paper's equation 1.
      success_reward: R0 of the paper's equation 1.
      retry_last: a scene that moves in its last check is not over while attempts are left: what moved is
        taken away, with all that leans on it, and comes again.
      is_crowded: objects' boxes cover the region more than twice: many have to lie on others, and what is
        taken away is mostly what carries nothing.
      most_stacked: objects that may rest on others at most; None for any number. `packed` allows as many as
        `clutter` asks for by `stack`, unasked none.
    """

    # Decided.
    num_objects: int = 10
    order: Order = "random"
    min_margin: float = 0.0
    ruin_after: int = 0
    clutter: Clutter | None = None
    relations_prefer: bool = False
    roles: tuple[tuple[str, str], ...] = ()
    clearance: float = CLEARANCE
    # What no request asks for.
    reward: str = "paper"
    history_stride: int = 1
    motion_cost: float = 0.005
    success_reward: float = 100.0
    retry_last: bool = False
    is_crowded: bool = False
    most_stacked: int | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.num_objects <= MAX_SLOTS:
            raise ConfigError(f"num_objects = {self.num_objects}", f"1 to {MAX_SLOTS}")
        if self.sets is not None and not 1 <= self.sets <= MAX_SETS:
            raise ConfigError(f"sets = {self.sets}", f"1 to {MAX_SETS}", "sets=32")
        if self.sets is not None and self.order == "fixed":
            raise ConfigError(
                f"sets = {self.sets} with order = 'fixed', by which all scenes have the same objects",
                "another order, or no sets",
                "order='random'",
            )
        if not 1 <= self.max_attempts <= MAX_ATTEMPTS:
            raise ConfigError(f"max_attempts = {self.max_attempts}", f"1 to {MAX_ATTEMPTS}", "5")
        if not 0 <= self.history_stride <= 240:
            raise ConfigError(
                f"history_stride = {self.history_stride}", "0 to 240", "1, or 12 on a CPU"
            )
        if not (isinstance(self.min_margin, Real) and 0 <= self.min_margin <= MAX_MARGIN):
            raise ConfigError(
                f"min_margin = {self.min_margin!r}",
                f"0 to {MAX_MARGIN} m",
                f"{MIN_MARGIN}, or 0 to ask for nothing",
            )
        if not (isinstance(self.clearance, Real) and 0.001 <= self.clearance <= MAX_CLEARANCE):
            allowed = f"0.001 to {MAX_CLEARANCE} m"
            raise ConfigError(f"clearance = {self.clearance!r}", allowed, f"clearance={CLEARANCE}")
        if not 0 <= self.ruin_after <= self.max_attempts:
            raise ConfigError(
                f"ruin_after = {self.ruin_after} of {self.max_attempts} attempts an object",
                f"0 to {self.max_attempts}",
                f"{min(RUIN_AFTER, self.max_attempts)}, or 0 to take nothing away",
            )
        is_whole = isinstance(self.budget, Integral)
        if self.budget is not None and not (
            is_whole and self.num_objects <= self.budget <= MAX_BUDGET
        ):
            raise ConfigError(
                f"budget = {self.budget!r}",
                f"{self.num_objects} to {MAX_BUDGET} attempts a scene, at least one for each object",
                f"{self.max_attempts * self.num_objects}, {self.max_attempts} an object",
            )
        for name, allowed in _WORDS.items():
            value = getattr(self, name)
            if value not in allowed and not (name == "doors" and value is None):
                raise ConfigError(
                    f"{name} = {value!r}",
                    ", ".join(allowed),
                    f"{name}={allowed[0]!r}",
                    closest(value, allowed),
                )
        for name in ("natural", "tidy", "relations_prefer", "retry_last"):
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise ConfigError(f"{name} = {value!r}", "True, False", f"{name}=True")
        if self.tidy and (self.natural or self.clutter is not None):
            raise ConfigError(
                "tidy with `natural` or `clutter`, which weigh a draw",
                "one or the other",
                "tidy=False",
            )
        if self.clutter is not None:
            object.__setattr__(self, "clutter", Clutter.of(self.clutter))
        self._check_crowd()
        related = parse_relations(self.relations)
        object.__setattr__(self, "relations", tuple(map(str, related)))
        object.__setattr__(self, "roles", parse_roles(dict(self.roles)))
        arranged = parse_arrangements(self.arrangements)
        object.__setattr__(self, "arrangements", tuple(map(str, arranged)))
        names = conditions_of(self.all_roles, self.all_relations)
        if len(names) > self.num_objects:
            raise ConfigError(
                f"{len(names)} objects in relations and arrangements ({', '.join(object_names(names))}) of "
                f"scenes of {self.num_objects}",
                f"up to {self.num_objects}",
                f"num_objects={len(names)}",
            )

    def _check_crowd(self) -> None:
        if not (isinstance(self.crowd, Real) and 0 <= self.crowd <= 1) or self.crowd is True:
            raise ConfigError(f"crowd = {self.crowd!r}", "0 to 1", "crowd=0.5")
        if self.doors == "closed" and self.crowd_targets is not None:
            given = "objects drawn together (`crowd`) in furniture whose doors are closed then"
            raise ConfigError(given, "one or the other", "doors='open'")
        if not self.crowd or self.clutter is None:
            return
        targets = self.clutter.targets
        if twice := [name for name in CROWDED if name in targets]:
            given = f"crowd = {self.crowd:g} with clutter {twice[0]}={targets[twice[0]]:g}"
            raise ConfigError(given, "one or the other", f"clutter='{twice[0]}=...' alone")

    @property
    def drawn_clutter(self) -> Clutter | None:
        """The targets that the draw of a place brings about."""
        return None if self.clutter is None else self.clutter.for_draw

    @property
    def crowd_targets(self) -> tuple[float, float] | None:
        """Pairs that shall touch from the side, for each object; and the share of the objects to lean.

        None where objects stay where they were placed.
        """
        if self.crowd:
            side = min(2.0 * min(self.crowd, 0.5), (self.num_objects - 1) / 2)
            return side, 0.8 * max(self.crowd - 0.5, 0.0)
        asked = {} if self.clutter is None else self.clutter.targets
        if not any(asked.get(name) for name in CROWDED):
            return None
        return asked.get("side", 0.0), asked.get("lean", 0.0)

    @property
    def all_roles(self) -> tuple[tuple[str, str], ...]:
        """Each name with its condition, those of arrangements included."""
        return (*self.roles, *roles_and_relations(parse_arrangements(self.arrangements))[0])

    @property
    def all_relations(self) -> tuple[Relation, ...]:
        """The relations, those within arrangements included."""
        arranged = roles_and_relations(parse_arrangements(self.arrangements))[1]
        return (*parse_relations(self.relations), *arranged)

    @property
    def max_scene_attempts(self) -> int:
        """Attempts of a scene in all, at most."""
        return self.num_objects * self.max_attempts if self.budget is None else self.budget


def seat_of(rules: PlacementRequest) -> str:
    """The side of the region at which someone sits; "" where scenes are not asked to be natural."""
    return rules.seat if rules.natural else ""


def placement_record(config: PlacementConfig) -> Record:
    """The config as records keep it: most settings only where they are not at their defaults."""
    found = asdict(config)
    if config.clutter is not None:
        found["clutter"] = config.clutter.targets
    record = {name: found.pop(name) for name in _ALWAYS_RECORDED}
    usual = {each.name: each.default for each in fields(config)}
    return record | {name: value for name, value in found.items() if value != usual[name]}
