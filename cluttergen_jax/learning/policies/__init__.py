"""Trained policies as proposers.

embedded: those that come with the package, by name. checkpoint: one on disk. policy: one bound to a world,
alone or filtered by geometry.
"""
