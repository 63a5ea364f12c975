"""The web viewer: a server, a session a browser, one thread that makes scenes for all; and MuJoCo's own."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import platform
import socket
import threading
import webbrowser
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.rendering.viewer.session import Session, SessionConfig
from cluttergen_jax.rendering.viewer.source import SceneSource

if TYPE_CHECKING:
    import viser

    from cluttergen_jax.rendering.viewer.guard import GuardedServer


def free_port(host: str, port: int) -> int:
    """`port` itself if nobody listens there, or any free one for 0.

    Raises:
      ConfigError: the port is taken or may not be used, or the host is none of this machine's.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"port = {port}", "0 to 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            # As servers do: a port whose last connection is only just over is free.
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
            return int(trial.getsockname()[1])
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
            raise ConfigError(
                f"host = {host!r} cannot be listened on: {reason}",
                "a name or an address of this machine",
                "host='localhost', or host='0.0.0.0' for other machines too",
            ) from error
        raise ConfigError(
            f"{host}:{port} cannot be listened on: {reason}",
            "a free port",
            "port=0, which takes any",
        ) from error


def open_server(host: str, port: int, title: str) -> GuardedServer:
    """Starts a server that answers requests with its whole address, `server.url`, and no others.

    Raises:
      MissingExtraError: the extra `viewer` is not installed.
      ConfigError: the port cannot be had.
      ClutterGenError: this version of viser cannot be guarded.
    """
    try:
        from cluttergen_jax.rendering.viewer.guard import GuardedServer
    except ImportError as error:
        raise MissingExtraError("viewer", "the web viewer") from error
    # viser would take the next port without asking, and greets at length.
    port = free_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):
        server = GuardedServer(host, port, title)
    server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
    return server


def announce(
    server: GuardedServer, browser: bool, show: Callable[[str], None], notice: str = ""
) -> None:
    """Says where a server is, and opens a browser if wanted."""
    show(f"viewer     {server.url} (Ctrl-C ends it)")
    if elsewhere := server.url_elsewhere:
        show(f"elsewhere  {elsewhere}")
    if notice:
        show(f"first      {notice}")
    if browser:
        webbrowser.open(server.url)


class Viewer:
    """Shows a source's scenes to whatever browsers come, until `close`.

    Args:
      source: the scenes.
      server: of viser; see `open_server`.
      first: the scene that each browser begins with.
      folder: where screenshots go.

    Attributes:
      sessions: of the browsers that are there, by viser's number of the client.
    """

    def __init__(
        self, source: SceneSource, server: viser.ViserServer, first: int, folder: Path
    ) -> None:
        self.source = source
        self.server = server
        self.sessions: dict[int, Session] = {}
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="scenes")
        self._session_config = SessionConfig(source, source.methods, first, folder, self._worker)
        if source.notice():
            # What has to be compiled is begun before the first browser has come.
            self._worker.submit(source.still, first)
        server.on_client_disconnect(self._leave)
        server.on_client_connect(self._enter)

    def close(self) -> None:
        """Stops what is under way and the server."""
        with self._lock:
            sessions = list(self.sessions.values())
        for session in sessions:
            session.close()
        self._worker.shutdown(wait=True, cancel_futures=True)
        self.server.stop()

    def _enter(self, client: viser.ClientHandle) -> None:
        session = Session(self._session_config, client)
        with self._lock:
            self.sessions[client.client_id] = session
        if client.client_id not in self.server.get_clients():
            # It left while its panel was being made.
            self._leave(client)

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()


class DisplayError(ClutterGenError):
    """There is no screen to open a window on."""


def check_display() -> None:
    """Refuses to open a window where there is no screen (DisplayError: there is none)."""
    if platform.system() == "Linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
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
            f"MuJoCo's viewer could not open a window ({error})",
            hint="the web viewer: leave `native` out",
        ) from error
