"""The web viewer: every browser has a session of its own, and one thread makes scenes for all."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.rendering.viewer.session import Session, SessionConfig
from cluttergen_jax.rendering.viewer.source import SceneSource

if TYPE_CHECKING:
    import viser


class Viewer:
    """Shows a source's scenes to whatever browsers come, until `close`.

    Args:
      source: the scenes.
      server: of viser; see `server.open_server`.
      first: the scene that each browser begins with.
      folder: where screenshots go.

    Attributes:
      sessions: of the browsers that are there, by viser's number of the client.
    """

    def __init__(self, source: SceneSource, server: viser.ViserServer, first: int, folder: Path) -> None:
        self.source, self.server = source, server
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
