"""What scenes are asked for: one frozen dataclass with every default and every check of a value."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, cast, get_args

from cluttergen_jax.config import (
    PILE_NOSLIP,
    ROBUST_TILT,
    UNPROPOSED,
    Balance,
    ContactConfig,
    Containment,
    DoorState,
    Engine,
    Height,
    Method,
    Order,
    OtherEngine,
    Overhang,
    Poses,
    Seat,
    Setting,
    StabilityConfig,
    check_engine,
    check_names,
    check_whole,
    check_workers,
    no_such,
    stability_of,
    stability_text,
)
from cluttergen_jax.errors import ConfigError, closest, range_text
from cluttergen_jax.placement.arrangements import parse_arrangements
from cluttergen_jax.placement.clutter import CROWDED, Clutter
from cluttergen_jax.placement.config import (
    MAX_SLOTS,
    MIN_MARGIN,
    MOST_UNASKED,
    RUIN_AFTER,
    RUIN_AFTER_PACKED,
    PlacementConfig,
    PlacementRequest,
)
from cluttergen_jax.placement.methods.table import (
    TARGETS,
    TRUSTED,
    OwnMethod,
    entry_of,
    find_method,
    takers,
)
from cluttergen_jax.placement.relations import (
    conditions_of,
    is_any_inside,
    parse_relations,
    parse_roles,
)

# What reads assets is imported where it is needed: this module is all that a command's `--help` loads.
if TYPE_CHECKING:
    from cluttergen_jax.assets.facts import ObjectFacts
    from cluttergen_jax.assets.pool import Pool
    from cluttergen_jax.assets.support import Rectangle, Ring
    from cluttergen_jax.placement.methods.table import MethodEntry
    from cluttergen_jax.placement.problem import ProblemConfig
    from cluttergen_jax.placement.rules import Proposer, Rules

    OwnProposer = Proposer | Callable[[Rules], Proposer]

SHELF = 64
MOST_ON_SHELF = 200
MANY = 40
"""Objects; scenes of more are not over when they fail their last check (`PlacementConfig.retry_last`)."""
MARGIN_FOR: dict[OtherEngine, float] = {"drake": 0.02, "pybullet": 0.01, "isaac": 0.01}
"""Metres of `min_margin` that another engine asks for (reports/measured.md); Isaac's was not measured."""
_MORE_PACKED = 2
"""Times as many attempts in all as other methods have, where nothing may lie on others."""
SETTINGS = get_args(Setting)
BALANCES = get_args(Balance)
F = TypeVar("F", bound=Callable[..., Any])


class ObjectOptions(TypedDict, total=False):
    """Of a `SceneSpec`: which objects, and how many."""

    pool: str | Path
    objects: Sequence[str]
    exclude: Sequence[str]
    num_objects: int | None
    sets: int | None
    repeat: bool
    shelf: int | None
    weights: str | Mapping[str, float]
    theme: str
    graspable: str | Path
    balance: Balance


class PlaceOptions(TypedDict, total=False):
    """Of a `SceneSpec`: on what, and where on it."""

    support: str | Path
    surface: str
    region: Rectangle | str | None
    keep_out: Sequence[Rectangle | str]
    start: str | None
    containment: Containment


class RuleOptions(TypedDict, total=False):
    """Of a `SceneSpec`: by which rules, and by which method."""

    order: Order | None
    min_margin: float | None
    robust: bool
    stability: str | Mapping[str, float | str] | StabilityConfig | None
    for_engine: OtherEngine | None
    setting: Setting
    overhang: Overhang
    clutter: str | Mapping[str, float] | None
    natural: bool
    sense: str
    seat: Seat
    tidy: bool
    height: Height
    poses: Poses
    relations: Sequence[str]
    relations_prefer: bool
    roles: str | Mapping[str, str]
    arrangements: Sequence[str]
    clearance: float | None
    crowd: float
    doors: DoorState | None
    method: Method | OwnProposer | str | None
    checkpoint: str | Path | None


class NumberOptions(TypedDict, total=False):
    """Of a `SceneSpec`: how often it is tried."""

    max_attempts: int
    ruin_after: int | None
    budget: int | None


class MachineOptions(TypedDict, total=False):
    """Of a `SceneSpec`: on what it is computed."""

    engine: Engine
    num_threads: int


class SceneOptions(
    ObjectOptions, PlaceOptions, RuleOptions, NumberOptions, MachineOptions, total=False
):
    """The fields of a `SceneSpec`, as keywords of the functions that take them."""


OPTION_GROUPS = {
    "everyday": "",
    "what": "What is used, and what is made of it.",
    "where": "On which support, in which region, seen from where.",
    "how": "By which rules and methods.",
    "how_many": "Numbers, limits and seeds.",
    "files": "What is written, and where to.",
    "machine": "Engines, processes, addresses.",
}
"""The groups in which the help of a command shows its options, in their order, and what each says."""
GROUP_OF = {
    name: group
    for group, kind in (
        ("what", ObjectOptions),
        ("where", PlaceOptions),
        ("how", RuleOptions),
        ("how_many", NumberOptions),
        ("machine", MachineOptions),
    )
    for name in kind.__annotations__
}
"""The group of each field of a request."""


