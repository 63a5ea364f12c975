"""Trained proposers.

embedded: those that come with the package, by name. checkpoint: one on disk. policy: one of poses bound to a
world. guided: the draw among candidates that the stability network trusts.
"""
