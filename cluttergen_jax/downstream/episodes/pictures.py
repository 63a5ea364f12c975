"""Pictures of a running episode."""

from __future__ import annotations

import atexit
import weakref
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.errors import ConfigError, closest

DRAWN_GROUP = 2
"""Of geoms that are drawn (`assets.VISUAL_GROUP`); others only collide."""


def check_cameras(model: mujoco.MjModel, names: tuple[str, ...], prefix: str) -> None:
    """Refuses cameras that the model has not, with or without the robot's prefix (ConfigError)."""
    known = [model.camera(number).name for number in range(model.ncam)]
    for name in names:
        if name not in known and prefix + name not in known:
            short = [each.removeprefix(prefix) for each in known]
            raise ConfigError(f"camera {name!r}", ", ".join(short), meant=closest(name, short))


class Pictures:
    """Draws a model with a GL context of its own; nothing is opened before the first picture.

    Args:
      model: whose cameras; prefix: of those of the robot.
      height, width: pixels. new_context: makes a GL context of so many pixels, width first, current.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        height: int,
        width: int,
        prefix: str,
        new_context: Callable[[int, int], Any],
    ) -> None:
        self._model = model
        self._new_context = new_context
        self._prefix = prefix
        self._rect = mujoco.MjrRect(0, 0, width, height)
        shown = model.vis.global_
        shown.offwidth = max(shown.offwidth, width)
        shown.offheight = max(shown.offheight, height)
        self._gl: Any = None

    def _open(self) -> None:
        gl = self._new_context(self._rect.width, self._rect.height)
        # Registered after the library's own end, so it comes before that.
        atexit.register(_close, weakref.ref(self))
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        self._gl = gl
        self._scene = mujoco.MjvScene(self._model, maxgeom=self._model.ngeom + 100)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[DRAWN_GROUP] = 1

    def draw(self, data: mujoco.MjData, name: str) -> np.ndarray:
        """u8[height, width, 3]: what the camera of this name sees.

        Raises:
          RendererError: nothing here can draw.
        """
        if self._gl is None:
            self._open()
        self._gl.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        number = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        camera.fixedcamid = number if number >= 0 else self._model.camera(self._prefix + name).id
        # Cameras on links, too, are where the joints say now.
        mujoco.mj_camlight(self._model, data)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, camera, everything, self._scene
        )
        pixels = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._context)
        return np.flipud(pixels).copy()

    def close(self) -> None:
        """Gives the context back; the next picture opens another."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None


def _close(pictures: weakref.ref[Pictures]) -> None:
    if (there := pictures()) is not None:
        there.close()
