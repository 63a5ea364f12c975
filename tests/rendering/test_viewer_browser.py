"""The web viewer in a real browser without a screen: it loads, and its buttons do what they say."""

import numpy as np
import pytest
from PIL import Image

from cluttergen_jax.placement.baselines import make_proposer
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.placement.rollout.record import Recorder
from tests.helpers.browser import PATIENCE, Page, browsers


class Scenes:
    """Three scenes of three objects on a small table, some attempts failing, made when they are asked for."""

    name, numbers, methods = "test", (0, 1, 2), ("random",)

    def __init__(self):
        placement = PlacementConfig(num_objects=3, max_attempts=5, history_stride=0)
        problem = make_problem(
            ProblemConfig(
                objects=("dinner_plate", "mug", "bowl"), support="table-0.40x0.40", placement=placement
            )
        )
        sampler = BlockSampler(problem.rules, make_proposer("random", problem.rules))
        self.recorder = Recorder(sampler, problem.world, width=1)
        self.failing = next(seed for seed in range(50) if self.recorder.record(seed, 0).failures)

    def replay(self, number, num_proposals=0):
        return self.recorder.record(self.failing + number, 0, f"scene {number}", num_proposals)

    still = replay

    def notice(self, method=None):
        return ""

    def sample(self, method, seed, num_proposals=0):
        return self.recorder.record(1000 + seed, 0, f"{method}, seed {seed}", num_proposals)


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    pytest.importorskip("viser", reason="needs the extra viewer")
    from cluttergen_jax.rendering.viewer.viewer import Viewer, open_server

    server = open_server("127.0.0.1", 0, "test")
    viewer = Viewer(Scenes(), server, 0, tmp_path_factory.mktemp("shots"))
    yield viewer
    viewer.close()


@pytest.fixture(scope="module")
def open_page(viewer, tmp_path_factory):
    """Opens the viewer in one more browser."""
    with browsers(lambda: tmp_path_factory.mktemp("profile")) as start:

        def open_one(waits_for="objects placed"):
            browser = start()
            known = set(viewer.sessions)
            browser.get(viewer.server.url)
            return ViewerPage(browser, viewer, known, waits_for)

        yield open_one


@pytest.fixture(scope="module")
def page(open_page):
    return open_page()


class ViewerPage(Page):
    """What a person does and sees."""

    def __init__(self, browser, viewer, known, waits_for):
        super().__init__(browser)
        self.viewer = viewer
        self.until(lambda: set(viewer.sessions) - known)
        (own,) = set(viewer.sessions) - known
        self.session = viewer.sessions[own]
        self.until(lambda: waits_for in self.text())

    def picture(self):
        """uint8[H, W, 3], what the browser draws of the scene."""
        pixels = self.session.client.get_render(
            height=240, width=320, transport_format="png", timeout=PATIENCE
        )
        return np.asarray(Image.fromarray(pixels).convert("RGB"))

    def changes(self, before):
        """Waits until the picture is clearly another one, and returns it."""
        latest = before

        def differs():
            nonlocal latest
            latest = self.picture()
            return changed(before, latest)

        self.until(differs)
        return latest


def changed(before, after):
    return (np.abs(before.astype(int) - after).max(-1) > 40).sum() > 60


def test_page_loads_and_draws_the_scene(page):
    assert "objects placed: 3" in page.text()
    image = page.picture()
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100
    errors = [entry for entry in page.browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert [entry for entry in errors if "favicon" not in entry["message"]] == []


def test_next_previous_and_number_change_the_scene(page):
    first = page.picture()
    page.press("Next")
    page.until(lambda: "scene 1" in page.text())
    second = page.changes(first)
    page.press("Previous")
    page.until(lambda: "scene 0" in page.text())
    page.changes(second)
    page.press("Previous")
    page.until(lambda: "scene 2" in page.text())
    page.enter("Number", 0)
    page.until(lambda: "scene 0" in page.text())
    assert page.session.number == 0


def test_attempts_are_played_to_the_end(page):
    recording = page.session.recording
    last = len(recording.attempts)
    page.press("Play")
    page.until(lambda: f"attempt 1 of {last}" in page.text() or page.session._slider.value > 1)
    page.until(lambda: page.session._slider.value == last and "Play" in page.text())
    page.until(lambda: f"attempt {last} of {last}" in page.text())
