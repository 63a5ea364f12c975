"""Household objects made from formulas: families of shapes that bring their own convex parts.

`catalog.make_shape(family, seed)` makes one; `catalog.POOLS` lists the families of each pool.
"""
