"""What is told of an object without reading its meshes, and choosing objects of a pool by it."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import msgspec
import numpy as np

from cluttergen_jax.assets.nouns import SYNSET, is_below
from cluttergen_jax.errors import ConfigError, closest, first_names
from cluttergen_jax.graspable import graspable_names

if TYPE_CHECKING:
    from cluttergen_jax.assets.object import ObjectAsset


FACTS_FORMAT = 2
"""Of the facts that are stored beside objects; those of another format are measured again.

1 was never written down: its volumes were all zero.
"""
_VOLUMES: WeakKeyDictionary[ObjectAsset, float] = WeakKeyDictionary()
"""Of objects whose volume was asked for."""


class ObjectFacts(msgspec.Struct, frozen=True, omit_defaults=True):
    """An object of a pool in numbers and words.

    Attributes:
      name: of the object.
      label: what people call it.
      size: metres, the sides of its box, x, y, z.
      volume: cubic metres of the object's material (`object_volume`).
      mass: kilograms.
      licence, source: of its file.
      parts: number of convex parts.
      flagged: something was found that a user should look at.
      synset: what kind of thing it is (`Shape.synset`); empty if unknown.
    """

    name: str
    label: str
    size: tuple[float, float, float]
    volume: float
    mass: float
    licence: str
    source: str
    parts: int
    flagged: bool
    synset: str = ""

    @staticmethod
    def of(asset: ObjectAsset) -> ObjectFacts:
        """Those of an object at hand."""
        x, y, z = np.round(2 * asset.half_extents, 6).tolist()
        return ObjectFacts(
            name=asset.name,
            label=asset.label,
            size=(x, y, z),
            volume=object_volume(asset),
            mass=float(asset.mass),
            licence=asset.provenance.licence,
            source=asset.provenance.source,
            parts=len(asset.parts),
            flagged=bool(asset.flags),
            synset=asset.synset,
        )


def object_volume(asset: ObjectAsset) -> float:
    """Cubic metres of an object's material, to four digits: of a bowl, the volume of its wall.

    Where all its surfaces are closed, flat ones such as stickers aside, it is the space that they enclose;
    else what its convex parts fill. Either way each place counts once, however many surfaces or parts overlap
    there, and a void that is closed on all sides counts as filled, as it does for the mass.
    """
    if asset not in _VOLUMES:
        _VOLUMES[asset] = float(f"{_measured_volume(asset):.4g}")
    return _VOLUMES[asset]


def _measured_volume(asset: ObjectAsset) -> float:
    from cluttergen_jax.assets.object_files import stored_mesh
    from cluttergen_jax.assets.solid import as_manifold, enclosed_volume, union_volume

    # As they are on disk, so that an object has one volume before it is written and after it was read.
    surfaces = [stored_mesh(piece) for piece in asset.pieces if not piece.is_flat]
    volume = enclosed_volume(surfaces)
    if volume is None:
        volume = union_volume([as_manifold(part.hull()) for part in asset.parts])
    return volume


_TEXTS: dict[str, Callable[[ObjectFacts], str]] = {
    name: operator.attrgetter(name) for name in ("name", "label", "synset", "licence", "source")
}
_NUMBERS: dict[str, Callable[[ObjectFacts], float]] = {
    **{name: operator.attrgetter(name) for name in ("volume", "mass", "parts", "flagged")},
    "x": lambda each: each.size[0],
    "y": lambda each: each.size[1],
    "height": lambda each: each.size[2],
    "width": lambda each: max(each.size[:2]),
    "depth": lambda each: min(each.size[:2]),
}
_SIGNS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
    "=": operator.eq,
}
GRASPABLE = "graspable"
"""The field of a term that `graspable_names` answers."""
_TERM = re.compile(r"\s*([a-z]+)\s*(<=|>=|<|>|=)\s*(.+?)\s*")
_HINT = "'mug* and volume<0.001', or 'label=*book* and height>=0.1'"
Test = Callable[[ObjectFacts], bool]


def _split_graspable(text: str) -> tuple[list[str], str]:
    """The robots of its terms "graspable=ROBOT", and the text without these terms."""
    robots = []
    others = []
    for term in re.split(r"\s+and\s+", text.strip()):
        match = _TERM.fullmatch(term)
        if match is None or match.group(1) != GRASPABLE:
            others.append(term)
        elif match.group(2) != "=":
            raise ConfigError(f"{term!r}", f"{GRASPABLE}=ROBOT", f"{GRASPABLE}=panda")
        else:
            robots.append(match.group(3))
    return robots, " and ".join(others)


def parse_condition(text: str) -> Test:
    """What tells whether an object is meant by a text such as "mug* and volume<0.001".

    Terms are joined by "and". A term is a pattern of a name, in which * stands for any letters; a noun of
    WordNet such as cup.n.01, which means all kinds of it by synset or label; a pattern of a text, such as
    label=*book*; or a comparison of a number, in metres, cubic metres or kilograms.

    Raises:
      ConfigError: a term is none; the message names what can be compared.
    """
    tests = [_parse_term(term) for term in re.split(r"\s+and\s+", text.strip())]
    return lambda each: all(test(each) for test in tests)


def _parse_term(term: str) -> Test:
    match = _TERM.fullmatch(term)
    if match is None:
        if not term or re.search(r"[<>=\s]", term):
            raise _no_term(term)
        if SYNSET.fullmatch(term):
            return lambda each: is_below(each.synset, each.label or each.name, term)
        return lambda each: fnmatchcase(each.name, term)
    field, sign, value = match.groups()
    if field == GRASPABLE:
        raise ConfigError(
            f"{term!r} here", "in a choice of a pool's objects alone", f"objects=({term!r},)"
        )
    if field in _TEXTS:
        if sign != "=":
            raise ConfigError(f"{term!r}", f"{field}=PATTERN", _HINT)
        pattern = value.lower()
        return lambda each: fnmatchcase(_TEXTS[field](each).lower(), pattern)
    if field not in _NUMBERS:
        raise _no_term(term, field, closest(field, [*_TEXTS, *_NUMBERS, GRASPABLE]))
    try:
        number = float(value)
    except ValueError:
        raise ConfigError(f"{value!r} in {term!r}", "a number", _HINT) from None
    return lambda each: _SIGNS[sign](_NUMBERS[field](each), number)


def _no_term(term: str, field: str = "", meant: str = "") -> ConfigError:
    fields = ", ".join([*_TEXTS, *_NUMBERS, GRASPABLE])
    allowed = f"a name, a pattern such as mug*, or a comparison of {fields}"
    given = f"{term!r} in a choice of objects"
    given = f"{field!r} of {given}" if field else given
    return ConfigError(given, allowed, _HINT, meant)


def is_plain_name(text: str) -> bool:
    """Whether a text is an object's name, and no pattern or condition."""
    return re.fullmatch(r"[a-z0-9_-]+", text) is not None


