"""Frames, inertia, numbers and XML in the forms that other programs ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.object import ObjectAsset


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
    moments, axes = moments[order], axes[:, order]
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
