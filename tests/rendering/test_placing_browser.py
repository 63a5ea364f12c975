"""Placing by hand in a real browser without a screen: a handle is dragged, and the bank is read."""

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.generation.hand import HandBank
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.region import no_keep_out
from cluttergen_jax.placement.rules import empty_start
from cluttergen_jax.rendering.viewer.viewer import open_server
from cluttergen_jax.scene.bank import read_bank
from tests.helpers.browser import Page, browsers
from tests.helpers.problems import trio_problem

SQUARE = 0.255
"""Of a handle's size: where the middle of its square is along x and y."""


class PlacingPage(Page):
    """The page, and the panel behind it."""

    def __init__(self, browser, panel):
        super().__init__(browser)
        self.panel = panel
        self.until(lambda: "objects placed" in self.text())
        self.until(lambda: len(panel.server.get_clients()) == 1)
        (self.client,) = panel.server.get_clients().values()

    def says(self, words):
        self.until(lambda: words in self.text())

    def on_handle(self, x, y):
        """f[3]: the world point at so many handle sizes along the handle's x and y."""
        handle = self.panel.handle
        yaw = 2 * np.arctan2(handle.wxyz[3], handle.wxyz[0])
        return handle.position + handle.scale * yaw_matrix(yaw) @ np.array([x, y, 0.0])

    def carry(self, by):
        """Drags the object by its square, and waits until it is there."""
        start, grip = np.array(self.panel.handle.position), self.on_handle(SQUARE, SQUARE)
        self.drag(self.client, grip, grip + by)
        self.until(
            lambda: np.linalg.norm(self.panel.scene.held_pose[:2] - start[:2]) > 0.5 * np.linalg.norm(by)
        )
        return self.panel.scene.held_pose[:2] - start[:2]


@pytest.fixture
def bank(tmp_path):
    problem = trio_problem(history_stride=0, num_objects=2, min_margin=0.003)
    with HandBank(tmp_path / "bank", Setup(problem, no_keep_out(), empty_start(3)), (), 0) as bank:
        bank.rehearse()
        yield bank


@pytest.fixture
def page(bank, tmp_path):
    pytest.importorskip("viser", reason="needs the extra viewer")
    from cluttergen_jax.rendering.viewer.placing import PlacingPanel

    server = open_server("127.0.0.1", 0, "test")
    panel = PlacingPanel(bank, server)
    with browsers(lambda: tmp_path / "profile", "900,620") as start:
        browser = start()
        browser.get(server.url)
        yield PlacingPage(browser, panel)
    panel.close()
    server.stop()


@pytest.mark.slow
def test_a_person_makes_a_scene(page, bank, tmp_path):
    scene = page.panel.scene
    page.says("0 of 2 objects placed")
    moved = page.carry(np.array([-0.1, 0.06, 0.0]))
    np.testing.assert_allclose(moved, (-0.1, 0.06), atol=0.02)
    # The arc turns it: a quarter of the way round from its x to its y.
    yaw = scene.held.yaw
    arc = 0.5 * np.sqrt(0.5)
    page.drag(page.client, page.on_handle(arc, arc), page.on_handle(0.05, 0.5))
    page.until(lambda: abs(scene.held.yaw - yaw) > 0.3)
    assert scene.held_pose[2] == pytest.approx(page.panel.handle.position[2], abs=1e-5)
    page.press("Lower")
    page.says("touches the bare top")
    page.press("Drop")
    page.says("stable after")
    page.says("1 of 2 objects placed")
    first = scene.poses[scene.all[0]]
    np.testing.assert_allclose(first[:2], moved, atol=1e-3)
    page.press("Undo")
    page.says("was taken back")
    page.says("0 of 2 objects placed")
    page.press("Lower")
    page.press("Drop")
    page.says("1 of 2 objects placed")
    # The second object is let go in the air before it is placed.
    page.carry(np.array([0.14, -0.05, 0.0]))
    scene.held = scene.held.__class__(scene.held.x, scene.held.y, 0.25, scene.held.yaw)
    page.press("Drop")
    page.says("In red, where it ended")
    page.press("Lower")
    page.says("touches the bare top")
    page.press("Drop")
    page.says("Every object is placed")
    page.press("Save scene")
    page.says("saved")
    page.until(lambda: bank.num_kept == 1)
    page.press("New scene")
    page.says("scene 1: 0 of 2 objects placed")
    (row,) = read_bank(tmp_path / "bank").table.to_pylist()
    assert row["is_success"]
    assert row["attempts"] == [2, 2]
    np.testing.assert_allclose(row["poses"][0][:2], first[:2], atol=1e-3)
    assert row["seconds"] > 1
    assert cg.verify(tmp_path / "bank").is_sound
