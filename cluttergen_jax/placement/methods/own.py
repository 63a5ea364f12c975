"""A user's own method: a function of key and episode that gives an action, or of rules that gives such."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

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
