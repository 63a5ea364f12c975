"""Finds an OpenGL backend of MuJoCo that draws without a screen. Importing this file imports no MuJoCo."""

from __future__ import annotations

import functools
import importlib
import os
import platform
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from cluttergen_jax.errors import ClutterGenError

_BACKENDS = {"Linux": ("egl", "osmesa", "glfw"), "Darwin": ("cgl", "glfw")}.get(platform.system(), ("glfw",))
_ANY = ("", "enable", "enabled", "on", "true", "1")
_SAME = {"glx": "glfw", "wgl": "glfw"}
_PROBE_SECONDS = 60
_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    if not renderer.render().any():
        raise RuntimeError("the picture of a sphere is black")
"""
_INSTALL = (
    "on Debian or Ubuntu `apt install libegl1 libgl1-mesa-dri` (EGL, with or without a GPU) or `apt install "
    "libosmesa6` (OSMesa)"
)
# A GL context belongs to one thread at a time, and MuJoCo's EGL display is shared by the process.
_LOCK = threading.RLock()


class RendererError(ClutterGenError):
    """Nothing on this machine can draw pictures. Simulation and files need no pictures."""


def _failure(backend: str) -> str | None:
    """Why `backend` cannot draw, or None if it can. It is tried in a process that a bad driver may crash."""
    command, env = [sys.executable, "-P", "-c", _PROBE], {**os.environ, "MUJOCO_GL": backend}
    try:
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_SECONDS} s"
    if done.returncode == 0:
        return None
    last = (done.stderr.strip().splitlines() or [f"the trial ended with code {done.returncode}"])[-1]
    # This is how PyOpenGL says that it finds no library.
    return "its library is not installed" if "'NoneType' object has no attribute" in last else last


@functools.cache
def _trial(given: str) -> tuple[str | None, str]:
    """The first backend that draws, of the one that MUJOCO_GL names or of all; and what the others said."""
    failures = []
    for backend in _BACKENDS if given in _ANY else (_SAME.get(given, given),):
        failure = _failure(backend)
        if failure is None:
            return backend, ""
        failures.append(f"{backend}: {failure}")
    return None, "; ".join(failures)


def find_backend() -> str:
    """The name of the first backend that draws; tried once per process and setting of MUJOCO_GL.

    Raises:
      RendererError: none works; it says why and what to install.
    """
    given = os.environ.get("MUJOCO_GL", "").lower().strip()
    backend, failures = _trial(given)
    if backend is None:
        setting, unset = (f" with MUJOCO_GL={given}", "unsetting MUJOCO_GL, or ") if given else ("", "")
        given = f"No OpenGL backend can draw here{setting} ({failures})"
        raise RendererError(given, ", ".join(_BACKENDS), unset + _INSTALL)
    return backend


def renderer_status() -> tuple[bool, str]:
    """Whether pictures can be drawn, and a sentence that says how or why not. Never raises."""
    try:
        return True, f"rendering works with {find_backend()}"
    except RendererError as error:
        return False, str(error)


@contextmanager
def gl_context(width: int, height: int) -> Iterator[None]:
    """Makes a GL context current for the block; one thread at a time.

    Args:
      width, height: pixels of the largest picture drawn in it.

    Raises:
      RendererError: there is no backend, or it works elsewhere but not in this process.
    """
    backend = find_backend()
    with _LOCK:
        try:
            context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
            context.make_current()
        except Exception as error:
            raise RendererError(
                f"{backend} works in a fresh process but not in this one ({error})",
                hint=f"setting MUJOCO_GL={backend} before Python starts",
            ) from error
        try:
            yield
        finally:
            context.free()
