"""Drawing proportions: the canonical ones without a generator, varied ones with it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from cluttergen_jax.assets.modeller.solids import Painted, Rgb, piece
from cluttergen_jax.assets.shape import Provenance, Shape

T = TypeVar("T")
Rng = np.random.Generator | None
Family = Callable[[Rng], Shape]


def vary(rng: Rng, value: float, spread: float = 0.15) -> float:
    """`value` itself, or a number drawn evenly within `value * (1 +- spread)`."""
    return value if rng is None else float(value * rng.uniform(1.0 - spread, 1.0 + spread))


def choose(rng: Rng, options: Sequence[T]) -> T:
    """The first option, or one drawn evenly."""
    return options[0] if rng is None else options[int(rng.integers(len(options)))]


def shade(rng: Rng, options: Sequence[Rgb], spread: float = 0.06) -> Rgb:
    """The first colour, or one of them with each channel shifted by up to `spread`."""
    color = choose(rng, options)
    if rng is None:
        return color
    return tuple(
        float(c) for c in np.clip(np.asarray(color) + rng.uniform(-spread, spread, 3), 0.02, 0.98)
    )  # type: ignore[return-value]


def made_by(family: str) -> Provenance:
    """The provenance of everything that a family makes."""
    return Provenance(f"cluttergen_jax modeller, family {family}", "Apache-2.0")


def assemble(name: str, pieces: Iterable[Painted], label: str = "", **body: Any) -> Shape:
    """A shape of the family `name`.

    Args:
      label: what people call it; the name's words if empty.
      body: more of the shape's fields: parts, mass, cavity.
    """
    return Shape(
        name,
        label or name.replace("_", " "),
        tuple(piece(*each) for each in pieces),
        made_by(name),
        **body,
    )


def hex_rgb(code: str) -> Rgb:
    """A colour written as "rrggbb"."""
    red, green, blue = (int(pair, 16) / 255 for pair in re.findall("..", code))
    return red, green, blue


def hex_colors(codes: str) -> tuple[Rgb, ...]:
    """Colours written as "rrggbb rrggbb ..."."""
    return tuple(map(hex_rgb, codes.split()))
