"""Options of a command, made from the signatures and docstrings of the API functions that it calls."""

from __future__ import annotations

import dataclasses
import inspect
import types
import typing
from collections.abc import Callable, Sequence
from typing import Annotated, Any, get_args, get_origin

import tyro
from docstring_parser import parse

from cluttergen_jax import spec
from cluttergen_jax.cli.flags import FLAGS, option_help, options_of
from cluttergen_jax.errors import ConfigError

_WRITTEN = {str: "STR", int: "INT", float: "FLOAT"}
_NO_OPTIONS = ("show", "spec", "planner")


class Options:
    """A frozen dataclass whose fields are arguments of API functions; `run` gives the exit status."""

    if typing.TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """The fields, which `options_from` makes."""

    def call(
        self,
        function: Callable[..., Any],
        where: str = "",
        hint: str = "",
        ignored: Sequence[str] = (),
        only_changed: bool = False,
        **changes: Any,
    ) -> Any:
        """Calls a function with those of the options that it takes, and with `changes` in their place.

        Args:
          where, hint: what an error says of options that it does not take, and that were given.
          ignored: options that it does not take, and that do no harm.
          only_changed: pass on only the options that are not at their defaults.

        Raises:
          ConfigError: such an option was given.
        """
        taken = inspect.signature(function).parameters
        defaults = {field.name: field.default for field in dataclasses.fields(self)}  # type: ignore[arg-type]
        given = {name: getattr(self, name) for name in defaults}
        flags = set(options_of(self))
        useless = [
            f"--{FLAGS.get(name, name).replace('_', '-')}" if name in flags else f"{name} {value!r}"
            for name, value in given.items()
            if name not in (*taken, *ignored) and value != defaults[name]
        ]
        if useless:
            raise ConfigError(f"{', '.join(useless)} {where}", hint=hint)
        # What was left at None is the function's to say, where it says something.
        chosen = {
            name: value
            for name, value in given.items()
            if name in taken
            and not (only_changed and value == defaults[name])
            and (value is not None or taken[name].default is inspect.Parameter.empty)
        }
        return function(**chosen | changes)


def options_from(*functions: Callable[..., Any], **kinds: Any) -> Callable[[type], Any]:
    """A decorator that gives a command the arguments of functions, with their defaults, as options.

    What only one of several functions takes, and cannot do without, may be left out on the command line.

    Args:
      functions: where several take an argument, the first says what it is.
      kinds: types in place of the functions' own, by argument: what is positional, has an alias, or is text
        on the command line alone; and switches that no function takes, each with its help.
    """

    def decorate(command: type) -> type:
        fields: dict[str, tuple[str, Any, Any]] = {}
        docs: dict[str, str] = {}
        for function in functions:
            docs = _docs(function) | docs
            for name, parameter in inspect.signature(function).parameters.items():
                if name not in fields and name not in _NO_OPTIONS:
                    kind = kinds.get(name) or _as_given(_annotation(parameter, function))
                    is_needed = all(
                        name in inspect.signature(each).parameters for each in functions
                    )
                    fields[name] = (name, kind, _default(parameter.default, kind, is_needed))
        for name in kinds.keys() - fields.keys():
            fields[name] = (name, kinds[name], dataclasses.field(default=False))
        # A dataclass has fields without a default first.
        ordered = sorted(
            fields.values(), key=lambda field: field[2].default is not dataclasses.MISSING
        )
        made = dataclasses.make_dataclass(
            command.__name__,
            ordered,
            bases=(command,),
            frozen=True,
            namespace={"__doc__": command.__doc__},
        )
        for field in dataclasses.fields(made):
            if field.name not in docs:
                continue
            option = tyro.conf.arg(
                help=option_help(docs[field.name], made),
                name=FLAGS.get(field.name),
                metavar=_metavar(field.type),
                help_behavior_hint="(optional)" if field.default in (None, "", ()) else None,
            )
            made.__annotations__[field.name] = field.type = Annotated[field.type, option]
        return made

    return decorate


def _annotation(parameter: inspect.Parameter, function: Callable[..., Any]) -> Any:
    """The type of an argument; one by one, as some other's may take long to import."""
    if parameter.name in getattr(function, "spec_fields", ()):
        known = vars(spec)
    else:
        known = inspect.unwrap(function).__globals__
    # Rectangles and own methods are text there; reading their classes would load what is heavy.
    return eval(parameter.annotation, known | {"Rectangle": str, "OwnProposer": str})


def _docs(function: Callable[..., Any]) -> dict[str, str]:
    """What a docstring says of each argument."""
    own = parse(function.__doc__ or "").params
    # What a function says of an argument of its own, else what the request says of its fields.
    params = (
        [*parse(spec.SceneSpec.__doc__ or "").params, *own]
        if hasattr(function, "spec_fields")
        else own
    )
    return {name: each.description or "" for each in params for name in each.arg_name.split(", ")}


def _as_given(kind: Any) -> Any:
    """A type as a command line gives it: as text if a function takes it so, and sequences as tuples."""
    if isinstance(kind, types.UnionType):
        optional = [each for each in get_args(kind) if each is types.NoneType]
        others = [each for each in get_args(kind) if each is not types.NoneType]
        if str in others:
            return str | None if optional else str
        # A config of its defaults is what None stands for.
        return others[0] if dataclasses.is_dataclass(others[0]) else kind
    return (
        types.GenericAlias(tuple, (*get_args(kind), ...)) if get_origin(kind) is Sequence else kind
    )


def _metavar(kind: Any) -> str | None:
    """What stands for a value that may be left out: its type, or its choices; None for other types."""
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    if get_origin(kind) not in (types.UnionType, typing.Union):
        return None
    written = []
    for part in get_args(kind):
        if get_origin(part) is typing.Literal:
            written.append(f"{{{','.join(map(str, get_args(part)))}}}")
        elif part in _WRITTEN:
            written.append(_WRITTEN[part])
        elif part is not types.NoneType:
            return None
    return "|".join(written)


def _default(value: Any, kind: Any, is_needed: bool) -> Any:
    """The field of an argument with its default, or one that has none where all functions need it."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return dataclasses.field(default=kind())
    if value is not inspect.Parameter.empty:
        return dataclasses.field(default=value)
    if is_needed:
        return dataclasses.field()
    return dataclasses.field(default=() if "tuple" in str(kind) else None)
