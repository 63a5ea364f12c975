"""What families of objects are made with: proportions that vary, colours, and what assembles a shape."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.modeller.solids import Painted, Rgb, piece
from cluttergen_jax.assets.shape import Cavity, Provenance, Shape

T = TypeVar("T")


@dataclass(frozen=True)
class Draw:
    """Draws proportions and colours: the canonical ones without a generator, varied ones with it."""

    rng: np.random.Generator | None = None

    def __call__(self, value: float, spread: float = 0.15) -> float:
        """`value` itself, or a number drawn evenly within `value * (1 +- spread)`."""
        if self.rng is None:
            return value
        return float(value * self.rng.uniform(1.0 - spread, 1.0 + spread))

    def within(self, value: Any, low: float, high: float) -> Any:
        """`value` itself, a number or several; or as many drawn evenly from `low` to `high`."""
        return value if self.rng is None else self.rng.uniform(low, high, np.shape(value) or None)

    def choose(self, *options: T) -> T:
        """The first option, or one drawn evenly."""
        return options[0] if self.rng is None else options[int(self.rng.integers(len(options)))]

    def color(self, *options: Rgb, spread: float = 0.06) -> Rgb:
        """The first colour, or one of them with each channel shifted by up to `spread`."""
        color = self.choose(*options)
        if self.rng is None:
            return color
        shifted = np.asarray(color) + self.rng.uniform(-spread, spread, 3)
        red, green, blue = np.clip(shifted, 0.02, 0.98).tolist()
        return red, green, blue


Family = Callable[[Draw], Shape]


def assemble(
    pieces: Iterable[Painted],
    parts: Iterable[Mesh],
    mass: float,
    label: str = "",
    cavity: Cavity | None = None,
) -> Shape:
    """A shape that `make_shape` names after its family.

    Surfaces are made here, while the family still holds its solids: which of these are shared decides the
    order of their triangles.

    Args:
      pieces: solids, each with its colour.
      parts: convex collision parts.
      mass: kilograms.
      label: what people call it; the family's words if empty.
      cavity: of what is hollow.
    """
    surfaces = tuple(piece(*each) for each in pieces)
    return Shape("", label, surfaces, made_by(""), tuple(parts), cavity, mass)


def made_by(family: str) -> Provenance:
    """The provenance of everything that a family makes."""
    return Provenance(f"cluttergen_jax modeller, family {family}", "Apache-2.0")


def hex_rgb(code: str) -> Rgb:
    """A colour written as "rrggbb"."""
    red, green, blue = (int(pair, 16) / 255 for pair in re.findall("..", code))
    return red, green, blue


def hex_colors(codes: str) -> tuple[Rgb, ...]:
    """Colours written as "rrggbb rrggbb ..."."""
    return tuple(map(hex_rgb, codes.split()))


# Colours that many families share: sRGB in [0, 1].
BLACK = hex_rgb("1d1d20")
CHARCOAL = hex_rgb("38393d")
GREY = hex_rgb("85888c")
SILVER = hex_rgb("b9bdc2")
STEEL = hex_rgb("d3d6da")
WHITE = hex_rgb("f3f2ee")
PAPER = hex_rgb("f4edd8")
CREAM = hex_rgb("ecdcb4")
RED = hex_rgb("c23a31")
CRIMSON = hex_rgb("8c2331")
ORANGE = hex_rgb("e5822b")
YELLOW = hex_rgb("f2c53a")
GREEN = hex_rgb("4c9a55")
FOREST = hex_rgb("2f5d44")
TEAL = hex_rgb("2b8a8f")
BLUE = hex_rgb("2f6db5")
NAVY = hex_rgb("25386b")
SKY = hex_rgb("9fd0ec")
PURPLE = hex_rgb("6d4a93")
PINK = hex_rgb("ea8fab")
WOOD = hex_rgb("a8713f")
DARK_WOOD = hex_rgb("6a4327")
TERRACOTTA = hex_rgb("bf6a45")
GOLD = hex_rgb("d2a648")

BRIGHT = (RED, BLUE, GREEN, YELLOW, ORANGE, TEAL, PURPLE, PINK)
MUTED = (NAVY, CRIMSON, FOREST, TEAL, PURPLE, DARK_WOOD)
DARK = (CHARCOAL, BLACK, NAVY, hex_rgb("4a4d55"))
METALS = (SILVER, STEEL, GREY, GOLD)
