"""Placing by hand: a scene that a person fills by the rules that methods obey, and the time they take.

scene: what a person may do. types: what they hold and are told. clock: the seconds that count.
"""

from cluttergen_jax.placement.hand.scene import HandError, HandScene

__all__ = ["HandError", "HandScene"]
