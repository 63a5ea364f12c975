"""A Ray of one's own machine: for whoever has its token, and nothing is left of it."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from cluttergen_jax.cluster import Cluster, each_on
from tests.helpers import clusters as work

ray = pytest.importorskip("ray", reason="needs the extra ray")
STRANGER = """
import sys
import ray
ray.init(sys.argv[1], log_to_driver=False)
print("is in")
"""


@pytest.fixture
def place(monkeypatch):
    """Home and temporary folder; short, as sockets lie there."""
    with tempfile.TemporaryDirectory(prefix="c-") as place:
        for name in ("home", "tmp"):
            Path(place, name).mkdir()
        monkeypatch.setenv("HOME", f"{place}/home")
        monkeypatch.setenv("RAY_TMPDIR", f"{place}/tmp")
        for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
            monkeypatch.delenv(name, raising=False)
        yield Path(place)


def knock(address):
    """What becomes of somebody who has no token."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("RAY_AUTH")}
    command = [sys.executable, "-c", STRANGER, address]
    return subprocess.run(
        command, env=env | {"RAY_AUTH_MODE": "disabled"}, capture_output=True, text=True
    )


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_strangers_are_refused_and_nothing_is_left(place):
    before = dict(os.environ)
    tokens = []
    # Ray looks at the environment once in a process, if it is let.
    for _ in range(2):
        results = each_on(
            Cluster("local", 1), work.variables, ["RAY_AUTH_MODE", "RAY_AUTH_TOKEN"], "name"
        )
        (_, mode) = next(results)
        (_, token) = next(results)
        assert mode == "token"
        tokens.append(token)
        if len(tokens) == 1:
            (folder,) = (place / "tmp").iterdir()
            assert folder.stat().st_mode & 0o077 == 0
            refused = knock(ray.get_runtime_context().gcs_address)
            assert refused.returncode != 0
            assert "is in" not in refused.stdout
        assert list(results) == []
        assert list((place / "tmp").iterdir()) == []
    assert len({len(token) for token in tokens}) == 1
    assert tokens[0] != tokens[1]
    assert not list((place / "home").rglob("auth_token"))
    assert {k: v for k, v in os.environ.items() if k.startswith("RAY_AUTH")} == {}
    assert set(before) <= set(os.environ)
