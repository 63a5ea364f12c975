"""A real browser without a screen, and what a person does with a page of viser's in it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    # WebGL without a graphics card.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE = 120


@contextmanager
def browsers(make_folder: Callable[[], Path], size: str = "1100,900") -> Iterator[Callable[[], Any]]:
    """A function that starts a browser; the test is skipped where there is none. All are closed in the end.

    Args:
      size: of its window, pixels; without a graphics card, small ones are much quicker.
    """
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs the extra browser")
    binary = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if not (binary and driver):
        pytest.skip("no Chromium with its driver on this machine")
    started: list[Any] = []

    def start() -> Any:
        options = webdriver.ChromeOptions()
        options.binary_location = binary
        for flag in (*FLAGS, f"--window-size={size}", f"--user-data-dir={make_folder()}"):
            options.add_argument(flag)
        started.append(webdriver.Chrome(options=options, service=webdriver.ChromeService(driver)))
        return started[-1]

    try:
        yield start
    finally:
        for browser in started:
            browser.quit()


class Page:
    """What a person does and sees."""

    def __init__(self, browser: Any) -> None:
        self.browser = browser

    def text(self) -> str:
        return self.browser.execute_script("return document.body.innerText")

    def until(self, condition: Callable[[], Any]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"in vain; the page says: {self.text()}"
            time.sleep(0.1)

    def press(self, label: str) -> None:
        path = f"//button[normalize-space()='{label}']"
        self._click(self.browser.find_element("xpath", path))

    def tick(self, label: str) -> None:
        path = f"//label[normalize-space()='{label}']/following::input[@type='checkbox'][1]"
        self._click(self.browser.find_element("xpath", path))

    def _click(self, element: Any) -> None:
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        self.browser.execute_script("arguments[0].click()", element)

    def enter(self, label: str, value: Any) -> None:
        path = f"//label[normalize-space()='{label}']/following::input[@type='text'][1]"
        field = self.browser.find_element("xpath", path)
        field.send_keys("\ue009a\ue000", str(value), "\ue007")

    def drag(self, client: Any, start: np.ndarray, end: np.ndarray, num_moves: int = 8) -> None:
        """Drags the mouse from where one world point f[3] is drawn to where another is."""
        from selenium.webdriver import ActionChains

        (x0, y0), (x1, y1) = (pixel_of(client.camera, point) for point in (start, end))
        actions = ActionChains(self.browser, duration=100)
        actions.w3c_actions.pointer_action.move_to_location(round(x0), round(y0))
        actions.pause(0.5).click_and_hold()
        for share in np.linspace(0, 1, num_moves + 1)[1:]:
            place = round(x0 + share * (x1 - x0)), round(y0 + share * (y1 - y0))
            actions.w3c_actions.pointer_action.move_to_location(*place)
            actions.pause(0.05)
        actions.pause(0.3).release().perform()


def pixel_of(camera: Any, point: np.ndarray) -> tuple[float, float]:
    """Where a camera of viser's (x right, y down, z forward) draws a world point f[3], in pixels."""
    w, *xyz = camera.wxyz
    turn = np.array(xyz)
    offset = np.asarray(point, float) - camera.position
    # The inverse turn of the quaternion.
    x, y, z = offset - 2 * w * np.cross(turn, offset) + 2 * np.cross(turn, np.cross(turn, offset))
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    return camera.image_width / 2 + focal * x / z, camera.image_height / 2 + focal * y / z
