"""Arguments as text, as a command line gives them: scene numbers and sizes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from numbers import Integral

from cluttergen_jax.errors import ConfigError

_MOST = 1_000_000


def parse_numbers(text: str) -> list[int] | None:
    """Scene numbers: `0,3,7-9` in order, each once; None for `all`.

    Raises:
      ConfigError: it is something else.
    """
    if text.strip() == "all":
        return None
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)(?:\s*-\s*(\d+))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if last < first:
            raise ConfigError(f"scenes = {text!r}", "numbers and ranges such as 0,3,7-9, or all")
        if last - first >= _MOST:
            raise ConfigError(f"scenes = {text!r}", f"at most {_MOST:,} numbers in a range")
        numbers += range(first, last + 1)
    return list(dict.fromkeys(numbers))


def scene_numbers(scenes: Sequence[int] | str | None) -> Sequence[int] | None:
    """Scene numbers from text or not; None for all, or where none are given.

    Raises:
      ConfigError: they are something else.
    """
    if isinstance(scenes, str):
        return parse_numbers(scenes)
    is_sequence = scenes is None or isinstance(scenes, Iterable)
    if not is_sequence or not all(isinstance(each, Integral) for each in scenes or ()):
        raise ConfigError(f"scenes = {scenes!r}", "whole numbers in a sequence", "scenes=[0, 3]")
    return scenes


def parse_size(text: str) -> tuple[int, int]:
    """Pixels of WIDTHxHEIGHT.

    Raises:
      ConfigError: it is something else.
    """
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise ConfigError(f"size = {text!r}", "WIDTHxHEIGHT in pixels, such as 1280x960")
    return int(match[1]), int(match[2])
