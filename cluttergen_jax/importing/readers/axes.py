"""Which way is up in a file, who says so, and the turn that makes it z."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cluttergen_jax.errors import ConfigError

AUTO = "auto"
FILE = "file"
AXES = ("x", "y", "z", "-x", "-y", "-z")
_VECTORS = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[index]
    for sign in ("", "-")
    for index, name in enumerate("xyz")
}


@dataclass(frozen=True)
class UpAxis:
    """The axis that was taken for up, and why, in words."""

    axis: str
    reason: str


def own_up(path: Path, kind: str) -> UpAxis:
    """What a file says about its vertical axis, or else its format.

    Args:
      kind: "mesh", "urdf", "sdf" or "mjcf".
    """
    if kind != "mesh":
        return UpAxis("z", f"{kind.upper()}'s standard")
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        return UpAxis("y", "GLTF's standard")
    if suffix == ".dae":
        declared = re.search(rb"<up_axis>\s*([XYZ])_UP", path.read_bytes())
        if declared:
            return UpAxis(declared.group(1).decode().lower(), "the file's declaration")
        return UpAxis("y", "COLLADA's standard")
    return UpAxis("z", f"by default: {suffix[1:].upper()} does not say")


def check_axes(up: str, front: str) -> None:
    """Raises ConfigError if these are no axes, or not at a right angle."""
    for name, axis in (("up", up), ("front", front)):
        words = (AUTO, FILE) if name == "up" else (AUTO,)
        if axis not in (*words, *AXES):
            raise ConfigError(f"{name} = {axis!r}", ", ".join((*words, *AXES)))
    if {up, front} <= set(AXES) and up[-1] == front[-1]:
        raise ConfigError(f"up = {up!r} with front = {front!r}", "two axes at a right angle")


def turn_of(up: str, front: str = AUTO) -> np.ndarray:
    """f64[3, 3]: the rotation that takes a file's `up` to z and its `front` to x.

    Raises:
      ConfigError: they are not at a right angle.
    """
    if front == AUTO:
        front = "-y" if up.endswith("x") else "x"
    check_axes(up, front)
    z, x = _VECTORS[up], _VECTORS[front]
    return np.array([x, np.cross(z, x), z])