def in_groups(
    what: str = "", where: str = "", how_many: str = "", files: str = "", machine: str = ""
) -> Callable[[F], F]:
    """A decorator that puts the arguments of a function into groups of its command's help.

    Args:
      what, where, how_many, files, machine: names of arguments, with spaces between. Those of a request are
        in groups already (`GROUP_OF`); any other is in the group "how".
    """
    named = {"what": what, "where": where, "how_many": how_many, "files": files, "machine": machine}
    groups = {name: group for group, names in named.items() for name in names.split()}

    def decorate(function: F) -> F:
        known = inspect.signature(function).parameters
        if unknown := groups.keys() - known.keys():
            raise TypeError(f"{function.__name__} has no arguments {', '.join(sorted(unknown))}")
        function.option_groups = groups  # type: ignore[attr-defined]
        return function

    return decorate


@dataclass(frozen=True, repr=False)
class SceneSpec(PlacementRequest):
    """Which objects are placed where, by which rules and which method.

    Attributes:
      pool: a pool's name or folder (`cluttergen list`), or several joined by +: dining+mine.
      objects: the pool's objects to use; all of them if empty. Names, patterns and conditions: "mug*",
        "mug* and volume<0.001", "label=*book* and height>=0.1", or a noun of WordNet, "cup.n.01", for all
        kinds of it; one that any of them means is used. There are name, label, synset, licence, source;
        volume (m^3 of material), mass (kg), x, y, height, width, depth (m), parts, flagged.
      exclude: the pool's objects to leave out, told in the same ways; exclude=("mug",) is the same as
        pool="dining~mug".
      num_objects: objects per scene, 1 to 128; all of the pool's (40 at most) if not given.
      sets: so many sets of objects, with as many layouts of each, for trainers whose worlds keep their
        objects: scene i has those of set i modulo `sets`, of a large pool all from one shelf. The number of
        scenes must be a multiple. If not given: each scene draws its own objects.
      repeat: allow duplicates: an object may be placed more than once.
      shelf: of a pool with very many objects each block of 256 scenes draws so many for its own, and each
        of its scenes some of those; 1 to 200. If not given: no such drawing from up to 200 objects, 64 of
        more, or twice as many as a scene has where that is more than 64.
      weights: by which a shelf is drawn, "mug*=3; label=*book*=0.5; cup.n.01=2": conditions as those of
        `objects`, and what an object's chance is multiplied by; 0 leaves it out. In Python also a mapping,
        whose keys may be labels.
      theme: only objects of an occasion, by the same table as `natural`: "breakfast", "dinner", "desk",
        "cooking", "tools", "bathroom" or "play".
      graspable: only objects that the hand of a robot can hold, by its name or file: it lifts them where they
        stand alone (extra `robot`; tested once for each object, some seconds, and kept). "graspable=panda" in
        `objects` is the same for one condition.
      balance: "objects", each is as likely to be on a shelf; or "label", "synset", "licence" or "source": of
        each of their values a shelf has as many, while there are some.
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size, "bin-0.50x0.30x0.20" a
        bin of that size inside.
      surface: on which surface of the support (`cluttergen inspect SUPPORT` lists them); the first if not
        given. "all", or several joined by commas: each object draws one by free area; "top:3,shelf_1:4": so
        many on each.
      region: the queried region, WxD or X,Y,W,D[,YAW] in metres and degrees; the support's own if not given.
        Or a polygon, X,Y;X,Y;X,Y ...; "outline" for the whole surface. In Python also a `Rectangle`.
      keep_out: boxes that objects must stay out of, X,Y,W,D[,YAW] each; in Python also `Rectangle`s.
      start: a scene to start from, BANK:INDEX; its objects stay and count as neighbours.
      containment: what must lie in the region: the bounding box's "center", or its whole "footprint".
      order: the order in which objects are placed: "random"; "fixed", the pool's; "largest" footprint first;
        or "weighted", larger ones mostly first. If not given: the method's own, "random" for most.
      max_attempts: attempts per object, 1 to 10; a policy of poses allows as many as it was trained with at
        most. Of a pile: how often an object that comes to lie outside is let fall, at most.
      ruin_after: number of failed attempts in a row after which some placed objects, with all that lean on
        them, are removed and placed again; 0 removes nothing. If not given: the method's own, 0 for most.
      budget: attempts of a scene in all; `max_attempts` for each object if not given, with "packed" and
        where doors are closed unasked twice as many, and up to 20 for each where it is crowded
        (`placement.room.with_crowding`).
      min_margin: minimum horizontal distance (m) from an object's centre of mass to the edge of its support;
        0 asks for nothing. If not given: 0.003.
      robust: require that an object, and whatever it touches, is also stable while gravity is tilted by 5
        degrees, friction is 0.7 times as much and contacts are softer; native engine only.
      stability: other limits of what counts as stable, "shift=0.002,turn=2deg": how far an object that stands
        may move in later attempts, in the last check and in `verify`; or names and numbers of a
        `StabilityConfig`, of which paper and docs/contract.md tell. In Python also a mapping or that config.
      for_engine: an engine other than MuJoCo in which scenes shall stand too: "drake", "pybullet", "isaac". A
        larger `min_margin` is asked for, unless one is given.
      setting: default preset of the rules that are not given: "default", or "paper": a random order, nothing
        removed, no margin.
      overhang: how much of an object's footprint may reach beyond the edge of the support once it rests:
        "any"; "half", at most 25 % (a uniform body tips at 50 %); or "none".
      clutter: what scenes should have on average (methods "guided", "spread"): stack, number of objects on
        others; contained, number of objects inside of hollow others, such as bowls and pots; depth, sum over
        objects of those below; contacts, touching pairs; near, mean distance to the nearest object (m);
        occlusion, mean hidden share of an object. With any method that places one by one: side, pairs that
        touch from the side, for each object; lean, share of the objects that lean (see `crowd`). As text
        "stack=3,near=0.02"; in Python also a mapping. Method "packed" takes stack, and it alone of the first
        ones: at most so many objects on others, where the top has no room.
      natural: place things as people leave them, by a table of what is usually on, in and beside what, and
        how it is turned: its sides along those of the region, or its front to the seat (methods "guided",
        "spread"). What is of no kind in the table may be anywhere, wide and flat things below small ones.
      sense: your own table for `natural`, `theme` and stacks: a YAML file like the package's
        (`cluttergen_jax/assets/scene_sense.yaml`).
      seat: the side of the region at which someone sits, for `natural`: "-y", "+y", "-x" or "+x".
      tidy: keep room instead of spreading objects out: more objects fit, but scenes are less diverse (methods
        "guided", "spread").
      height: from which `random` releases an object: "rest", 1 mm above its resting height on the bare top;
        or "free", anywhere in the region's range of heights.
      poses: how objects are released, turned about the vertical at random: "upright"; "resting", in any of
        their resting poses, as often as they end in it when thrown; "usual", in those, as often as people
        leave them so: mostly upright, flat things sometimes turned over, a bottle rarely on its side; or
        "any", in any orientation.
      relations: what must hold in every scene (methods "guided", "spread"): "mug on book", "apple in bowl",
        "fork left_of plate", "cup next_to bottle:0.05", "knife aligned fork". There are on, under, in,
        next_to, far_from, left_of, right_of, in_front_of, behind (with metres of gap if wanted) and aligned.
        A name is an object's, a role's or "any"; the same name is the same object.
      relations_prefer: where relations hold, prefer what people choose: near the middle of a side, close by,
        turned along what is beside, over the middle of what carries or holds; else all alike.
      roles: names in relations and the condition of the objects that each may stand for, as those of
        `objects`: "plate_1=plate*; plate_2=plate*". In Python also a mapping.
      arrangements: what people make of equal things, with how many (3 if not given; methods "guided",
        "spread"): "row label=*book*:4", upright side by side, on shelves against the back; "stack plate*:3",
        one upon the other; "nest bowl", one inside of the other. The objects are told as those of `objects`;
        where a pool has one of them, `repeat` gives more.
      clearance: metres between the outlines of objects, and to the region's sides, that "packed" leaves;
        0.003 if not given.
      crowd: how far the objects of a finished scene are drawn together: 0, they stay where they were placed;
        0.5, neighbours touch from the side, the same as clutter="side=1"; 1, a heap in which what is tall
        leans, as clutter="side=1,lean=0.4". In natural scenes nothing climbs. Native engine only.
      doors: "closed": doors and drawers of the support stand open while objects are placed, and are closed
        then; a scene succeeds if they close, to within 1 degree or 2 mm, and all objects stand undisturbed.
        "open": they stay as they stand. If not given: those that `import --support` opened to look behind
        them are closed.
      method: who proposes poses: "guided", "spread", "drop", "clear", "random", or a policy trained for the
        pool: "policy", "beta_free", "normal", "open_loop" or "short_memory"; "packed": upright, side by side,
        on others only as many as `clutter` allows by stack; or "pile": all objects fall into a heap, in any
        orientation, as in a bin. Or your own, as FILE.py:name or module:name; in Python also a function of
        key and episode that gives an action, or one of the rules that gives such a function
        (examples/17_own_method.py). If not given: the checkpoint's own, else "guided" ("spread" where no
        checkpoint of it is embedded).
      checkpoint: the policy's folder; the embedded one for the pool if not given.
      engine: "auto", "native", "warp" or "jax".
      num_threads: simulation threads of the native engine; 0 takes every core.

    Raises:
      ConfigError: a value is of a wrong type, out of range, or contradicts another.
    """

    pool: str | Path = "dining"
    objects: Sequence[str] = ()
    exclude: Sequence[str] = ()
    repeat: bool = False
    shelf: int | None = None
    weights: str | Mapping[str, float] = ""
    theme: str = ""
    graspable: str | Path = ""
    balance: Balance = "objects"
    support: str | Path = "table"
    surface: str = ""
    region: Rectangle | str | None = None
    keep_out: Sequence[Rectangle | str] = ()
    start: str | None = None
    robust: bool = False
    stability: str | Mapping[str, float | str] | StabilityConfig | None = None
    for_engine: OtherEngine | None = None
    setting: Setting = "default"
    method: Method | OwnProposer | str | None = None
    checkpoint: str | Path | None = None
    engine: Engine = "auto"
    num_threads: int = 0

    def __post_init__(self) -> None:
        from cluttergen_jax.assets.support import Rectangle, parse_boxes

        for name in ("num_objects", "sets", "shelf", "max_attempts", "ruin_after", "budget"):
            check_whole(**{name: getattr(self, name)})
        check_workers("num_threads", self.num_threads)
        check_engine(self.engine)
        check_names(self.objects, "objects")
        check_names(self.exclude, "exclude")
        if not isinstance(self.region, Rectangle | str | None):
            hint = "Rectangle(half_extents=(0.2, 0.25))"
            raise ConfigError(
                f"region = {self.region!r}", "a Rectangle, or text such as 0.4x0.5", hint
            )
        if not all(isinstance(box, Rectangle) for box in parse_boxes(self.keep_out, "keep_out")):
            hint = "keep_out=(Rectangle(...),)"
            raise ConfigError(f"keep_out = {self.keep_out!r}", "a sequence of Rectangles", hint)
        if self.setting not in SETTINGS:
            meant = closest(self.setting, SETTINGS)
            raise ConfigError(
                f"setting = {self.setting!r}", ", ".join(SETTINGS), "setting='paper'", meant
            )
        if self.for_engine is not None and self.for_engine not in MARGIN_FOR:
            raise no_such("for_engine", self.for_engine, tuple(MARGIN_FOR))
        if self.balance not in BALANCES:
            meant = closest(self.balance, BALANCES)
            raise ConfigError(
                f"balance = {self.balance!r}", ", ".join(BALANCES), "balance='label'", meant
            )
        if isinstance(self.weights, Mapping):
            pairs = (
                (_condition_of(str(name)), float(weight)) for name, weight in self.weights.items()
            )
            object.__setattr__(
                self, "weights", "; ".join(f"{name}={weight!r}" for name, weight in pairs)
            )
        self._weights()
        if isinstance(self.roles, Mapping):
            named = "; ".join(f"{name}={condition}" for name, condition in self.roles.items())
            object.__setattr__(self, "roles", named)
        check_names(self.relations, "relations")
        if self.method is not None:
            object.__setattr__(self, "method", find_method(self.method))
        if self.stability is not None:
            text = stability_text(stability_of(self.stability))
            object.__setattr__(self, "stability", text or None)
        check_names(self.arrangements, "arrangements")
        if self.start is not None and (self.relations or self.roles or self.arrangements):
            given = "`relations` or `arrangements` with a scene to start from"
            raise ConfigError(given, "one or the other", "leaving out `start`")
        # Equal requests are equal, and can be hashed, whatever kind of sequence or path was given.
        for name in ("objects", "exclude", "keep_out", "relations", "arrangements"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in ("pool", "support", "sense", "graspable"):
            object.__setattr__(self, name, str(getattr(self, name)))
        if self.clutter is not None:
            object.__setattr__(self, "clutter", Clutter.of(self.clutter))
        # With no number of objects yet, a budget for one is enough; of too many, the pool says what it has.
        arranged = sum(each.number for each in parse_arrangements(self.arrangements))
        related = conditions_of(parse_roles(str(self.roles)), parse_relations(self.relations))
        least = max(1, len(related) + arranged)
        self._placement(least if self.num_objects is None else min(self.num_objects, MAX_SLOTS))

    @classmethod
    def from_recipe(cls, recipe: Mapping[str, Any]) -> SceneSpec:
        """The request of a bank, with everything decided that was left open.

        Args:
          recipe: what a bank's record says of how it was made (`Bank.record["recipe"]`).

        Raises:
          KeyError, TypeError, ValueError: it does not say it whole, as of banks of early versions.
        """
        from cluttergen_jax.assets.support import recorded_rectangle

        rules = recipe["placement"]
        # Those that every recipe has; and of those that came later, what there was before.
        asked: dict[str, Any] = {name: recipe[name] for name in _ALWAYS_ASKED}
        asked |= {name: rules[name] for name in _ALWAYS_RULED}
        asked |= {"ruin_after": 0, "min_margin": 0.0}
        asked |= {name: recipe[name] for name in _LATER if name in recipe}
        asked |= {"relations_prefer": not rules.get("relations")}
        unused = [] if rules.get("natural") else ["seat"]
        # A theme is recorded as the objects that it chose, and so is what a hand can hold.
        unused += [] if rules.get("natural") or rules.get("poses") == "usual" else ["sense"]
        asked |= {name: rules[name] for name in RULES if name in rules and name not in unused}
        stability = recipe["stability"]
        is_native = recipe["engine"] == "native"
        return cls(
            **asked
            | {
                "weights": dict(recipe.get("weights", ())),
                "region": _recorded_region(recipe),
                "keep_out": tuple(map(recorded_rectangle, recipe.get("keep_out", ()))),
                "robust": bool(stability.get("robust_tilt")),
                "stability": _recorded_stability(stability, rules),
                "setting": "paper"
                if is_native and not stability.get("both_detectors")
                else "default",
                "roles": dict(rules.get("roles", ())),
                "method": recorded_method(recipe),
            }
        )

    def overrides(self) -> SceneOptions:
        """The fields that are not at their defaults, by name."""
        found = {name: getattr(self, name) for name in DEFAULTS}
        return cast(
            SceneOptions,
            {name: value for name, value in found.items() if value != DEFAULTS[name]},
        )

    def __repr__(self) -> str:
        return f"SceneSpec({', '.join(f'{name}={value!r}' for name, value in self.overrides().items())})"

    def replace_given(
        self,
        pool: str | Path | None = None,
        method: Method | OwnProposer | str | None = None,
        support: str | Path | None = None,
        num_objects: int | None = None,
        region: Rectangle | str | None = None,
    ) -> SceneSpec:
        """The request with those of these fields in place of its own that are not None."""
        return replace(
            self,
            pool=self.pool if pool is None else pool,
            method=self.method if method is None else method,
            support=self.support if support is None else support,
            num_objects=self.num_objects if num_objects is None else num_objects,
            region=self.region if region is None else region,
        )

    def with_rules(self, method: str | None) -> SceneSpec:
        """The request with `order`, `ruin_after` and `min_margin` decided, where they were not given.

        Args:
          method: by name; None for an environment, in which someone else acts.
        """
        return replace(self, **self._decided_rules(method))

    def _decided_rules(self, method: str | None) -> dict[str, Any]:
        is_default = self.setting == "default"
        is_ordered = is_default and entry_of(method).is_ordered
        order: Order = "weighted" if is_ordered else "random"
        patience = RUIN_AFTER_PACKED if entry_of(method).limits_stack else RUIN_AFTER
        can_take_away = is_ordered and not entry_of(method).is_whole
        ruin_after = min(patience, self.max_attempts) if can_take_away else 0
        # In a heap things lean on walls and on each other.
        is_heap = entry_of(method).is_heap or self._asks_to_lean()
        usual = MIN_MARGIN if is_default and not is_heap else 0.0
        min_margin = usual if self.for_engine is None else MARGIN_FOR[self.for_engine]
        usual_rules = {"order": order, "ruin_after": ruin_after, "min_margin": min_margin}
        given = {name: getattr(self, name) for name in usual_rules}
        return usual_rules | {name: value for name, value in given.items() if value is not None}

    def check_poses(self, method: str) -> None:
        """Refuses poses with a method that sees clouds of upright objects (ConfigError)."""
        entry = entry_of(method)
        if self.poses != "upright" and "poses" not in entry.takes:
            given = f"poses = {self.poses!r} with method {str(method)!r}"
            allowed = ", ".join(takers("poses"))
            given += entry.own_poses
            raise ConfigError(given, f"poses='upright', or method {allowed}", "method='guided'")

    def check_sense(self) -> None:
        """Refuses a table of sense that nothing reads (ConfigError)."""
        is_read = self.natural or self.theme or self.arrangements or self.poses == "usual"
        if self.sense and not is_read:
            given = f"sense = {str(self.sense)!r}, which nothing here reads"
            allowed = "with natural, a theme, arrangements or poses='usual'"
            raise ConfigError(given, allowed, "natural=True")

    def check_method(self, method: str) -> None:
        """Refuses what is asked of scenes that a method cannot bring about (ConfigError)."""
        entry = entry_of(method)
        if self.height != "rest" and "height" not in entry.takes:
            given = f"height = {self.height!r} with method {str(method)!r}"
            raise ConfigError(given, "height='rest'", f"method={takers('height')[0]!r}")
        self.check_poses(method)
        if entry.limits_stack and self.clutter is not None:
            targets = Clutter.of(self.clutter).targets
            if others := [name for name in targets if name not in ("stack", *CROWDED)]:
                given = f"clutter {others[0]}={targets[others[0]]:g} with method {str(method)!r}"
                allowed = (
                    "stack, the most objects that may rest on others; or with guided or spread"
                )
                raise ConfigError(given, allowed, f"method={TRUSTED[0]!r}")
        self._check_crowd(entry)
        # A preference asks for nothing by itself.
        targets_asked = [name for name in TARGETS if name != "relations_prefer"]
        wanted = [name for name in targets_asked if self._asks(name) and name not in entry.takes]
        if wanted:
            given = f"`{wanted[0]}` with method {str(method)!r}"
            raise ConfigError(given, f"with {' or '.join(TRUSTED)}", f"method={TRUSTED[0]!r}")
        if self.clearance is not None and "clearance" not in entry.takes:
            given = f"clearance = {self.clearance!r} with method {str(method)!r}"
            known = takers("clearance")
            raise ConfigError(given, f"with {' or '.join(known)}", f"method={known[0]!r}")
        if not entry.is_whole:
            return
        needing_steps = ["keep_out", "start", "ruin_after", "robust"]
        needing_steps += ["min_margin", "for_engine"] if entry.is_heap else []
        is_asked = {name: bool(getattr(self, name)) for name in needing_steps}
        region = self.region if isinstance(self.region, str) else ""
        is_asked["region"] = region == "outline" or ";" in region
        is_asked["surface"] = self.surface == "all" or bool({*",:"} & {*self.surface})
        is_asked["overhang"] = self.overhang != "any"
        is_asked["engine"] = self.engine in ("warp", "jax")
        wanted = [name for name, asked in is_asked.items() if asked]
        if wanted:
            value = getattr(self, wanted[0])
            raise ConfigError(
                f"{wanted[0]} = {value!r} with method {str(method)!r}, which makes each scene at once",
                "leaving it out",
                f"method={TRUSTED[0]!r}, which places one object after another",
            )

    def _asks(self, name: str) -> bool:
        """Whether a field of `TARGETS` asks for what not every method brings about."""
        if name == "clutter" and self.clutter is not None:
            return Clutter.of(self.clutter).for_draw is not None
        return bool(getattr(self, name))

    def _asks_to_lean(self) -> bool:
        """Whether some objects are to lean on others."""
        clutter = None if self.clutter is None else Clutter.of(self.clutter)
        return self.crowd > 0.5 or bool(clutter and clutter.lean)

    def _check_crowd(self, entry: MethodEntry) -> None:
        """Refuses crowds where objects cannot be drawn together (ConfigError)."""
        asked = {} if self.clutter is None else Clutter.of(self.clutter).targets
        named = [f"clutter {name}={asked[name]:g}" for name in CROWDED if asked.get(name)]
        named += [f"crowd = {self.crowd:g}"] if self.crowd else []
        if not named:
            return
        several = self.surface == "all" or bool({*",:"} & {*self.surface})
        reasons = {
            f"method={str(self.method)!r}, which makes each scene at once": entry.is_whole,
            f"engine={self.engine!r}, which draws nothing together": self.engine in ("warp", "jax"),
            "a scene to start from, whose objects stay": self.start is not None,
            f"surface={self.surface!r}, between which nothing is drawn": several,
            "one object": self.num_objects == 1,
        }
        for reason, holds in reasons.items():
            if holds:
                allowed = "two objects or more, placed one by one on one level surface by the native engine"
                raise ConfigError(f"{named[0]} with {reason}", allowed, "leaving out one of them")

    @property
    def pool_text(self) -> str:
        """The text that names the pool without what is left out of it."""
        from cluttergen_jax.assets.pool import join_pool_names

        return join_pool_names(self.pool, self.exclude)

    def find_pool(self) -> Pool | None:
        """The pool, read once for all; None where objects are named one by one, which alone are read.

        Raises:
          PoolError: there is none, or its files are damaged.
        """
        from cluttergen_jax.assets.facts import is_plain_name
        from cluttergen_jax.assets.pool import find_pool

        if (
            self.objects
            and all(map(is_plain_name, self.objects))
            and not (self.theme or self.graspable)
        ):
            return None
        return find_pool(self.pool_text)

    def check_num_scenes(self, num_scenes: int) -> None:
        """Refuses scenes that are not as many of each set (ConfigError)."""
        if not self.sets or num_scenes % self.sets == 0:
            return
        most = max(num_scenes // self.sets, 1) * self.sets
        raise ConfigError(
            f"num_scenes = {num_scenes} of sets = {self.sets}, which would not have as many layouts each",
            f"a multiple of {self.sets}",
            f"num_scenes={most}, {most // self.sets} of each set",
        )

    def boxes(self) -> list[Rectangle]:
        """The keep-out boxes."""
        from cluttergen_jax.assets.support import parse_boxes

        return parse_boxes(self.keep_out, "keep_out")

    def problem_config(self, method: str | None, found: Pool | None = None) -> ProblemConfig:
        """The request with everything decided that no asset decides.

        Args:
          method: see `with_rules`.
          found: the pool, where it is at hand.

        Raises:
          ConfigError: more objects are asked for than there are, there is no such engine, or a
            seat is given for scenes that are not natural.
          PoolError: there is no such pool or support.
        """
        from cluttergen_jax.assets.doors import are_to_be_closed
        from cluttergen_jax.assets.facts import chosen_names, is_plain_name
        from cluttergen_jax.assets.pool import find_pool
        from cluttergen_jax.assets.support import parse_polygon, parse_region, parse_surfaces
        from cluttergen_jax.assets.support_file import find_support
        from cluttergen_jax.physics import engine_of
        from cluttergen_jax.placement.problem import ProblemConfig
        from cluttergen_jax.placement.room import (
            boxes_over_area,
            check_number,
            check_sets,
            with_crowding,
        )

        if self.seat != DEFAULTS["seat"] and not self.natural:
            given = f"seat = {self.seat!r} of scenes that are not natural"
            raise ConfigError(given, "with natural", "natural=True")
        pool = self.pool_text
        chosen = tuple(self.objects)
        if not all(map(is_plain_name, chosen)):
            chosen = chosen_names((found or find_pool(pool)).facts, chosen, pool)
        if self.theme:
            from cluttergen_jax.assets.sense import read_sense

            facts = (found or find_pool(pool)).facts
            kept = [each for each in facts if not chosen or each.name in chosen]
            chosen = read_sense(str(self.sense)).in_theme(self.theme, kept, pool)
        if self.graspable:
            from cluttergen_jax.graspable import graspable_names

            names = chosen or (found or find_pool(pool)).names
            chosen = graspable_names(pool, names, str(self.graspable))
        available = len(chosen) or len(found or find_pool(pool))
        weights = self._weights()
        is_drawn = (
            self.shelf is not None
            or weights
            or self.balance != "objects"
            or available > MOST_ON_SHELF
        )
        shelf = 0
        if is_drawn:
            if weights:
                facts = (found or find_pool(pool)).facts
                available = self._num_weighted(facts, chosen)
            shelf = self._shelf_of(available)
            available = shelf
        entry = entry_of(method)
        num_objects = min(available, MOST_UNASKED) if self.num_objects is None else self.num_objects
        if ":" in self.surface:
            support = find_support(self.support)
            numbers = parse_surfaces(self.surface, support.surfaces, support.name)
            total = sum(number for _, number in numbers)
            if self.num_objects not in (None, total):
                given = f"{self.num_objects} objects on surfaces {self.surface!r}"
                raise ConfigError(given, f"{total}, as they add up to", f"num_objects={total}")
            num_objects = total
        check_number(num_objects, available, pool, self.repeat)
        check_sets(self.sets, num_objects, available, self.repeat)
        region = self.region
        polygon: Ring = ()
        if isinstance(region, str):
            support = find_support(self.support).on_surface(self.surface)
            if region == "outline" or ";" in region:
                polygon, region = parse_polygon(region, support)
            else:
                region = parse_region(region, support.region)
        limits = StabilityConfig() if self.stability is None else stability_of(self.stability)
        stability = replace(limits, robust_tilt=ROBUST_TILT if self.robust else 0.0)
        stability = _for_rules(stability, self.poses, self.relations)
        decided = self._decided_rules(method)
        if entry.limits_stack:
            clutter = None if self.clutter is None else Clutter.of(self.clutter)
            stack = None if clutter is None else clutter.stack
            decided["most_stacked"] = math.ceil(stack or 0)
        if self.doors is None and are_to_be_closed(find_support(self.support)):
            decided["doors"] = "closed"
        is_packed = entry.limits_stack or "doors" in decided
        if is_packed and self.budget is None and self.setting == "default":
            # All begin again where one finds no room.
            decided["budget"] = _MORE_PACKED * num_objects * self.max_attempts
        placement = self._placement(num_objects, decided)
        is_heap = entry.is_heap or self._asks_to_lean()
        is_native = entry.is_whole or is_heap or placement.crowd_targets is not None
        engine: Engine = "native" if is_native else self.engine
        has_two_detectors = engine_of(engine, stability) == "native"
        config = ProblemConfig(
            pool=pool,
            objects=chosen,
            named=tuple(name for name in self.objects if is_plain_name(name)),
            repeat=self.repeat,
            shelf=shelf,
            weights=weights,
            balance="" if self.balance == "objects" else self.balance,
            support=str(self.support),
            surface=self.surface,
            region=region,
            polygon=polygon,
            is_whole=entry.is_whole,
            is_piled=entry.is_heap,
            engine=engine,
            num_threads=self.num_threads,
            placement=placement,
            stability=replace(
                stability,
                both_detectors=has_two_detectors and self.setting != "paper",
                decide_alone=has_two_detectors and self.setting != "paper",
                # What is drawn together is held by its neighbours.
                side_support=stability.side_support or placement.crowd_targets is not None,
            ),
            contact=ContactConfig(noslip_iterations=PILE_NOSLIP if is_heap else 0),
        )
        if self.setting == "paper":
            return config
        facts = (found or find_pool(pool)).facts
        sizes = [each.size for each in facts if not chosen or each.name in chosen]
        surface = find_support(self.support).on_surface(self.surface)
        covered = boxes_over_area(sizes, config, surface)
        return replace(config, placement=with_crowding(placement, covered))

    def _num_weighted(self, facts: Sequence[ObjectFacts], chosen: Sequence[str]) -> int:
        """How many of the chosen objects, all if there are none, may be drawn by their weights."""
        from cluttergen_jax.assets.facts import weights_of

        kept = [each for each in facts if not chosen or each.name in chosen]
        number = int((weights_of(kept, self._weights()) > 0).sum())
        if not number:
            given = f"weights = {str(self.weights)!r}, by which no object of pool {self.pool_text!r} is drawn"
            allowed = "a weight above 0 for one object or more"
            raise ConfigError(given, allowed, "leaving out weights of 0")
        return number

    def _shelf_of(self, available: int) -> int:
        """How many of the objects that may be drawn each block draws for its own."""
        asked = self.num_objects or 0
        most = min(available, MOST_ON_SHELF)
        usual = min(SHELF if asked <= SHELF else 2 * asked, most)
        shelf = usual if self.shelf is None else self.shelf
        if not 1 <= shelf <= most:
            allowed = f"{range_text(1, most)} of the {available} objects of pool {self.pool_text!r}"
            raise ConfigError(f"shelf = {shelf}", allowed, f"shelf={usual}")
        if asked > shelf:
            given = f"{asked} objects of a shelf of {shelf}"
            hint = "fewer objects"
            if most < asked and self.weights:
                given = f"{asked} objects of {most} with a weight above 0"
                hint = "fewer objects, or weights above 0 for more"
            elif most >= asked:
                hint = f"shelf={min(most, 2 * asked)}"
            raise ConfigError(given, range_text(1, shelf), hint)
        drawn = "with a shelf of objects that each block draws"
        fewer = "fewer `objects` and no `shelf`"
        if self.relations or self.roles or self.arrangements:
            raise ConfigError(f"`relations` or `arrangements` {drawn}", "one or the other", fewer)
        if self.start is not None:
            raise ConfigError(f"`start` {drawn}", "no start", "fewer `objects`, without a shelf")
        if self.repeat:
            raise ConfigError(f"`repeat` {drawn}", "one or the other", f"repeat=False, or {fewer}")
        return shelf

    def _weights(self) -> tuple[tuple[str, float], ...]:
        if not self.weights:
            return ()
        from cluttergen_jax.assets.facts import parse_weights

        return parse_weights(str(self.weights))

    def _placement(
        self, num_objects: int, decided: Mapping[str, Any] | None = None
    ) -> PlacementConfig:
        """The rules of an episode; those that are not decided yet are the paper's."""
        asked = {name: getattr(self, name) for name in RULES}
        rules = {name: value for name, value in asked.items() if value is not None}
        rules |= decided or {}
        rules["num_objects"] = num_objects
        rules["roles"] = parse_roles(str(self.roles))
        if not self.relations and isinstance(self.relations_prefer, bool):
            rules["relations_prefer"] = False
        # With a hundred objects one in four scenes would be lost to a single one that creeps.
        rules["retry_last"] = bool(rules.get("ruin_after")) and num_objects > MANY
        return PlacementConfig(**rules)


DEFAULTS = {name: getattr(SceneSpec, name) for name in SceneOptions.__annotations__}
"""Of the fields of a request, in the order in which they are shown."""
RULES = tuple(each.name for each in dataclasses.fields(PlacementRequest))
"""Those that `PlacementConfig` has as well, decided."""
_ALWAYS_ASKED = ("pool", "objects", "repeat", "support", "engine")
_ALWAYS_RULED = ("num_objects", "containment", "order")
_LATER = ("shelf", "balance", "surface", "start", "checkpoint")


def _condition_of(name: str) -> str:
    """A key of `weights` as a condition: a label of several words is none as it is."""
    is_label = " " in name.strip() and " and " not in name and not {*name} & {*"<>=*"}
    return f"label={name}" if is_label else name


def recorded_method(recipe: Mapping[str, Any]) -> str | None:
    """The method of a bank; of a user's own its name and digest, None if people made it."""
    if digest := recipe.get("method_digest"):
        return OwnMethod(recipe["method"], digest)
    return None if recipe["method"] in UNPROPOSED else recipe["method"]


def _recorded_stability(record: Mapping[str, Any], rules: Mapping[str, Any]) -> str | None:
    """The limits of a bank where they are not the usual ones."""
    usual = StabilityConfig()
    known = {each.name for each in dataclasses.fields(usual)}
    found = StabilityConfig(**{name: value for name, value in record.items() if name in known})
    waited = _for_rules(
        replace(found, settle_steps=usual.settle_steps),
        rules.get("poses"),
        rules.get("relations", ()),
    )
    if found == waited:
        found = replace(found, settle_steps=usual.settle_steps)
    return stability_text(found) or None


def _for_rules(
    stability: StabilityConfig, poses: str | None, relations: Sequence[str]
) -> StabilityConfig:
    """What is let go in any orientation, or into a hollow, falls over, and rolls, before it comes to rest."""
    is_inside = is_any_inside(parse_relations(relations))
    if is_inside:
        stability = replace(stability, side_support=True, lower_releases=True)
    has_time = stability.settle_steps != StabilityConfig.settle_steps
    if has_time or not (poses == "any" or is_inside):
        return stability
    return replace(stability, settle_steps=stability.max_steps - stability.quiet_steps)


def _recorded_region(recipe: Mapping[str, Any]) -> Rectangle | str:
    from cluttergen_jax.assets.support import recorded_rectangle

    if corners := recipe.get("polygon"):
        return ";".join(f"{x!r},{y!r}" for x, y in corners)
    return recorded_rectangle(recipe["region"])


def renamed(**names: str) -> Callable[[F], F]:
    """A decorator for a function whose arguments had other names before: those go on working, with a warning.

    Args:
      names: today's name by the former one.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def call(*args: Any, **given: Any) -> Any:
            for former in names.keys() & given.keys():
                text = f"{function.__name__}({former}=...) is now called {names[former]}"
                warnings.warn(text, DeprecationWarning, stacklevel=2)
                given[names[former]] = given.pop(former)
            return function(*args, **given)

        return cast(F, call)

    return decorate


def takes_spec(refused: Mapping[str, str] | None = None, **defaults: Any) -> Callable[[F], F]:
    """A decorator for a function of `spec` and `**options`: its signature lists the fields, with defaults.

    Args:
      refused: fields that it does not take, and why not.
      defaults: of those whose default is another than `SceneSpec`'s.
    """
    reasons = dict(refused or {})

    def decorate(function: F) -> F:
        own = [
            each
            for each in inspect.signature(function).parameters.values()
            if each.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        usual = DEFAULTS | defaults
        names = [name for name in usual if name not in reasons]
        shown = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=usual[name],
                annotation=SceneOptions.__annotations__[name].__forward_arg__,
            )
            for name in names
        ]
        # In help what is asked for comes before how it is made.
        own_keywords = [each for each in own if each.kind is inspect.Parameter.KEYWORD_ONLY]
        first = [each for each in own if each not in own_keywords]
        function.__signature__ = inspect.Signature([*first, *shown, *own_keywords])  # type: ignore[attr-defined]
        function.spec_fields = tuple(names)  # type: ignore[attr-defined]
        function.spec_refused = reasons  # type: ignore[attr-defined]
        function.spec_defaults = defaults  # type: ignore[attr-defined]
        return function

    return decorate


def spec_of(
    function: Callable[..., Any],
    spec: SceneSpec | str | Path | None,
    options: Mapping[str, Any],
    also: Sequence[str] = (),
) -> SceneSpec:
    """The request that a function was given: a spec, a pool's name or nothing, with some fields replaced.

    Args:
      function: one with the decorator `takes_spec`.
      also: fields that it takes in a spec alone.

    Raises:
      ConfigError: there is no such field, the function does not take it (and why), or a value is refused.
    """
    taken: tuple[str, ...] = function.spec_fields  # type: ignore[attr-defined]
    refused: Mapping[str, str] = function.spec_refused  # type: ignore[attr-defined]
    usual: dict[str, Any] = function.spec_defaults  # type: ignore[attr-defined]
    for name in options:
        if name in refused:
            value = options[name]
            given = f"{function.__name__}({name}={value!r}), {refused[name]}"
            raise ConfigError(given, ", ".join(taken), f"leaving {name} out")
        if name not in taken:
            names = [each for each in inspect.signature(function).parameters if each != "spec"]
            given = f"{function.__name__}({name}=...)"
            raise ConfigError(given, ", ".join(names), meant=closest(name, names))
    if isinstance(spec, str | Path):
        if "pool" in options:
            given = f"pool = {options['pool']!r} beside {str(spec)!r}"
            raise ConfigError(
                given, "one pool; several are joined by +", f"pool='{spec}+{options['pool']}'"
            )
        return SceneSpec(**{**usual, "pool": spec, **options})
    if spec is None:
        return SceneSpec(**{**usual, **options})
    if not isinstance(spec, SceneSpec):
        raise ConfigError(
            f"spec = {spec!r}", "a SceneSpec, or a pool's name", "SceneSpec(pool='dining')"
        )
    for name, value in spec.overrides().items():
        if name not in (*taken, *also):
            given = f"{name} = {value!r} in the spec for {function.__name__}, {refused[name]}"
            raise ConfigError(given, ", ".join(taken), f"leaving {name} out")
    return replace(spec, **options)
