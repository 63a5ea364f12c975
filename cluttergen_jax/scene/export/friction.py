"""Friction of objects that have one of their own, for simulators that combine two coefficients otherwise.

MuJoCo takes the coefficient of the object with a friction of its own (`assets.mjcf.own_contact`). Each
number here makes another simulator's combination of such an object with the support, or with an object of the
default friction, come out the same. Two objects with their own are combined by that simulator's rule.
"""

from __future__ import annotations

import math

from cluttergen_jax.assets.mjcf import own_contact
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig

_LARGEST = 100.0
"""Stands for a coefficient that a simulator's rule cannot reach."""


def friction_of(asset: ObjectAsset, contact: ContactConfig) -> tuple[float, float, float]:
    """Sliding, torsional and rolling coefficients of the object: its own, or the contact's."""
    return contact.friction if asset.friction is None else own_contact(asset.friction, contact.friction)[0]


def factor_of(wanted: float, default: float) -> float:
    """For simulators that multiply two coefficients (Bullet): all others have the default's square root."""
    return wanted / math.sqrt(default)


def mean_of(wanted: float, default: float) -> float:
    """For simulators that take the mean of two coefficients (PhysX by default); at least 0."""
    return max(2 * wanted - default, 0.0)


def harmonic_of(wanted: float, default: float) -> float:
    """For simulators that take 2 a b / (a + b) of two coefficients a, b (Drake)."""
    rest = 2 * default - wanted
    return min(wanted * default / rest, _LARGEST) if rest > 0 else _LARGEST
