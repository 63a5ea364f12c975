"""The table of methods: what each is called, what it can be asked for, what it needs, and what makes it.

Nothing heavy is imported here: the command line and `SceneSpec` read it. `config.Method` lists the same names
for type checkers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cluttergen_jax.config import HAND, PACKED, PILE, REPAIR, no_such
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.methods.own import OwnMethod

if TYPE_CHECKING:
    from cluttergen_jax.placement.rules import Proposer, Rules

TARGETS = ("clutter", "natural", "tidy", "relations", "roles")
"""Fields of a `SceneSpec` that say what scenes should be like."""


@dataclass(frozen=True)
class MethodEntry:
    """What is known of a method; without arguments, of whoever acts in an environment.

    Attributes:
      about: what it does, in a line.
      made_by: what makes its proposer from the rules of a world, "module:name" of this package; "" where a
        checkpoint does (`learning.methods`).
      episodes: the class of its episodes, written likewise.
      takes: fields of a `SceneSpec` that it brings about, of those that not every method does.
      is_baseline: compared unasked, and what learned methods have to beat.
      is_trusted: asks what carries what; by default larger objects come first, and some are taken away again
        when it is stuck.
      is_ordered: has that order, and takes away, by default.
      is_whole: makes each scene at once, not object by object.
      limits_stack: of `clutter` it takes stack alone, as the most objects that rest on others.
      own_poses: what an error says of one that chooses poses itself.
    """

    about: str = ""
    made_by: str = ""
    episodes: str = "rollout.run:BlockSampler"
    takes: tuple[str, ...] = ()
    is_baseline: bool = False
    is_trusted: bool = False
    is_ordered: bool = False
    is_whole: bool = False
    limits_stack: bool = False
    own_poses: str = ""

    @property
    def needs_checkpoint(self) -> bool:
        """Whether a checkpoint makes its proposer."""
        return not self.made_by


_TRUSTED = ("poses", *TARGETS)

METHODS: dict[str, MethodEntry] = {
    "random": MethodEntry(
        "a uniform position and turn on the support's surface",
        "methods.baselines:Random",
        takes=("poses", "height"),
        is_baseline=True,
    ),
    "clear": MethodEntry(
        "many uniform poses an attempt, of which the first on bare, whole ground is taken",
        "methods.baselines:Clear",
        takes=("poses",),
        is_baseline=True,
    ),
    "drop": MethodEntry(
        "the lowest of many places in which the object would not tip",
        "methods.baselines:LowestFit",
        takes=("poses",),
        is_baseline=True,
    ),
    "spread": MethodEntry(
        "a draw among the places in which an object rests with little gap and would not tip",
        "methods.baselines:Spread.of",
        takes=_TRUSTED,
        is_baseline=True,
        is_trusted=True,
        is_ordered=True,
    ),
    "guided": MethodEntry(
        "a draw among the places that a network trusts, which serves every pool",
        takes=_TRUSTED,
        is_trusted=True,
        is_ordered=True,
    ),
    PACKED: MethodEntry(
        "upright, side by side",
        "methods.packed:Packed",
        takes=("clutter", "clearance"),
        is_ordered=True,
        limits_stack=True,
        own_poses=", which places all objects upright",
    ),
    PILE: MethodEntry(
        "all objects let fall into a heap",
        "methods.baselines:Random",
        "methods.piles:PileSampler",
        is_whole=True,
        own_poses=", which always releases objects in random orientations",
    ),
    "policy": MethodEntry("a policy with the head of its preset, trained for the pool"),
    "beta_free": MethodEntry("the paper's policy"),
    "normal": MethodEntry("a policy with a normal distribution a coordinate"),
    "open_loop": MethodEntry("a policy that looks back on no failed attempt"),
    "short_memory": MethodEntry("a policy that looks back on one failed attempt"),
}

_OWN = MethodEntry("a user's own", "methods.own:OwnMethod", takes=("poses",))

TRUSTED = tuple(name for name, each in METHODS.items() if each.is_trusted)
BASELINES = tuple(name for name, each in METHODS.items() if each.is_baseline)
LEARNED = tuple(name for name, each in METHODS.items() if each.needs_checkpoint)


def takers(field: str) -> tuple[str, ...]:
    """The methods that take a field of a `SceneSpec`."""
    return tuple(name for name, each in METHODS.items() if field in each.takes)


def find_method(given: Any, what: str = "method") -> str:
    """The name of a method; of a user's own, the `OwnMethod`, which is a name with what is behind it.

    Args:
      given: a name, a user's own proposer, or where one is: "FILE.py:name" or "module:name".

    Raises:
      ConfigError: there is no such method.
    """
    if isinstance(given, OwnMethod) or (isinstance(given, str) and given in METHODS):
        return given
    if callable(given) or (isinstance(given, str) and ":" in given):
        own = OwnMethod.of(given)
        if own.name in (*METHODS, HAND, REPAIR):
            raise ConfigError(
                f"{what} {own.name!r} of your own",
                f"another name than {', '.join((*METHODS, HAND, REPAIR))}",
                "an attribute `name`",
            )
        return own
    raise no_such(what, given, METHODS)


def entry_of(method: str | None) -> MethodEntry:
    """What is known of a method; None is whoever acts in an environment.

    An own method takes `poses`, and the fields of a `SceneSpec` that its attribute `takes` names. A name of
    which nothing is known, as of a stored row, was one.
    """
    if method is None:
        return MethodEntry()
    if isinstance(method, OwnMethod):
        return replace(_OWN, takes=("poses", *method.takes))
    return METHODS.get(method, _OWN)


def make_proposer(method: str, rules: Rules) -> Proposer:
    """A method that needs no checkpoint, for the world behind `rules`.

    Raises:
      ConfigError: there is no such method, it needs a checkpoint, or an own one makes no actions.
    """
    if isinstance(method, OwnMethod):
        return method.make(rules)
    if method not in METHODS or METHODS[method].needs_checkpoint:
        raise ConfigError(f"method {method!r}", ", ".join(BASELINES), "method='clear'")
    return _found(METHODS[method].made_by)(rules)


def episodes_of(method: str) -> Callable[..., Any]:
    """The class of a method's episodes: `BlockSampler`, or one with its arguments."""
    return _found(entry_of(method).episodes)


def _found(place: str) -> Any:
    """What "module:name" of the package of placement names."""
    module, _, name = place.partition(":")
    found: Any = import_module(f"cluttergen_jax.placement.{module}")
    for part in name.split("."):
        found = getattr(found, part)
    return found
