"""Small grammars of the command line: scene numbers, sizes, options that do not go together."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

from cluttergen_jax.cli.flags import ARGUMENTS
from cluttergen_jax.errors import ConfigError

_MOST = 1_000_000


def parse_numbers(text: str | None) -> list[int] | None:
    """Scene numbers: `0,3,7-9` in order, each once; None and `all` are all.

    Raises:
      ConfigError: it is something else.
    """
    if text is None or text.strip() == "all":
        return None
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:\s*-\s*(\d+))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if last < first:
            raise ConfigError(f"--scenes {text!r}", "numbers and ranges such as 0,3,7-9, or all")
        if last - first >= _MOST:
            raise ConfigError(f"--scenes {text!r}", f"at most {_MOST:,} numbers in a range")
        numbers += range(first, last + 1)
    return list(dict.fromkeys(numbers))


def parse_size(text: str) -> tuple[int, int]:
    """Pixels of WIDTHxHEIGHT.

    Raises:
      ConfigError: it is something else.
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise ConfigError(f"--size {text!r}", "WIDTHxHEIGHT in pixels, such as 1280x960")
    return int(match[1]), int(match[2])


def keywords(command: Any, without: Sequence[str] = ()) -> dict[str, Any]:
    """A command's options as keyword arguments of its function."""
    return {
        ARGUMENTS.get(field.name, field.name): getattr(command, field.name)
        for field in dataclasses.fields(command)
        if field.name not in without
    }


def refuse_given(command: Any, names: Sequence[str], where: str, hint: str) -> None:
    """Refuses options of a command that are not at their defaults and would not count.

    Raises:
      ConfigError: it names them.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(command)}
    given = [name for name in names if getattr(command, name) != defaults[name]]
    if given:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise ConfigError(f"{flags} {where}", hint=hint)