def chosen_names(facts: Sequence[ObjectFacts], chosen: Iterable[str], pool: str) -> tuple[str, ...]:
    """Names of a pool's objects that texts choose: names as they are, then all others in the pool's order.

    Args:
      chosen: names, patterns and conditions (`parse_condition`); an object is meant if one of them means it.
        Here a term may also be graspable=ROBOT, what a hand can hold; it is asked last.
      pool: by which `graspable_names` finds it.

    Raises:
      ConfigError: a text chooses nothing, or is not understood.
    """
    names: dict[str, None] = {}
    for text in chosen:
        if is_plain_name(text):
            names[text] = None
            continue
        robots, rest = _split_graspable(text)
        test = parse_condition(rest if rest or not robots else "*")
        found = [each.name for each in facts if test(each)]
        for robot in robots if found else ():
            found = list(graspable_names(pool, found, robot))
        if not found:
            raise _no_choice(f"{text!r} chooses no object of pool {pool!r}", text, facts)
        names |= dict.fromkeys(found)
    return tuple(names)


def _no_choice(given: str, text: str, facts: Sequence[ObjectFacts]) -> ConfigError:
    """The error for a condition that no object fulfils: it names some, and the most similar one."""
    names = [each.name for each in facts]
    allowed = f"what one of its objects fulfils: {first_names(names, _MOST_NAMED)}"
    return ConfigError(
        given, allowed, f"'{names[0]}', or 'height>0'", closest(text.strip("*?"), names)
    )


_MOST_NAMED = 12
_WEIGHTS = "weights='*=3', or 'height>=0.1=2'"


def parse_weights(text: str) -> tuple[tuple[str, float], ...]:
    """Conditions and weights of a text such as "mug*=3; label=*book*=0.5"."""
    found = []
    for term in filter(str.strip, text.split(";")):
        condition, _, number = term.rpartition("=")
        try:
            weight = float(number)
        except ValueError:
            weight = -1.0
        is_field = condition.strip() in (*_TEXTS, *_NUMBERS)
        if not condition.strip() or is_field or not 0 <= weight < float("inf"):
            raise ConfigError(
                f"weight {term!r}", "CONDITION=NUMBER, 0 or more, joined by ';'", _WEIGHTS
            )
        parse_condition(condition)
        found.append((condition.strip(), weight))
    return tuple(found)


def weights_of(facts: Sequence[ObjectFacts], weights: Sequence[tuple[str, float]]) -> np.ndarray:
    """f64[N]: by which objects are drawn: the product of the weights whose condition they fulfil, else 1.

    Raises:
      ConfigError: a condition fits nothing.
    """
    result = np.ones(len(facts))
    for condition, weight in weights:
        test = parse_condition(condition)
        is_meant = np.array([test(each) for each in facts])
        if not is_meant.any():
            raise _no_choice(f"weight of {condition!r}, which no object fulfils", condition, facts)
        result[is_meant] *= weight
    return result
