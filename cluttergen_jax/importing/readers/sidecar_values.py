"""Values of JSON as options of reading: factors, masses, axes and words; and which keys speak of them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from cluttergen_jax.importing.readers.source import AXES

Option = TypeVar("Option", float, str)
WORDS = ("label", "synset", "licence", "attribution")
UNIT = "unit"
_NUMBERS = ("mass", "density", "friction")
_MAX_WORD = 300
"""Letters of a label or a licence."""
_MAX_SHOWN = 60
"""Letters of a value in a message."""
_MAX_DEPTH = 4
"""So deep, and in so many values, a JSON of no known set is searched."""
_MAX_VALUES = 10_000
_NEAR = 1e-3
"""Factors of one object differ by rounding, and a direction is along an axis, within this share."""


def _number(value: Any) -> float:
    """A finite number; ValueError says what is given instead."""
    try:
        number = (
            float(value)
            if isinstance(value, int | float | str) and not isinstance(value, bool)
            else None
        )
    except (ValueError, OverflowError):
        number = None
    if number is None or not math.isfinite(number):
        raise ValueError("it is no finite number")
    return number


def positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError("it is not above zero")
    return number


def scale_of(value: Any) -> tuple[float, tuple[float, float, float]]:
    """A factor, and factors along x, y and z beside it, of product 1."""
    if not isinstance(value, list):
        return positive(value), (1.0, 1.0, 1.0)
    if len(value) not in (1, 3):
        raise ValueError("one factor, or three, are asked for")
    factors = [positive(each) for each in value]
    if max(factors) <= min(factors) * (1 + _NEAR):
        return factors[0], (1.0, 1.0, 1.0)
    mean = float(np.prod(factors) ** (1 / 3))
    if not 0 < mean < math.inf:
        raise ValueError("it is no factor")
    x, y, z = (each / mean for each in factors)
    return mean, (x, y, z)


_AXIS = re.compile(r"([+-]?)([xyz])(?:[-_ ]?(?:up|axis|forward))?")


def _axis(value: Any) -> str:
    """One of `AXES`, from a name or a direction."""
    if isinstance(value, str) and (named := _AXIS.fullmatch(value.strip().lower())):
        return named[1].replace("+", "") + named[2]
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"it is neither one of {', '.join(AXES)} nor a direction of 3 numbers")
    vector = np.array([_number(each) for each in value])
    length = float(np.linalg.norm(vector))
    main = int(np.abs(vector).argmax())
    if not 0 < length < math.inf or abs(vector[main]) < (1 - _NEAR) * length:
        raise ValueError("it is along none of the file's axes")
    return ("-" if vector[main] < 0 else "") + "xyz"[main]


def _word(value: Any) -> str:
    text = " ".join(value.split()) if isinstance(value, str) else ""
    text = "".join(each for each in text if each.isprintable())[:_MAX_WORD]
    if not text:
        raise ValueError("it is no text")
    return text


def is_same(value: Any, plain: Any) -> bool:
    """Whether two JSON values are equal, numbers nearly."""
    if isinstance(value, list) and isinstance(plain, list):
        return len(value) == len(plain) and all(
            is_same(*pair) for pair in zip(value, plain, strict=True)
        )
    try:
        return math.isclose(_number(value), _number(plain), abs_tol=1e-9)
    except ValueError:
        return bool(value == plain)


def short_text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    text = "".join(each if each.isprintable() else "?" for each in text)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_OF_OTHERS = frozenset(
    {
        "log",
        "down",
        "upscale",
        "texture",
        "textures",
        "normal",
        "uv",
        "gray",
        "grey",
        "color",
        "colour",
        "emission",
        "alpha",
        "opacity",
    }
    | {"loss", "depth", "camera", "image", "light", "font", "time", "ui", "icon", "text", "line"}
    | {
        "center",
        "centre",
        "com",
        "inertia",
        "class",
        "sample",
        "price",
        "version",
        "test",
        "random",
    }
    | {"min", "max", "confidence", "id", "ids"}
)
"""Words of keys whose scale, weight or unit is not that of an object."""
_LENGTHS = {
    **dict.fromkeys(("mm", "millimeter", "millimetre"), 0.001),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 0.01),
    **dict.fromkeys(("dm", "decimeter", "decimetre"), 0.1),
    **dict.fromkeys(("m", "meter", "metre"), 1.0),
    **dict.fromkeys(("in", "inch", "inche"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
    **dict.fromkeys(("um", "micron", "micrometer", "micrometre"), 1e-6),
    **dict.fromkeys(("km", "kilometer", "kilometre"), 1000.0),
}


_LENGTH_WORDS = frozenset({"unit", "units", "meter", "meters", "metre", "metres"})
_AXIS_WORDS = frozenset({"up", "axis", "vector", "dir", "direction", "world", "orient", *"xyz"})


def physical_values(entry: Any) -> Iterator[tuple[str, str, Any, float | str | None]]:
    """Which option a value of a JSON speaks of, its key, itself, and what the option would be, if known."""
    for key, value in _leaves(entry):
        *above, words = [[each.lower() for each in _WORD.findall(step)] for step in key.split("/")]
        kinds = {
            "".join(words).removesuffix("scale"),
            *words,
            *(each for step in above for each in step),
        }
        if words and value is not None and not isinstance(value, dict) and not _OF_OTHERS & kinds:
            yield from ((name, key, value, option) for name, option in _options(words, value))


def _options(words: list[str], value: Any) -> Iterator[tuple[str, float | str | None]]:
    """The option that a key of these words speaks of, and what its value makes of it."""
    joined = "".join(words)
    kinds = set(words)
    is_factor = bool({"per", "to"} & kinds and _LENGTH_WORDS & kinds)
    if is_factor or "scales" in kinds or joined.endswith(("scale", "scaling")) or "scale" in kinds:
        unit = _length(value) if isinstance(value, str) else None
        if _is_figure(value) and not _asks_for_nothing(value):
            yield "scale", _or_none(_scale_alone, value)
        elif unit not in (None, 1.0):
            yield "scale", unit
    elif {"mass", "weight"} & kinds or joined.rstrip("kg") in ("mass", "weight"):
        if _is_figure(value):
            kilograms = _or_none(positive, value)
            yield (
                "mass",
                kilograms / 1000 if kilograms and {"g", "gram", "grams"} & kinds else kilograms,
            )
    elif "up" in kinds and kinds <= _AXIS_WORDS:
        named = next((each for each in words if each in ("x", "y", "z")), "")
        if not named:
            yield "up", _or_none(_axis, value)
        elif value is True:
            yield "up", named
    elif {"unit", "units"} & kinds and (factor := _length(value)) not in (None, 1.0):
        yield "scale", factor


def _is_figure(value: Any) -> bool:
    """Whether a value is meant as a number, or as several: NaN and "0.3 kg" are."""
    if isinstance(value, list):
        return 0 < len(value) <= 16 and all(_is_figure(each) for each in value)
    if isinstance(value, str):
        return re.match(r"\s*[-+]?(\.?\d|nan|inf)", value.lower()) is not None
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scale_alone(value: Any) -> float:
    factor, stretch = scale_of(value)
    if stretch != (1.0, 1.0, 1.0):
        raise ValueError("three factors")
    return factor


def _asks_for_nothing(value: Any) -> bool:
    try:
        return scale_of(value) == (1.0, (1.0, 1.0, 1.0))
    except ValueError:
        return False


def _or_none(make: Callable[[Any], Option], value: Any) -> Option | None:
    try:
        return make(value)
    except ValueError:
        return None


def _length(value: Any) -> float | None:
    """Metres of a unit of length, by its name or as a number; None if it is none."""
    if isinstance(value, str) and (word := value.strip().lower()):
        return _LENGTHS.get(word, _LENGTHS.get(word.rstrip("s")))
    try:
        return None if isinstance(value, str) else positive(value)
    except ValueError:
        return None


def _leaves(value: Any) -> Iterator[tuple[str, Any]]:
    """Keys of a document, those inside others with / between, and their values."""
    rest = [("", value, 0)]
    count = 0
    while rest and count < _MAX_VALUES:
        above, table, depth = rest.pop()
        count += 1
        if not isinstance(table, dict):
            continue
        for key, each in list(table.items())[:_MAX_VALUES]:
            path = f"{above}{key}"
            yield path, each
            if isinstance(each, dict) and depth < _MAX_DEPTH:
                rest.append((f"{path}/", each, depth + 1))


def _unit(value: Any) -> float:
    factor = _length(value)
    if factor is None:
        raise ValueError("it is no unit of length")
    return factor


VALUES: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("up", "front"), _axis),
    **dict.fromkeys(_NUMBERS, positive),
    **dict.fromkeys(WORDS, _word),
    UNIT: _unit,
}
"""By name, what makes an option of a value; ValueError says why it is none. For scale see `scale_of`."""
