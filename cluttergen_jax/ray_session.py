"""A connection to Ray: started on this machine, guarded by a token, or a cluster that is there."""

from __future__ import annotations

import importlib
import logging
import os
import secrets
import shutil
import socket
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from types import ModuleType
from typing import Any

from cluttergen_jax.errors import ClutterGenError, MissingExtraError

_CONNECT = 20.0
"""Seconds in which a machine has to answer."""
_END = 10.0
"""Seconds that Ray's programs have for ending."""
_OBJECT_STORE = 256 * 2**20
"""Bytes of results in flight on a machine of its own; Ray writes to disk what exceeds it."""
_AUTHENTICATION = ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN")
_OLDEST = (2, 52)
"""The first Ray that asks for a token."""
_LONGEST_FOLDER = 30
"""Letters: Ray adds some 70 for its sockets, whose paths have 107 at most."""


@contextmanager
def connect(address: str, num_cores: int) -> Iterator[ModuleType]:
    """Ray, connected; left as it was found.

    Args:
      address: "local" starts it on this machine, with so many cores at least.

    Raises:
      MissingExtraError: it is not installed; ClutterGenError: none answers there, or it is too old.
    """
    # What is never wanted from a library: messages home, and a note about them on the terminal.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("ray", "work on a cluster") from error
    if ray.is_initialized():
        yield ray
        return
    with ExitStack() as stack:
        own: dict[str, Any] = {}
        if address == "local":
            cores = max(os.cpu_count() or 1, num_cores)
            own = {
                "num_cpus": cores,
                "include_dashboard": False,
                "object_store_memory": _OBJECT_STORE,
            }
            own["_temp_dir"] = stack.enter_context(_folder_for_ray())
            stack.enter_context(_token(ray))
        _start(ray, address, own)
        stack.callback(ray.shutdown)
        yield ray


def _start(ray: ModuleType, address: str, own: Mapping[str, Any]) -> None:
    """Starts Ray with settings of our own, or joins a cluster."""
    try:
        _check_answers(address)
        with warnings.catch_warnings():
            # Ray starts programs of its own by a fork, of which JAX warns; no JAX runs in those.
            warnings.simplefilter("ignore", RuntimeWarning)
            ray.init(address, logging_level=logging.ERROR, log_to_driver=False, **own)
    except (RuntimeError, ValueError, OSError, ray.exceptions.RayError) as error:
        raise ClutterGenError(
            f"no Ray cluster answers at {address!r} ({first_line(error)})",
            "local, auto, or the address of a cluster",
            "starting Ray on its machines first (`ray start`), or local",
        ) from error


@contextmanager
def _token(ray: ModuleType) -> Iterator[None]:
    """Inside, Ray, which listens to the whole network, asks for a random token that what it starts has."""
    if tuple(int(part) for part in ray.__version__.split(".")[:2]) < _OLDEST:
        raise ClutterGenError(
            f"Ray {ray.__version__} lets anybody on the network run programs on a cluster",
            f"Ray {'.'.join(map(str, _OLDEST))} or newer",
            "installing a newer one",
        )
    before = {name: os.environ.get(name) for name in _AUTHENTICATION}
    # Whoever has set the mode knows what they want, or has a token of their own.
    if before["RAY_AUTH_MODE"] is None:
        os.environ.update(zip(_AUTHENTICATION, ("token", secrets.token_hex(32)), strict=True))
    _read_authentication()
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        _read_authentication()


def _read_authentication() -> None:
    """Has Ray look at the environment again, which it does once in a process; it says so to nobody else."""
    with suppress(ImportError, AttributeError):
        internals: Any = importlib.import_module("ray._raylet")
        internals.Config.initialize("")
        internals.AuthenticationTokenLoader.instance().reset_cache()


@contextmanager
def _folder_for_ray() -> Iterator[str]:
    """A folder for logs, sockets and what exceeds the memory, for this user alone; removed afterwards."""
    asked = (os.environ.get("RAY_TMPDIR"), tempfile.gettempdir())
    parents = [each for each in asked if each and len(os.path.abspath(each)) <= _LONGEST_FOLDER]
    folder = tempfile.mkdtemp(prefix="ray-", dir=parents[0] if parents else "/tmp")
    try:
        # Ray lets everybody into its own.
        yield os.path.join(folder, "r")
    finally:
        # Programs of Ray's that are just ending still write there.
        until = time.monotonic() + _END
        while os.path.isdir(folder):
            shutil.rmtree(folder, ignore_errors=time.monotonic() < until)
            if os.path.isdir(folder):
                time.sleep(0.1)


def _check_answers(address: str) -> None:
    """OSError if nobody listens at HOST:PORT, which Ray itself would try for many minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdecimal() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT).close()


def room_for(ray: ModuleType, num_cpus: int, num_gpus: int) -> int:
    """How many workers the cluster has room for now, at least one."""
    nodes = [each["Resources"] for each in ray.nodes() if each["Alive"]]
    room = [int(node.get("CPU", 0) // num_cpus) for node in nodes]
    if num_gpus:
        room = [
            min(most, int(node.get("GPU", 0) // num_gpus))
            for most, node in zip(room, nodes, strict=True)
        ]
    return max(sum(room), 1)


def first_line(error: Exception) -> str:
    """The first line of an error of Ray's, which are long."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".:")
