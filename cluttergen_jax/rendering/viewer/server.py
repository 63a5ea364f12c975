"""The web server behind the viewer."""

from __future__ import annotations

import contextlib
import io
import socket
from typing import TYPE_CHECKING

from cluttergen_jax.errors import ConfigError, MissingExtraError

if TYPE_CHECKING:
    import viser


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
        raise ConfigError(
            f"{host}:{port} cannot be listened on: {reason}", "a free port", "port=0, which takes any"
        ) from error


def open_server(host: str, port: int, title: str) -> viser.ViserServer:
    """Starts a server; `server.get_port()` says where.

    Raises:
      MissingExtraError: the extra `viewer` is not installed.
      ConfigError: the port cannot be had.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingExtraError("viewer", "the web viewer") from error
    # viser would take the next port without asking, and greets at length.
    port = free_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
    return server
