"""The web viewer's state for each browser; real connections, without a browser that draws."""

import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.rendering.viewer.scene_nodes import SceneNodes
from cluttergen_jax.rendering.viewer.viewer import Viewer, open_server
from tests.helpers.recordings import cubes

PATIENCE = 60
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 3.0],
    "fov": 0.7,
    "near": 0.1,
    "far": 100.0,
    "image_height": 60,
    "image_width": 80,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}


class Scenes:
    """Three scenes that differ by their titles; each is held back until `go` is set."""

    name = "test"
    numbers = (0, 1, 2)
    methods = ("random",)

    def __init__(self):
        self.go = threading.Event()
        self.go.set()

    def notice(self, method=None):
        return "" if self.go.is_set() else "compiling, which takes about a minute"

    def still(self, number):
        assert self.go.wait(PATIENCE)
        return replace(cubes(), title=f"scene {number}")

    def replay(self, number, num_proposals=0):
        return self.still(number)

    def sample(self, method, seed, num_proposals=0):
        return replace(cubes(), title=f"{method}, seed {seed}")


@pytest.fixture
def viewer(tmp_path):
    pytest.importorskip("viser", reason="needs the extra viewer")
    viewer = Viewer(Scenes(), open_server("127.0.0.1", 0, "test"), 0, tmp_path)
    yield viewer
    viewer.source.go.set()
    viewer.close()


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@contextmanager
def browser(viewer):
    """A connection as a browser makes one, and its session."""
    import msgspec
    import viser
    from websockets.sync.client import connect

    known = set(viewer.sessions)
    address = viewer.server.url.replace("http://", "ws://")
    with connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as line:
        line.send(msgspec.msgpack.encode(CAMERA))
        # What the server sends is taken and thrown away.
        threading.Thread(target=lambda: all(True for _ in line), daemon=True).start()
        until(lambda: set(viewer.sessions) - known)
        (own,) = set(viewer.sessions) - known
        yield viewer.sessions[own]


def said(session):
    return session._status.content


def test_two_browsers_look_at_different_scenes_and_leave_alone(viewer):
    with browser(viewer) as one:
        until(lambda: "**scene 0** stands" in said(one))
        with browser(viewer) as other:
            until(lambda: "**scene 0** stands" in said(other))
            other.step(1)
            other._seed_entry.value = 7
            other.nodes.shown.hulls = True
            until(lambda: "**scene 1** stands" in said(other))
            assert (one.number, other.number) == (0, 1)
            assert "**scene 0** stands" in said(one)
            assert (one._scene.value, one._seed_entry.value) == (0, 1)
            assert not one.nodes.shown.hulls
            one.sample()
            until(lambda: "**random, seed 1** stands" in said(one))
            assert "**scene 1** stands" in said(other)
        until(lambda: list(viewer.sessions.values()) == [one])
        with pytest.raises(KeyError):
            viewer.sessions[other.client.client_id]
    until(lambda: not viewer.sessions)


@pytest.mark.parametrize(("support", "surface"), [("bookcase", "all"), ("tilted_board_10", "")])
def test_regions_are_outlined_on_the_surfaces_that_objects_are_asked_for_on(support, surface):
    asked = find_support(support).on_surface(surface)
    server = MagicMock()
    SceneNodes(server)._add_region(
        SimpleNamespace(support=asked, region=asked.region, keep_out=(), seat=None)
    )
    drawn = [call.args[1] for call in server.scene.add_line_segments.call_args_list]
    assert len(drawn) == len(asked.asked)
    for (each, _), sides in zip(asked.asked, drawn, strict=True):
        heights = (sides.reshape(-1, 3) - each.position) @ each.T_world_surface[:3, 2]
        np.testing.assert_allclose(heights, heights[0], atol=1e-6)
        assert 0 < heights[0] < 0.005
