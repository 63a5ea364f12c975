"""The library speaks of Python arguments; here these become the flags of the command that is run."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any, get_args

from cluttergen_jax.errors import ClutterGenError

RENAMED = {
    "attempts": "max_attempts",
    "threads": "num_threads",
    "for": "for_engine",
    "all": "take_all",
}
"""Options as they were called before each had the name of its argument, and their arguments."""
_VALUE = r"""'[^']*'|"[^"]*"|\([^()]*\)|\[[^][]*\]|[\w.+-]*[\w+-]"""


def options_of(command: Any) -> Iterator[str]:
    """The options of a command's class, those of its nested settings among them; positional ones are none."""
    for field in dataclasses.fields(command):
        if dataclasses.is_dataclass(field.default):
            yield from options_of(field.default)
        elif "Positional" not in str(field.type):
            yield field.name


def options_known(command: Any) -> set[str]:
    """The options of a command's class; of one whose second word says which is meant, those of them all."""
    if not dataclasses.is_dataclass(command):
        return set()
    kinds = [kind for field in dataclasses.fields(command) for kind in get_args(field.type)]
    several = [get_args(kind)[0] for kind in kinds if get_args(kind)]
    commands = [command, *filter(dataclasses.is_dataclass, several)]
    return {name for each in commands for name in options_of(each)}


def error_with_flags(error: ClutterGenError, command: Any) -> str:
    """The text of an error with the flags of a command that was run.

    What is said to be given is said of the user's words: of an option that is at its default this is told.

    Args:
      command: an instance, with its options as they were given.
    """
    kind = type(command)
    text = str(error)
    flags = {name: _flag_name(name) for name in options_of(kind)}
    given = with_flags(error.given, kind)
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        name = flags.get(field.name)
        if name is None or field.default is dataclasses.MISSING or value != field.default:
            continue

        def with_note(found: re.Match[str], default: object = value) -> str:
            return f"{found[0]} ({'the default' if found[1] == str(default) else 'not given'})"

        given = re.sub(rf"--{name} ([^\s,;:()-][^\s,;:()]*)(?![\w(])", with_note, given)
    return given + with_flags(text.removeprefix(error.given), kind)


def _flag_name(argument: str) -> str:
    return argument.replace("_", "-")


def flag_of(argument: str) -> str:
    """The option of an argument: every option is called as its argument is."""
    return f"--{_flag_name(argument)}"


def with_new_names(words: Sequence[str], known: Collection[str]) -> tuple[list[str], list[str]]:
    """The words of a command line with today's names of options that have been renamed, and a note for each.

    Args:
      known: the options that the command has, as arguments.
    """
    found = []
    notes = []
    for word in words:
        flag, sign, value = word.partition("=")
        match = re.fullmatch(r"--(no-)?([a-z-]+)", flag)
        new = RENAMED.get(match[2].replace("-", "_")) if match else None
        if match and new is not None and new in known and match[2] not in known:
            renamed = f"--{match[1] or ''}{_flag_name(new)}"
            notes.append(f"{flag} is now called {renamed}")
            flag = renamed
        found.append(f"{flag}{sign}{value}")
    return found, notes


def with_flags(text: str, command: Any) -> str:
    """A text with the flags of `command` in place of the arguments that it names.

    Arguments stand in backticks (`num_threads`), with what was given (num_threads = -1), or with what to give
    (num_threads=0); a class before the name (View.azimuth = 500) is left out. Whatever the command has no
    option for stays as it is, and so does what is quoted of an XML file.
    """
    flags = {name: _flag_name(name) for name in options_of(command)}
    if not flags:
        return text
    names = "|".join(flags)
    text = re.sub(rf"`({names})`", lambda found: f"--{flags[found[1]]}", text)
    return re.sub(
        rf"<\w[^<>]*>|(?<![\w./=-])(?:[A-Z]\w*\.)?({names})(?: = |=)({_VALUE})",
        lambda found: _flag(flags[found[1]], found[2]) if found[1] else found[0],
        text,
    )


def option_help(text: str, command: Any) -> str:
    """What a docstring says of an argument as help for the option: with flags, and words without quotes."""
    return re.sub(r'"([^"\s]*)"', r"\1", with_flags(" ".join(text.split()), command))


def _flag(flag: str, value: str) -> str:
    """An option with a value as it is written on a command line."""
    if value in ("True", "False"):
        return f"--{flag}" if value == "True" else f"--no-{flag}"
    words = re.split(r",\s*", value[1:-1].strip(",")) if value[0] in "([" else [value]
    plain = [word.strip("'\"") for word in words]
    return " ".join(
        [f"--{flag}", *(f"'{word}'" if " " in word else word for word in plain)]
    ).rstrip()
