"""The web viewer in a real browser without a screen: it loads, and its buttons do what they say."""

import threading

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


def num_red(image):
    image = image.astype(int)
    return int(((image[..., 0] > 1.6 * image[..., 1]) & (image[..., 0] > 1.6 * image[..., 2])).sum())


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


def test_hulls_clouds_and_region_appear_and_go(page):
    page.until(lambda: page.session.number == 0)
    for label in ("Hulls", "Scene cloud", "Object cloud", "Queried region"):
        plain = page.picture()
        page.tick(label)
        ticked = page.changes(plain)
        page.tick(label)
        page.changes(ticked)
    shown = page.session.nodes.shown
    assert (shown.hulls, shown.region, shown.scene_cloud, shown.object_cloud) == (False, True, False, False)


def test_heat_of_proposals_appears_when_it_is_asked_for(page):
    page.until(lambda: page.session.number == 0)
    assert all(attempt.proposals is None for attempt in page.session.recording.attempts)
    plain = page.picture()
    page.tick("Where it may be proposed")
    page.until(lambda: page.session.recording.attempts[0].proposals is not None)
    heated = page.changes(plain)
    # Light blue to violet.
    cool = [(each[..., 2].astype(int) > each[..., 0].astype(int) + 40).sum() for each in (plain, heated)]
    assert cool[1] > cool[0] + 200
    page.tick("Where it may be proposed")
    page.changes(heated)


def test_failed_attempts_are_shown_in_red(page):
    page.until(lambda: page.session.number == 0)
    plain = page.picture()
    page.tick("All failed attempts")
    assert num_red(page.changes(plain)) > num_red(plain) + 30
    page.tick("All failed attempts")
    page.until(lambda: not page.session.nodes.shown.failures)


def test_attempts_are_played_to_the_end(page):
    recording = page.session.recording
    last = len(recording.attempts)
    page.press("Play")
    page.until(lambda: f"attempt 1 of {last}" in page.text() or page.session._slider.value > 1)
    page.until(lambda: page.session._slider.value == last and "Play" in page.text())
    page.until(lambda: f"attempt {last} of {last}" in page.text())


def test_sample_changes_the_objects(page):
    before, image = page.session.recording, page.picture()
    page.press("Sample")
    page.until(lambda: "random, seed 1" in page.text() and "sampling" not in page.text())
    assert np.abs(page.session.recording.poses - before.poses).max() > 0.01
    page.changes(image)


def test_screenshot_is_saved(page):
    page.press("Screenshot")
    page.until(lambda: "saved as" in page.text())
    (path,) = page.session.folder.iterdir()
    image = np.asarray(Image.open(path))
    assert image.shape[0] > 300
    assert image.shape[1] > 300
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 200


def test_reset_brings_the_camera_back(page):
    client = page.session.client
    home, near = np.array(client.camera.position), page.picture()
    client.camera.position = home * 1.8
    far = page.changes(near)
    page.press("Reset")
    page.until(lambda: np.allclose(client.camera.position, home, atol=1e-3))
    page.changes(far)


def test_what_goes_wrong_is_said(page, monkeypatch):
    from cluttergen_jax.errors import BankError

    def broken(number):
        raise BankError("the bank is gone", hint="another")

    monkeypatch.setattr(page.session.source, "still", broken)
    page.press("Next")
    page.until(lambda: "the bank is gone. Try: another." in page.text())


@pytest.mark.slow
def test_two_browsers_look_at_different_scenes(page, open_page):
    page.enter("Number", 0)
    page.until(lambda: page.session.recording.title == "scene 0" and "objects placed" in page.text())
    other = open_page()
    before = page.picture()
    other.press("Next")
    other.until(lambda: "scene 1" in other.text())
    other.tick("Hulls")
    other.until(lambda: other.session.nodes.shown.hulls)
    other.until(lambda: changed(before, other.picture()))
    # The first browser has noticed nothing of it.
    assert "scene 0" in page.text()
    assert "scene 1" not in page.text()
    assert not page.session.nodes.shown.hulls
    assert not changed(before, page.picture())
    assert (page.session.number, other.session.number) == (0, 1)
    other.browser.close()
    page.until(lambda: list(page.viewer.sessions.values()) == [page.session])


@pytest.mark.slow
def test_a_page_says_that_it_compiles_and_then_shows_the_scene(page, open_page, monkeypatch):
    source, go = page.session.source, threading.Event()
    made = source.still

    def slow(number):
        assert go.wait(PATIENCE)
        return made(number)

    monkeypatch.setattr(source, "notice", lambda method=None: "compiling, wait a minute")
    monkeypatch.setattr(source, "still", slow)
    other = open_page(waits_for="scene 0: compiling, wait a minute")
    assert "objects placed" not in other.text()
    empty = other.picture()
    go.set()
    other.until(lambda: "objects placed: 3" in other.text())
    other.changes(empty)
