"""The web viewer answers whoever has its address, and nobody else: spoken to as a foreign page would."""

import http.client
import socket

import pytest

pytest.importorskip("viser", reason="needs the extra viewer")

import viser
from websockets import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from cluttergen_jax.rendering.viewer import guard as guarding
from cluttergen_jax.rendering.viewer.guard import Guard
from cluttergen_jax.rendering.viewer.viewer import announce, open_server


@pytest.fixture(scope="module")
def server():
    server = open_server("127.0.0.1", 0, "test")
    yield server
    server.stop()


def get(server, path, **headers):
    """Status and text of a page, asked for with these headers."""
    line = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=20)
    line.putrequest("GET", path, skip_host=True)
    for name, value in headers.items():
        line.putheader(name, value)
    line.endheaders()
    answer = line.getresponse()
    return answer.status, answer.read().decode("utf-8", "replace"), answer.headers


def dial(server, path, host=None, origin=None):
    """A web socket, as a page of `origin` opens one at a name `host` that leads to this machine."""
    port = server.get_port()
    return connect(
        f"ws://{host or '127.0.0.1'}:{port}{path}",
        sock=socket.create_connection(("127.0.0.1", port), 20),
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
    )


def test_the_address_that_is_printed_is_answered(server):
    told = []
    announce(server, browser=False, show=told.append)
    path = f"/{server.guard.token}/"
    assert told == [f"viewer     http://127.0.0.1:{server.get_port()}{path} (Ctrl-C ends it)"]
    own = f"127.0.0.1:{server.get_port()}"
    status, text, headers = get(server, path, Host=own)
    assert (status, text.lstrip()[:9].lower(), headers["Referrer-Policy"]) == (
        200,
        "<!doctype",
        "no-referrer",
    )
    # As the client of viser asks: without the stroke at the end.
    with dial(server, path.rstrip("/"), origin=f"http://{own}") as line:
        assert line.recv(timeout=20)
    # As a forwarded port is seen from the other machine.
    with dial(
        server, path, host="localhost", origin=f"http://localhost:{server.get_port()}"
    ) as line:
        assert line.recv(timeout=20)


@pytest.mark.parametrize(
    ("is_told", "host", "origin"),
    [
        (False, None, None),
        (False, None, "own"),
        (True, None, "http://evil.example"),
        (True, None, "http://127.0.0.1:1"),
        (True, None, "null"),
        (True, "evil.example", None),
        (True, "evil.example", "own"),
    ],
    ids=[
        "no token",
        "no token, own page",
        "foreign",
        "other port",
        "file",
        "rebound",
        "rebound, own page",
    ],
)
def test_strangers_are_refused(server, is_told, host, origin):
    entered = []
    server._websock_server.on_client_connect(entered.append)
    path = f"/{server.guard.token if is_told else 'x' * 32}/"
    host = host or "127.0.0.1"
    if origin == "own":
        origin = f"http://{host}:{server.get_port()}"
    asked = {"Host": f"{host}:{server.get_port()}"} | ({"Origin": origin} if origin else {})
    for each in (path, path.rstrip("/"), f"{path}?websocket=1"):
        status, text, _ = get(server, each, **asked)
        assert status == 403
        assert server.guard.token not in text
        with pytest.raises(InvalidStatus) as refused:
            dial(server, each, host, origin)
        assert refused.value.response.status_code == 403
    assert not entered


@pytest.mark.parametrize(
    "path", ["", "/", "/index.html", "//", "/?token", "/%2e%2e/", "/\xe9/", "*"]
)
def test_no_path_but_the_one_with_the_token_is_answered(path):
    guard = Guard("localhost")
    own = Headers({"Host": "localhost:8080"})
    assert guard.refusal(f"/{guard.token}/", own) is None
    assert guard.refusal(path, own)
    assert guard.refusal(f"/{guard.token}x/", own)
    assert guard.refusal(f"/{guard.token[:-1]}/", own)
    assert guard.refusal(f"/{path}/{guard.token}/", own)
    assert guard.token != Guard("localhost").token


def test_names_by_which_a_server_is_asked_are_its_own(monkeypatch):
    monkeypatch.setattr(guarding.socket, "gethostname", lambda: "Bench")

    def answered(listens, *hosts):
        guard = Guard(listens)
        headers = Headers([("Host", each) for each in hosts])
        return guard.refusal(f"/{guard.token}", headers) is None

    for each in ("localhost", "LOCALHOST:1", "127.0.0.1:8080", "[::1]:8080", "192.168.1.5"):
        assert answered("localhost", each), each
    for each in (
        "evil.example",
        "localhost.evil.example:80",
        "bench",
        "",
        "[",
        "127.0.0.1.evil.example",
        "a b",
    ):
        assert not answered("localhost", each), each
    assert answered("0.0.0.0", "bench:8080")
    assert answered("::", "bench.local")
    assert not answered("0.0.0.0", "evil.example")
    assert answered("bench.example", "bench.example:80")
    assert not answered("localhost")
    assert not answered("localhost", "localhost", "evil.example")


def test_other_machines_are_let_in_on_request_alone_and_with_the_token():
    server = open_server("0.0.0.0", 0, "test")
    try:
        told = []
        announce(server, browser=False, show=told.append)
        port = server.get_port()
        token = server.guard.token
        assert told[0].startswith(f"viewer     http://localhost:{port}/{token}/ ")
        name = guarding.socket.gethostname()
        assert told[1] == f"elsewhere  http://{name}:{port}/{token}/"
        assert get(server, f"/{token}/", Host=f"{name}:{port}")[0] == 200
        assert get(server, "/", Host=f"{name}:{port}")[0] == 403
    finally:
        server.stop()
