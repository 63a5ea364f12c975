"""The panel for placing by hand on a real server: what its buttons do, say and allow."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.hand import HandScene
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.region import no_keep_out
from cluttergen_jax.placement.types import Start
from cluttergen_jax.rendering.viewer.viewer import open_server
from tests.helpers.problems import HalfTable, trio_problem

PATIENCE = 60


class Scenes:
    """Scenes of two objects by a physics with known answers: what is let go at x > 0 stands."""

    name = "test"
    keep_out = (Rectangle((0.1, 0.1), (0.02, 0.02)),)

    def __init__(self):
        problem = trio_problem(history_stride=0, num_objects=2)
        rules = problem.rules.replace(physics=HalfTable())
        self.setup = Setup(replace(problem, rules=rules), no_keep_out(), Start.empty(3))
        self.support = problem.world.support
        self.region = problem.region
        self.kept = []
        self.is_full = False

    @property
    def num_kept(self):
        return len(self.kept)

    def begin(self):
        return HandScene(self.setup, jax.random.key(self.num_kept), self.num_kept)

    def keep(self, scene):
        if self.is_full:
            raise BankError("the disk is full", hint="another disk")
        self.kept.append(scene.result())
        scene.close()


@pytest.fixture(scope="module")
def scenes():
    return Scenes()


@pytest.fixture
def panel(scenes):
    pytest.importorskip("viser", reason="needs the extra viewer")
    from cluttergen_jax.rendering.viewer.placing import PlacingPanel

    server = open_server("127.0.0.1", 0, "test")
    scenes.kept = []
    scenes.is_full = False
    panel = PlacingPanel(scenes, server)
    yield panel
    panel.close()
    server.stop()


def press(panel, act):
    """What the panel says once it has done something in its own thread."""
    panel._worker.submit(panel._do, act).result(PATIENCE)
    return panel._said.content


def hold(panel, x):
    pose = panel.scene.held_pose
    panel._worker.submit(panel._move, np.array([x, 0.0, pose[2]]), pose[3:]).result(PATIENCE)


def test_only_what_can_be_done_is_offered(panel):
    # Nobody has come yet, so no time is spent.
    assert panel.scene.clock.seconds == 0

    def offered():
        return {
            name
            for name, button in (
                ("drop", panel._drop),
                ("lower", panel._lower),
                ("skip", panel._skip),
                ("undo", panel._undo),
                ("save", panel._save),
            )
            if not button.disabled
        }

    hand = {"drop", "lower", "skip"}
    assert offered() == hand
    hold(panel, 0.1)
    press(panel, panel.drop)
    assert offered() == hand | {"undo"}
    hold(panel, 0.2)
    assert "Every object is placed" in press(panel, panel.drop)
    assert offered() == {"undo", "save"}
    assert not panel.handle.visible
    assert "saved** as scene 0 of test" in press(panel, panel.save)
    assert offered() == set()
    press(panel, panel.new)
    assert (offered(), panel.scene.number) == (hand, 1)
    assert panel.handle.visible


def test_a_failure_is_told_drawn_and_cleared_away(panel):
    stood = panel.scene.poses.copy()
    hold(panel, -0.1)
    said = press(panel, panel.drop)
    name = panel.scene.names[panel.scene.current]
    assert said.startswith(f"**{name}: unsettled**: did not come to rest in time")
    assert panel._failed is not None
    # Why it failed is still to be seen while the object is moved.
    hold(panel, -0.05)
    assert (panel._failed is not None, panel._said.content) == (True, said)
    np.testing.assert_array_equal(panel.scene.poses, stood)
    press(panel, panel.skip)
    assert panel._failed is None
    assert panel.scene.names[panel.scene.current] == panel._object.value != name
    assert panel._object.options == tuple(panel.scene.names[index] for index in panel.scene.left)
