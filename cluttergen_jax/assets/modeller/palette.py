"""Colours that many families share: sRGB in [0, 1]."""

from __future__ import annotations

from cluttergen_jax.assets.modeller.draw import hex_rgb

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
