"""A web server that answers only requests with its whole address: not other web pages, not other users.

The address has a random token as its path, which the page's own web socket keeps; without it nothing is
answered, be it a page or a web socket. Two more checks hold even if the token is known: the name in `Host` is
one of this machine's, so that no page comes in through a name of its own (DNS rebinding), and an `Origin`
is the server itself.
"""

from __future__ import annotations

import http
import inspect
import ipaddress
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server as sockets
from websockets import Headers

from cluttergen_jax.errors import ClutterGenError

_LOCAL = "localhost"
_HINT = "Open the address that the command printed, as it stands there."
_patching = threading.Lock()


class Guard:
    """Says who is let in.

    Args:
      host: the address that the server listens on.

    Attributes:
      host: as it was given.
      token: the first part of every path that is answered.
      is_asked: whether a server asks this guard.
    """

    def __init__(self, host: str) -> None:
        self.host = host
        self.token = secrets.token_urlsafe(24)
        self.is_asked = False
        self._names = {_LOCAL, host.lower()}
        if _is_any(host):
            own = socket.gethostname().lower()
            self._names |= {own, f"{own}.local"}

    def refusal(self, path: str, headers: Headers) -> str | None:
        """Why a request is not answered; None for one that is."""
        hosts = headers.get_all("Host")
        origins = headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            asked = hosts[0] if hosts else ""
            refusal = f"This server is not called {asked!r}."
            return f"{refusal} {_HINT} An IP address in place of the name works, too."
        if any(origin.lower().partition("://")[2] != hosts[0].lower() for origin in origins):
            return f"Another web page ({origins[0]!r}) may not ask this server."
        if not secrets.compare_digest(_parts(path)[0].encode(), self.token.encode()):
            return f"The token is missing, or that of another server. {_HINT}"
        return None

    def _is_own(self, host: str) -> bool:
        """Whether a name, with or without a port, is one of the server's; nobody can claim an IP address."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return name in self._names or _is_address(name)

    def before(self, answer: Callable[..., Any]) -> Callable[..., Any]:
        """A `process_request` of websockets that asks the guard, and then `answer` without the token."""
        self.is_asked = True

        async def check_request(connection: sockets.ServerConnection, request: Any) -> Any:
            if reason := self.refusal(request.path, request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
            request.path = f"/{_parts(request.path)[1]}"
            response = answer(connection, request)
            if inspect.isawaitable(response):
                response = await response
            if response is not None:
                # The address stays between this server and the browser.
                response.headers["Referrer-Policy"] = "no-referrer"
            return response

        return check_request


class GuardedServer(viser.ViserServer):
    """viser's server behind a guard.

    Args:
      host, port: where to listen.
      label: the title of the page.

    Raises:
      ClutterGenError: this version of viser starts its server in another way, so that it cannot be guarded.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        self.guard = Guard(host)
        with _guard_servers(self.guard):
            super().__init__(host=host, port=port, label=label, verbose=False)
        if not self.guard.is_asked:
            self.stop()
            raise ClutterGenError(
                f"viser {viser.__version__} cannot be kept from answering strangers",
                hint="the version of viser that constraints.txt names",
            )

    @property
    def url(self) -> str:
        """The address, with the token, for a browser on this machine."""
        return self._url(_LOCAL if _is_any(self.guard.host) else self.guard.host)

    @property
    def url_elsewhere(self) -> str | None:
        """The address for other machines; None if the server listens to none."""
        return self._url(socket.gethostname()) if _is_any(self.guard.host) else None

    def _url(self, name: str) -> str:
        return (
            f"http://{f'[{name}]' if ':' in name else name}:{self.get_port()}/{self.guard.token}/"
        )


@contextmanager
def _guard_servers(guard: Guard) -> Iterator[None]:
    """Inside, a server that viser starts asks the guard: viser itself leaves no room for one."""
    with _patching:
        serve = sockets.serve

        def serve_guarded(handler: Any, *args: Any, **settings: Any) -> Any:
            if str(getattr(handler, "__module__", "")).startswith("viser."):
                answer = settings.get("process_request") or (lambda *_: None)
                settings["process_request"] = guard.before(answer)
            return serve(handler, *args, **settings)

        sockets.serve = serve_guarded  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            sockets.serve = serve  # type: ignore[misc]


def _parts(path: str) -> tuple[str, str]:
    """The first part of a path, and the rest with what is asked for."""
    place, mark, query = path.partition("?")
    first, _, rest = place.removeprefix("/").partition("/")
    return first, rest + mark + query


def _is_any(host: str) -> bool:
    """Whether to listen on a host is to listen on all addresses of this machine."""
    return host == "" or (_is_address(host) and ipaddress.ip_address(host).is_unspecified)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
