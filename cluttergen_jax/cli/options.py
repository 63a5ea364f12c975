"""Commands, whose options are made from the signatures and docstrings of the functions that they call."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import operator
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args, get_origin

import tyro
from docstring_parser import parse

from cluttergen_jax import spec
from cluttergen_jax.cli.flags import flag_of, option_help, options_of
from cluttergen_jax.errors import ConfigError

_WRITTEN = {str: "STR", int: "INT", float: "FLOAT", Path: "PATH"}
RESUMES = "rerun the command to resume"
NOTHING_WRITTEN = "nothing was written"
_NO_OPTIONS = ("show", "spec", "planner")


class Options:
    """Options as they were given: frozen dataclasses, whose fields `Command.options` makes."""

    told_when_stopped: ClassVar[str]
    needs_mujoco: ClassVar[bool]
    parser: ClassVar[Any]
    """What tyro makes the options with: a function of their groups, or the class where it has none."""

    if typing.TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """The fields."""

        run: Callable[[], int]
        """Runs the command; the exit status."""

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
            flag_of(name) if name in flags else f"{name} {value!r}"
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
            # Of options that are several in one, too: it may have others than their defaults.
            and not (dataclasses.is_dataclass(value) and value == defaults[name])
        }
        return function(**chosen | changes)


@dataclasses.dataclass(frozen=True, eq=False)
class Command:
    """A command, whose options are the arguments of functions, with their defaults.

    What only one of several functions takes, and cannot do without, may be left out on the command line,
    unless it is needed.

    Attributes:
      run: what it does with its options; the exit status, None for 0. Its docstring is the command's help.
      functions: where several take an argument, the first says what it is. If there are none, the options are
        the arguments of `run`.
      kinds: types in place of the functions' own, by argument: what is positional, has an alias, or is text
        on the command line alone; and switches that no function takes, each with its help.
      told_when_stopped: what Ctrl-C has left, and what the same command does then.
      needs_mujoco: whether it is refused where MuJoCo cannot be imported.
      left_out: arguments of the functions that are no options.
      needed: those that are no option to leave out, though not all functions take them.
      everyday: the options that most calls need, in their order, with spaces between. Where there are some,
        the help begins with them, and shows the others in groups (`spec.in_groups`).
    """

    run: Callable[..., int | None]
    functions: Sequence[Callable[..., Any]]
    kinds: Mapping[str, Any]
    told_when_stopped: str
    needs_mujoco: bool
    left_out: Sequence[str] = ()
    needed: Sequence[str] = ()
    everyday: str = ""

    @functools.cached_property
    def options(self) -> type[Options]:
        """The class of its options."""
        fields: dict[str, tuple[str, Any, Any]] = {}
        docs: dict[str, str] = {}
        functions = self.functions or (self.run,)
        for function in functions:
            docs = _docs(function) | docs
            for name, parameter in inspect.signature(function).parameters.items():
                if name not in fields and name not in (*_NO_OPTIONS, *self.left_out):
                    kind = self.kinds.get(name) or _as_given(_annotation(parameter, function))
                    is_needed = all(
                        name in inspect.signature(each).parameters for each in functions
                    ) or (name in self.needed)
                    fields[name] = (name, kind, _default(parameter.default, kind, is_needed))
        for name in self.kinds.keys() - fields.keys():
            fields[name] = (name, self.kinds[name], dataclasses.field(default=False))
        # A dataclass has fields without a default first.
        ordered = sorted(
            fields.values(), key=lambda field: field[2].default is not dataclasses.MISSING
        )
        made = self._class(ordered)
        for field in dataclasses.fields(made):  # type: ignore[arg-type]
            if field.name not in docs:
                continue
            about = " ".join(docs[field.name].split())
            may_miss = (None, "", ()) if self.functions else (None,)
            option = tyro.conf.arg(
                help=option_help(about, made) if self.functions else about,
                metavar=_metavar(field.type),
                help_behavior_hint="(optional)" if field.default in may_miss else None,
            )
            made.__annotations__[field.name] = field.type = Annotated[field.type, option]
        made.parser = self._parser(made) if self.everyday else made
        return made

    def _parser(self, made: type[Options]) -> Callable[..., Options]:
        """A function that makes the options of their groups, of which each has a heading in the help."""
        everyday = self.everyday.split()
        group_of = self._group_of() | dict.fromkeys(everyday, "everyday")
        groups: dict[str, list[dataclasses.Field[Any]]] = {name: [] for name in spec.OPTION_GROUPS}
        positional = []
        settings = []
        for field in dataclasses.fields(made):  # type: ignore[arg-type]
            if "Positional" in str(field.type):
                positional.append(field)
            elif dataclasses.is_dataclass(field.default):
                # They have a heading of their own.
                settings.append(field)
            else:
                groups[group_of.get(field.name, "how")].append(field)
        if len(groups["everyday"]) != len(everyday):
            raise TypeError(f"{self.run.__name__}: no such option, or no plain one, in {everyday}")
        groups["everyday"].sort(key=lambda field: everyday.index(field.name))
        parts = {name: _part(name, fields) for name, fields in groups.items() if fields}

        def parse(**given: Any) -> Options:
            values: dict[str, Any] = {}
            for name, value in given.items():
                values |= vars(value) if name in parts else {name: value}
            return made(**values)

        parameters = [
            *(_parameter(each.name, each.type, each.default) for each in positional),
            *(_parameter(name, *part) for name, part in parts.items()),
            *(_parameter(each.name, each.type, each.default) for each in settings),
        ]
        parse.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        parse.__annotations__ = {each.name: each.annotation for each in parameters}
        parse.__doc__ = made.__doc__
        return parse

    def _group_of(self) -> dict[str, str]:
        """The group of each argument that is in one."""
        found: dict[str, str] = {}
        for function in self.functions:
            fields = getattr(function, "spec_fields", ())
            own = getattr(function, "option_groups", {})
            found = {name: spec.GROUP_OF[name] for name in fields} | own | found
        return found

    def _class(self, fields: Sequence[Any]) -> type[Options]:
        def run(options: Options) -> int:
            done = self.run(options) if self.functions else options.call(self.run)
            return done or 0

        about = (self.run.__doc__ or "").partition("\n    Args:")[0]
        return dataclasses.make_dataclass(
            self.run.__name__,
            fields,
            bases=(Options,),
            frozen=True,
            namespace={
                "__doc__": about,
                "run": run,
                "told_when_stopped": self.told_when_stopped,
                "needs_mujoco": self.needs_mujoco,
            },
        )


def _part(name: str, fields: Sequence[dataclasses.Field[Any]]) -> tuple[Any, Any]:
    """The type and default of options of one group as a single one, which tyro shows below a heading."""
    made: Any = dataclasses.make_dataclass(
        name, [(each.name, each.type, dataclasses.field(default=each.default)) for each in fields]
    )
    is_needed = any(each.default is dataclasses.MISSING for each in fields)
    kind = Annotated[made, tyro.conf.arg(help=spec.OPTION_GROUPS[name])]
    return kind, dataclasses.MISSING if is_needed else made()


def _parameter(name: str, kind: Any, default: Any) -> inspect.Parameter:
    """An argument that is given by name."""
    is_needed = default is dataclasses.MISSING
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if is_needed else default,
        annotation=kind,
    )


def command(
    *functions: Callable[..., Any],
    told_when_stopped: str = RESUMES,
    needs_mujoco: bool = True,
    left_out: Sequence[str] = (),
    needed: Sequence[str] = (),
    everyday: str = "",
    **kinds: Any,
) -> Callable[[Callable[..., int | None]], Command]:
    """A decorator that makes a `Command` of what it does."""
    return lambda run: Command(
        run, functions, kinds, told_when_stopped, needs_mujoco, left_out, needed, everyday
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """A command whose second word says which of several is meant.

    Attributes:
      about: its help.
      actions: the commands by the second word.
    """

    about: str
    actions: Mapping[str, Command]

    @functools.cached_property
    def options(self) -> type[Options]:
        """The class of its options: `action`, those of the command that is meant."""
        kinds = (
            Annotated[each.options, tyro.conf.subcommand(name, constructor=each.options.parser)]
            for name, each in self.actions.items()
        )
        made: Any = dataclasses.make_dataclass(
            "Group",
            [("action", functools.reduce(operator.or_, kinds))],
            bases=(Options,),
            frozen=True,
            namespace={
                "__doc__": f"{inspect.cleandoc(self.about)}\n\nAttributes:\n  action: what to do.\n",
                "run": lambda options: options.action.run(),
                "told_when_stopped": RESUMES,
                "needs_mujoco": True,
            },
        )
        made.parser = made
        return made


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
