"""Trained policies as proposers.

embedded: those that come with the package, by name. policy: one read from a checkpoint and bound to a world.
ranked: one that ranks candidates. screened: draws of one, screened by geometry.
"""
