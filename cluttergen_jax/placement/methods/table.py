"""The table of methods: what each is called, what it can be asked for, what it needs, and what makes it.

A user's own method is a function of key and episode that gives an action, or of rules that gives such.
Nothing heavy is imported here: the command line and `SceneSpec` read it. `config.Method` lists the same names
for type checkers.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cluttergen_jax.config import HAND, PACKED, PILE, REPAIR, SETTLE, no_such
from cluttergen_jax.errors import ConfigError, closest

if TYPE_CHECKING:
    from cluttergen_jax.placement.rules import Proposer, Rules

_NAME = re.compile(r"[A-Za-z0-9][\w.+-]*", re.ASCII)
_WHAT = "a function (key, episode) -> action f32[4], or (rules) -> such a function"
_WHERE = "FILE.py:name, or module:name"


class OwnMethod(str):
    """The name of a user's own method, with what is behind it: equal where name and digest are.

    It is pickled as its function is, by the module and name under which it can be imported; what is found
    there has to have the same digest.

    Attributes:
      digest: tells it from others (`own_parts.part_digest`).
      part: what was given; None where only its name and digest are known, as a bank tells them.
      place: the text that named it, "" if it was given as it is.
    """

    digest: str
    part: Callable[..., Any] | None
    place: str

    def __new__(
        cls, name: str, digest: str, part: Callable[..., Any] | None = None, place: str = ""
    ) -> OwnMethod:
        own = super().__new__(cls, name)
        own.digest = digest
        own.part = part
        own.place = place
        return own

    @classmethod
    def of(cls, given: Callable[..., Any] | str) -> OwnMethod:
        """The method that was given, or that is at "FILE.py:name" or "module:name".

        Raises:
          ConfigError: there is none, it has no name, or nothing tells it from others.
        """
        from cluttergen_jax.own_parts import part_digest, part_name

        place = ""
        part: Any = given
        if isinstance(given, str):
            place, part = _read(given)
        name = part_name(part)
        if not callable(part) or not _NAME.fullmatch(name):
            raise ConfigError(
                f"method {name!r}", f"{_WHAT}, with a name", "`def`, or an attribute `name`"
            )
        return cls(name, part_digest(part, "method"), part, place)

    @property
    def name(self) -> str:
        """The name alone."""
        return str.__str__(self)

    @property
    def takes(self) -> tuple[str, ...]:
        """Fields of a `SceneSpec` that it says it brings about, of those that not every method does."""
        return tuple(getattr(self.part, "takes", ()))

    def make(self, rules: Rules) -> Proposer:
        """The method in a world.

        Raises:
          ConfigError: only its name is known, it takes other arguments, fails, or makes no action.
        """
        import jax

        from cluttergen_jax.numerics import new_key

        if self.part is None:
            raise ConfigError(
                f"method {self.name!r} (digest {self.digest}), a user's own that is not at hand",
                "that method itself, given as `method`: a bank holds its name alone",
                f"method='FILE.py:{self.name}'",
            )
        propose = self.part
        try:
            if self._is_factory():
                propose = self.part(rules)
            if jax.tree_util.all_leaves([propose]):
                # What is compiled knows it by itself; arrays that it holds are constants there.
                propose = jax.tree_util.Partial(propose)
            action = jax.eval_shape(lambda key: propose(key, rules.begin(key)), new_key(0))
        except ConfigError:
            raise
        except Exception as error:
            reason = str(error).strip().split("\n")[0]
            raise ConfigError(
                f"method {self.name!r}, which raised {type(error).__name__}: {reason}",
                f"{_WHAT}, in operations of JAX",
            ) from error
        shape = getattr(action, "shape", None)
        dtype = getattr(action, "dtype", None)
        if shape != (4,) or dtype != "float32":
            told = type(action).__name__ if shape is None else f"{dtype}{list(shape)}"
            raise ConfigError(
                f"method {self.name!r}, which makes {told} of a key and an episode",
                "an action: float32[4], x, y, z and turn from 0 to 1 (docs/contract.md)",
                "placement.region.action_of_pose, which makes one of a pose",
            )
        return propose

    def _is_factory(self) -> bool:
        """Whether it is given the rules of a world, not a key and an episode."""
        assert self.part is not None
        signature = inspect.signature(self.part)
        fits = [_can_take(signature, number) for number in (1, 2)]
        if fits[0] == fits[1]:
            both = "one argument and two" if fits[0] else "neither one argument nor two"
            raise ConfigError(f"method {self.name!r}, which can be called with {both}", _WHAT)
        return fits[0]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OwnMethod):
            return False
        return (self.name, self.digest) == (other.name, other.digest)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((self.name, self.digest))

    def __repr__(self) -> str:
        return f"<{self.name} {self.digest}>"

    def __copy__(self) -> OwnMethod:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> OwnMethod:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (self.name, self.digest, self.place or self.part)


def _can_take(signature: inspect.Signature, number: int) -> bool:
    try:
        signature.bind(*range(number))
    except TypeError:
        return False
    return True


def _restore(name: str, digest: str, given: Any) -> OwnMethod:
    """A pickled method, if it still is what it was."""
    from cluttergen_jax.own_parts import part_digest

    if given is None:
        return OwnMethod(name, digest)
    place = given if isinstance(given, str) else ""
    part = _read(given)[1] if place else given
    try:
        found = part_digest(part, "method")
    except ConfigError:
        # Code that came with the pickle, whose source is not here.
        found = digest
    if found != digest:
        raise ConfigError(
            f"method {name!r}, which has the digest {found} here and had {digest} where it was pickled",
            "the same code in both places",
        )
    return OwnMethod(name, digest, part, place)


def _read(text: str) -> tuple[str, Any]:
    """What "FILE.py:name" or "module:name" names, and that text with the file's whole path."""
    from cluttergen_jax.own_parts import load_module

    module, name, text = load_module(text, "method")
    found: Any = module
    for part in name.split("."):
        if not hasattr(found, part):
            known = [each for each, value in vars(module).items() if inspect.isroutine(value)]
            raise ConfigError(
                f"method {text!r}, where nothing is called {name!r}",
                ", ".join(known) or _WHERE,
                meant=closest(name, known),
            )
        found = getattr(found, part)
    return text, found


