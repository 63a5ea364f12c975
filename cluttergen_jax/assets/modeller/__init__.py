"""Household objects made from formulas: families of shapes that bring their own convex parts.

`catalog.make_shape(family, seed)` makes one; `catalog.POOLS` lists the families of each pool. Families speak
one small language: `solids as cad` for what is seen, `parts as part` for the convex parts that go with it,
under the same names (`cad.box`, `part.box`), `palette as rgb` for colours, `draw` for what a seed varies.
"""
