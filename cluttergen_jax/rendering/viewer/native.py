"""MuJoCo's own viewer on a scene: a window, simulated, to be pushed about with the mouse."""

from __future__ import annotations

import os
import platform

import mujoco
import numpy as np

from cluttergen_jax.errors import ClutterGenError


class DisplayError(ClutterGenError):
    """There is no screen to open a window on."""


def check_display() -> None:
    """Refuses to open a window where there is no screen (DisplayError: there is none)."""
    if platform.system() == "Linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise DisplayError(
            "MuJoCo's viewer needs a screen, and there is none (DISPLAY is not set)",
            hint="the web viewer, which is the same command without `native`, or ssh -X",
        )


def show_native(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Opens MuJoCo's viewer and returns when its window is closed.

    Args:
      model: of the scene; qpos: f64[nq], as it begins.

    Raises:
      DisplayError: there is no screen, or no window can be opened on it.
    """
    check_display()
    import mujoco.viewer

    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    try:
        mujoco.viewer.launch(model, data)
    except (RuntimeError, mujoco.FatalError) as error:
        raise DisplayError(
            f"MuJoCo's viewer could not open a window ({error})", hint="the web viewer: leave `native` out"
        ) from error