TARGETS = (
    "clutter",
    "natural",
    "tidy",
    "relations",
    "roles",
    "relations_prefer",
    "arrangements",
)
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
      is_ordered: has that order by default, and takes away unless it makes scenes at once.
      is_whole: makes each scene at once, which the native engine does, not object by object.
      is_heap: all objects fall together.
      limits_stack: of `clutter` it takes stack alone, as the most objects that rest on others.
      own_poses: what an error says of one that chooses poses itself.
    """

    about: str = ""
    made_by: str = ""
    episodes: str = "rollout:BlockSampler"
    takes: tuple[str, ...] = ()
    is_baseline: bool = False
    is_trusted: bool = False
    is_ordered: bool = False
    is_whole: bool = False
    is_heap: bool = False
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
    SETTLE: MethodEntry(
        "the plain loop to beat: objects dropped on free spots, or on others, that settle in plain MuJoCo",
        "methods.baselines:Random",
        "methods.settle:SettleSampler",
        is_baseline=True,
        is_ordered=True,
        is_whole=True,
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
        is_heap=True,
        own_poses=", which always releases objects in random orientations",
    ),
    "policy": MethodEntry("a policy with the head of its preset, trained for the pool"),
    "beta_free": MethodEntry("the paper's policy"),
    "normal": MethodEntry("a policy with a normal distribution a coordinate"),
    "open_loop": MethodEntry("a policy that looks back on no failed attempt"),
    "short_memory": MethodEntry("a policy that looks back on one failed attempt"),
}

_OWN = MethodEntry("a user's own", "methods.table:OwnMethod", takes=("poses",))

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
    return _import(METHODS[method].made_by)(rules)


def episodes_of(method: str) -> Callable[..., Any]:
    """The class of a method's episodes: `BlockSampler`, or one with its arguments."""
    return _import(entry_of(method).episodes)


def _import(place: str) -> Any:
    """What "module:name" of the package of placement names."""
    module, _, name = place.partition(":")
    found: Any = import_module(f"cluttergen_jax.placement.{module}")
    for part in name.split("."):
        found = getattr(found, part)
    return found
