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
from typing import Any

from cluttergen_jax.errors import ClutterGenError

_BACKENDS = {"Linux": ("egl", "osmesa", "glfw"), "Darwin": ("cgl", "glfw")}.get(
    platform.system(), ("glfw",)
)
_ANY = ("", "enable", "enabled", "on", "true", "1")
_SAME = {"glx": "glfw", "wgl": "glfw"}
_OFF = ("disable", "disabled", "off", "false", "0")
_BY_PYOPENGL = ("egl", "osmesa")
"""Backends that PyOpenGL loads, and loads for one of them alone if PYOPENGL_PLATFORM names it."""
_PROBE_SECONDS = 60
_PROBE = """
import importlib, os
import mujoco
# MuJoCo keeps to itself why it cannot import a backend.
importlib.import_module("mujoco." + os.environ["MUJOCO_GL"])
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
_PLAIN = {
    # This is how PyOpenGL says that it finds no library.
    "'NoneType' object has no attribute": "its library is not installed",
    "Unable to load": "its library is not installed",
    "No module named 'OpenGL'": "its Python package is not installed",
    "No module named 'glfw'": "its Python package is not installed",
    "an OpenGL platform library has not been loaded": "no window can be opened here",
    "Cannot initialize a EGL device display": "there is no EGL device that can be used",
}
"""What errors of MuJoCo and PyOpenGL contain, and what they mean."""
# A GL context belongs to one thread at a time, and MuJoCo's EGL display is shared by the process.
_LOCK = threading.RLock()
_OPEN: list[object] = []
"""The context that the thread with the lock has made current, if any."""


class RendererError(ClutterGenError):
    """Nothing on this machine can draw pictures. Simulation and files need no pictures."""


def _failure(backend: str) -> str | None:
    """Why `backend` cannot draw, or None if it can. It is tried in a process that a bad driver may crash."""
    platform_asked = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if backend in _BY_PYOPENGL and platform_asked not in ("", backend):
        return f"PYOPENGL_PLATFORM={platform_asked} rules it out"
    command = [sys.executable, "-P", "-c", _PROBE]
    env = {**os.environ, "MUJOCO_GL": backend}
    try:
        done = subprocess.run(
            command, env=env, capture_output=True, text=True, timeout=_PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_SECONDS} s"
    if done.returncode == 0:
        return None
    return _plain(
        (done.stderr.strip().splitlines() or [f"the trial ended with code {done.returncode}"])[-1]
    )


def _plain(message: object) -> str:
    """What MuJoCo or PyOpenGL said, in plain words if it is known."""
    return next((plain for part, plain in _PLAIN.items() if part in str(message)), str(message))


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
    if given in _OFF:
        raise RendererError(
            f"MUJOCO_GL={given} switches pictures off",
            f"MUJOCO_GL={', '.join(_BACKENDS)}, or unset",
            "unsetting MUJOCO_GL",
        )
    backend, failures = _trial(given)
    if backend is None:
        settings = {
            "MUJOCO_GL": given,
            "PYOPENGL_PLATFORM": os.environ.get("PYOPENGL_PLATFORM", ""),
        }
        named = " and ".join(f"{name}={value}" for name, value in settings.items() if value)
        unset = "".join(f"unsetting {name}, or " for name, value in settings.items() if value)
        raise RendererError(
            f"No OpenGL backend can draw here{f' with {named}' if named else ''} ({failures})",
            ", ".join(_BACKENDS),
            unset + _INSTALL,
        )
    return backend


def check_importable() -> None:
    """Refuses settings with which MuJoCo itself cannot be imported, though simulation needs no pictures.

    Raises:
      RendererError: MUJOCO_GL names no backend, or one whose library is missing.
    """
    if given := os.environ.get("MUJOCO_GL"):
        try:
            importlib.import_module("mujoco")
        except (RuntimeError, ImportError, AttributeError, OSError) as error:
            raise RendererError(
                f"MuJoCo cannot be imported with MUJOCO_GL={given}: {_plain(error)}",
                f"MUJOCO_GL={', '.join(_BACKENDS)}, disable, or unset",
                f"unsetting MUJOCO_GL; for pictures {_INSTALL}",
            ) from error


def renderer_status() -> tuple[bool, str]:
    """Whether pictures can be drawn, and a sentence that says how or why not. Never raises."""
    try:
        return True, f"rendering works with {find_backend()}"
    except RendererError as error:
        return False, str(error)


def new_context(width: int, height: int) -> Any:
    """A GL context of the caller's own, made current: `make_current()`, and in the end `free()`.

    Raises:
      RendererError: as `gl_context`.
    """
    backend = find_backend()
    try:
        context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        context.make_current()
    except Exception as error:
        raise RendererError(
            f"{backend} works in a fresh process but not in this one ({error})",
            hint=f"setting MUJOCO_GL={backend} before Python starts",
        ) from error
    return context


@contextmanager
def gl_context(width: int, height: int) -> Iterator[None]:
    """Makes a GL context current for the block; one thread at a time. Within another's block it is that one.

    Args:
      width, height: pixels of the largest picture drawn in it.

    Raises:
      RendererError: there is no backend, or it works elsewhere but not in this process.
    """
    with _LOCK:
        if _OPEN:
            yield
            return
        context = new_context(width, height)
        _OPEN.append(context)
        try:
            yield
        finally:
            _OPEN.pop()
            context.free()
