"""Frames, inertia, friction, numbers and XML in the forms that other programs ask for.

MuJoCo takes the friction of the object that has one of its own (`assets.mjcf.own_contact`). `factor_of`,
`mean_of` and `harmonic_of` make another simulator's combination of such an object with the support, or with
an object of the default friction, come out the same. Two objects with their own are combined by its rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.mjcf import own_contact
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig

_LARGEST = 100.0
"""Stands for a coefficient that a simulator's rule cannot reach."""


@dataclass(frozen=True, eq=False)
class Principal:
    """A body's inertia along its principal axes.

    Attributes:
      center: f64[3], the centre of mass in the object frame, metres.
      turn: f64[4], the principal frame in the object frame, wxyz.
      moments: f64[3], kg m^2.
    """

    center: np.ndarray
    turn: np.ndarray
    moments: np.ndarray


def principal_of(asset: ObjectAsset) -> Principal:
    """The principal frame of an asset: of the 24 the one that is turned least from the object frame."""
    moments, axes = np.linalg.eigh(np.asarray(asset.inertia, np.float64))
    _, order = linear_sum_assignment(-np.abs(axes))
    moments = moments[order]
    axes = axes[:, order]
    axes *= np.where(np.diag(axes) < 0, -1.0, 1.0)
    axes[:, np.argmin(np.diag(axes))] *= np.sign(np.linalg.det(axes))
    turn = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return Principal(np.asarray(asset.center_of_mass, np.float64), turn, moments)


def euler_of(quaternion: np.ndarray) -> np.ndarray:
    """f64[3]: roll, pitch and yaw about fixed axes, radians, of a quaternion wxyz (URDF's `rpy`)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_euler("xyz")


def text(values: Sequence[float] | np.ndarray) -> str:
    """Numbers with the nine digits that a float32 needs, parted by blanks."""
    return " ".join(f"{value:.9g}" for value in np.asarray(values, np.float64).ravel() + 0.0)


def xml_bytes(root: ET.Element) -> bytes:
    """An XML file, indented, behind a declaration."""
    ET.indent(root)
    return b'<?xml version="1.0"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def friction_of(asset: ObjectAsset, contact: ContactConfig) -> tuple[float, float, float]:
    """Sliding, torsional and rolling coefficients of the object: its own, or the contact's."""
    return (
        contact.friction
        if asset.friction is None
        else own_contact(asset.friction, contact.friction)[0]
    )


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
