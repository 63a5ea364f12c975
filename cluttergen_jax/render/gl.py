"""Finds a way to draw without a screen. Importing this file starts nothing and imports no MuJoCo."""

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
from pathlib import Path

from cluttergen_jax.errors import ClutterGenError

_OFF = ("disable", "disabled", "off", "false", "0")
_ANY = ("", "enable", "enabled", "on", "true", "1")
_CANDIDATES = {"Linux": ("egl", "osmesa", "glfw"), "Darwin": ("cgl", "glfw")}
_PROBE_SECONDS = 60
_INSTALL = (
    "on Debian or Ubuntu `apt install libegl1 libgl1-mesa-dri` (EGL, with or without a GPU) or `apt install "
    "libosmesa6` (OSMesa); then unset MUJOCO_GL or set it to egl or osmesa"
)
# A GL context belongs to one thread at a time, and MuJoCo's EGL display is shared by the process.
_LOCK = threading.RLock()


class RendererError(ClutterGenError):
    """Nothing on this machine can draw pictures. Simulation and files need no pictures."""


def _allowed() -> tuple[str, ...]:
    """The backends to try, best first, as MUJOCO_GL and the system have it.

    Raises:
      RendererError: MUJOCO_GL switches drawing off or names no backend.
    """
    candidates = _CANDIDATES.get(platform.system(), ("glfw",))
    given = os.environ.get("MUJOCO_GL", "").lower().strip()
    if given in _OFF:
        raise RendererError(f"MUJOCO_GL={given} switches rendering off", hint="unsetting MUJOCO_GL")
    if given in _ANY:
        return candidates
    name = {"glx": "glfw", "wgl": "glfw"}.get(given, given)
    if name not in candidates:
        raise RendererError(
            f"MUJOCO_GL={given!r} names no backend",
            f"{', '.join(candidates)} on {platform.system()}",
            "unsetting MUJOCO_GL: the first that works is taken",
        )
    return (name,)


def _failure(backend: str) -> str | None:
    """Why `backend` cannot draw, or None if it can. It is tried in a process that a bad driver may crash."""
    has_screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if backend == "glfw" and platform.system() == "Linux" and not has_screen:
        return "no screen (DISPLAY is not set)"
    command = [sys.executable, "-P", str(Path(__file__).with_name("probe.py")), backend]
    # MuJoCo imports the backend that MUJOCO_GL names; the probe imports its own.
    env = {**os.environ, "MUJOCO_GL": "disable"}
    try:
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_SECONDS} s"
    except OSError as error:
        return f"the trial could not be started: {error}"
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    if lines and "'NoneType' object has no attribute" in lines[-1]:
        # This is how PyOpenGL says it.
        return "its library is not installed"
    return lines[-1] if lines else f"the trial ended with code {done.returncode}"


@functools.cache
def _trial(candidates: tuple[str, ...]) -> tuple[str | None, tuple[str, ...]]:
    """The first of `candidates` that draws, and what the ones before it said."""
    failures: list[str] = []
    for name in candidates:
        failure = _failure(name)
        if failure is None:
            return name, tuple(failures)
        failures.append(f"{name}: {failure}")
    return None, tuple(failures)


def find_backend() -> str:
    """The name of the first backend that draws; tried once per process and setting.

    Raises:
      RendererError: none works; it says why and what to install.
    """
    name, failures = _trial(_allowed())
    if name is None:
        raise RendererError(f"No OpenGL backend can draw here ({'; '.join(failures)})", hint=_INSTALL)
    return name


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
