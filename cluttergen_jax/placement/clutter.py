"""Clutter targets: how much of which feature a scene should have (`--clutter stack=3,near=0.02`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from numbers import Real

from cluttergen_jax.errors import ConfigError, closest

_EXAMPLE = "clutter='stack=3,occlusion=0.2'"


@dataclass(frozen=True)
class Clutter:
    """Targets of a scene's features; None asks for nothing. Scenes of N objects.

    Attributes:
      stack: objects that rest on another object, 0 to N - 1.
      contained: objects inside of a hollow other one, 0 to N - 1 (`placement.containers`).
      depth: the sum over all objects of how many others are below each, one upon the other; a tower of three
        counts 0 + 1 + 2.
      contacts: pairs of objects that touch, 0 to N (N - 1) / 2.
      near: metres, 0 to 1, the mean over all objects of the gap in plan to the nearest other one
        (`placement.boxes.gaps`).
      occlusion: 0 to 1, the mean share of an object that others hide from a ring of eight cameras that look
        down by 30 degrees (`placement.boxes.hidden_shares`).
      side: pairs of objects that touch from the side, for each object of the scene, 0 to (N - 1) / 2.
      lean: 0 to 1, the share of the objects that are tilted by more than 5 degrees against how they stand.
    """

    stack: float | None = None
    contained: float | None = None
    depth: float | None = None
    contacts: float | None = None
    near: float | None = None
    occlusion: float | None = None
    side: float | None = None
    lean: float | None = None

    @staticmethod
    def of(given: str | Mapping[str, float] | Clutter) -> Clutter:
        """From text, "stack=3,near=0.02", or a mapping of names to numbers.

        Raises:
          ConfigError: a name is unknown or comes twice, or a value is no number of its range.
        """
        if isinstance(given, Clutter):
            given = given.targets
        if isinstance(given, str):
            given = _parse_text(given)
        if not isinstance(given, Mapping):
            raise ConfigError(
                f"clutter = {given!r}", "text or a mapping of names to numbers", _EXAMPLE
            )
        if not any(value is not None for value in given.values()):
            raise ConfigError(
                "clutter that asks for nothing", f"one or more of {', '.join(NAMES)}", _EXAMPLE
            )
        for name in given:
            if name not in NAMES:
                raise ConfigError(
                    f"clutter {name!r}", ", ".join(NAMES), _EXAMPLE, closest(name, NAMES)
                )
        return Clutter(**{name: _check_value(name, value) for name, value in given.items()})

    @property
    def targets(self) -> dict[str, float]:
        """What is asked for, by name."""
        named = {name: getattr(self, name) for name in NAMES}
        return {name: value for name, value in named.items() if value is not None}

    @property
    def for_draw(self) -> Clutter | None:
        """What the draw of a place can bring about: all but `CROWDED`; None where nothing is left."""
        rest = replace(self, **dict.fromkeys(CROWDED))
        return rest if rest.targets else None

    def check(self, num_objects: int) -> None:
        """Refuses what no scene of so many objects can have (ConfigError)."""
        pairs = num_objects * (num_objects - 1) // 2
        most = {
            "stack": num_objects - 1,
            "contained": num_objects - 1,
            "depth": pairs,
            "contacts": pairs,
            "side": (num_objects - 1) / 2,
        }
        for name, value in self.targets.items():
            if value > most.get(name, math.inf):
                given = f"clutter {name}={value:g} with {num_objects} objects"
                allowed = f"0 to {most[name]:g}"
                raise ConfigError(given, allowed, f"clutter='{name}={most[name]:g}'")

    def __str__(self) -> str:
        return ",".join(f"{name}={value:g}" for name, value in self.targets.items())


NAMES = tuple(each.name for each in fields(Clutter))
CROWDED = ("side", "lean")
"""Features of what is drawn together once all objects stand (`placement.crowd`)."""
_MOST = {"near": 1.0, "occlusion": 1.0, "lean": 1.0}
_ALLOWED = {"near": "0 to 1 m", "occlusion": "0 to 1", "lean": "0 to 1"}


def _parse_text(text: str) -> dict[str, float]:
    targets: dict[str, float] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        name, equals, value = (each.strip() for each in part.partition("="))
        if not equals:
            raise ConfigError(f"clutter {part!r}", "NAME=VALUE, with commas between", _EXAMPLE)
        if name in targets:
            raise ConfigError(
                f"clutter {text!r}, where {name} comes twice", "every name once", _EXAMPLE
            )
        try:
            targets[name] = float(value)
        except ValueError:
            raise ConfigError(f"clutter {part!r}", "a number after the =", _EXAMPLE) from None
    return targets


def _check_value(name: str, value: object) -> float | None:
    if value is None:
        return None
    allowed = _ALLOWED.get(name, "a finite number, 0 or more")
    if not isinstance(value, Real) or isinstance(value, bool):
        raise ConfigError(f"clutter {name}={value!r}", allowed, _EXAMPLE)
    number = float(value)
    if not 0 <= number <= _MOST.get(name, math.inf) or math.isinf(number):
        raise ConfigError(f"clutter {name}={value!r}", allowed, _EXAMPLE)
    return number
