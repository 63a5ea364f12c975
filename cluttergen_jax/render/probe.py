"""Draws one tiny picture with a named GL backend; `gl.py` runs this file in a process of its own.

It imports nothing of ours, so that it can be started by path from anywhere.
"""

from __future__ import annotations

import importlib
import sys

_MODEL = """
<mujoco>
  <visual><headlight ambient="1 1 1"/><global offwidth="32" offheight="32"/></visual>
  <worldbody><geom type="sphere" size="1" rgba="1 0 0 1"/></worldbody>
</mujoco>
"""


def draw_once(backend: str) -> None:
    """Renders a red ball into 32 x 32 pixels.

    Args:
      backend: a module of MuJoCo that has a `GLContext`: "egl", "osmesa", "glfw" or "cgl".

    Raises:
      Exception: of whatever kind the backend raises, or RuntimeError if the picture shows no ball.
    """
    import mujoco
    import numpy as np

    gl = importlib.import_module(f"mujoco.{backend}").GLContext(32, 32)
    gl.make_current()
    model = mujoco.MjModel.from_xml_string(_MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
    scene = mujoco.MjvScene(model, maxgeom=10)
    camera = mujoco.MjvCamera()
    camera.distance = 3.0
    categories = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, categories, scene)
    pixels = np.zeros((32, 32, 3), np.uint8)
    rect = mujoco.MjrRect(0, 0, 32, 32)
    mujoco.mjr_render(rect, scene, context)
    mujoco.mjr_readPixels(pixels, None, rect, context)
    context.free()
    gl.free()
    red, green, _ = pixels[16, 16]
    if not (red > 100 and green < 100):
        raise RuntimeError(f"the picture's middle is {pixels[16, 16].tolist()} where a red ball was drawn")


if __name__ == "__main__":
    try:
        draw_once(sys.argv[1])
    except BaseException as error:
        text = " ".join(str(error).split()) or "no reason given"
        sys.exit(f"{type(error).__name__}: {text[:300]}")
