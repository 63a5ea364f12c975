"""Scenes in a browser, to be looked at or made by hand, or in MuJoCo's own viewer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cluttergen_jax.errors import BankError
from cluttergen_jax.generation.generate import GeneratedBank
from cluttergen_jax.generation.hand import HandBank
from cluttergen_jax.generation.sources.scene_sources import LiveConfig, open_source
from cluttergen_jax.placement.replay import Replay
from cluttergen_jax.rendering.assets import scene_spec
from cluttergen_jax.rendering.lighting import FLOOR
from cluttergen_jax.rendering.viewer.placing import PlacingPanel
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.rendering.viewer.viewer import (
    Viewer,
    announce,
    check_display,
    free_port,
    open_server,
    show_native,
)
from cluttergen_jax.scene import Bank, Scene

if TYPE_CHECKING:
    from cluttergen_jax.rendering.viewer.guard import GuardedServer


Source = str | Bank | Scene | Sequence[Scene] | None
"""What `open_source` takes."""


def view_native(source: Source, live: LiveConfig, show: Callable[[str], None]) -> None:
    """A scene in MuJoCo's own viewer, until its window is closed; see `cluttergen_jax.view`."""
    check_display()
    scenes, own = open_source(source, live)
    recording = scenes.still(_first(scenes, own))
    show(f"{recording.title}: {len(recording.placed)} objects; the window's Reset puts them back")
    show_native(*native_model(recording))


def view_web(
    source: Source,
    live: LiveConfig,
    host: str,
    port: int,
    browser: bool,
    screenshots: Path,
    show: Callable[[str], None],
) -> None:
    """Scenes in a browser, until Ctrl-C; see `cluttergen_jax.view`."""
    viewer = _viewer_of(source, live, host, port, screenshots, show)
    try:
        _serve(viewer.server, browser, show, viewer.source.notice())
    finally:
        viewer.close()


def open_viewer(
    source: Source,
    live: LiveConfig,
    host: str,
    port: int,
    browser: bool,
    screenshots: Path,
    show: Callable[[str], None],
) -> Viewer:
    """The same without waiting: the viewer runs until it is closed."""
    viewer = _viewer_of(source, live, host, port, screenshots, show)
    try:
        announce(viewer.server, browser, show, viewer.source.notice(), "close() ends it")
    except BaseException:
        viewer.close()
        raise
    return viewer


def _viewer_of(
    source: Source,
    live: LiveConfig,
    host: str,
    port: int,
    screenshots: Path,
    show: Callable[[str], None],
) -> Viewer:
    # What cannot work is said before anything is compiled.
    free_port(host, port)
    show(f"opening    {'scenes made on the spot' if source is None else _text_of(source)}")
    scenes, own = open_source(source, live)
    first = _first(scenes, own)
    server = open_server(host, port, f"cluttergen: {scenes.name}")
    return Viewer(scenes, server, first, screenshots)


def _text_of(source: Source) -> str:
    if isinstance(source, Bank):
        return str(source.path)
    return str(source) if isinstance(source, str | Scene) else "scenes"


def place_web(
    open_bank: Callable[[], HandBank],
    host: str,
    port: int,
    browser: bool,
    show: Callable[[str], None],
) -> GeneratedBank:
    """Placing by hand in a browser, until Ctrl-C; see `cluttergen_jax.place_by_hand`.

    Args:
      open_bank: called once the port is had.
    """
    server = open_server(host, port, "cluttergen: placing by hand")
    try:
        with open_bank() as bank:
            show(f"opening    {bank.name}, which holds {bank.num_kept} scenes")
            bank.rehearse()
            panel = PlacingPanel(bank, server)
            try:
                _serve(server, browser, show)
            finally:
                panel.close()
            return bank.summary()
    finally:
        server.stop()


def _serve(
    server: GuardedServer, browser: bool, show: Callable[[str], None], notice: str = ""
) -> None:
    """Says where the server is, opens a browser if wanted, and returns at Ctrl-C."""
    # As soon as the address is known, Ctrl-C may come.
    with suppress(KeyboardInterrupt):
        announce(server, browser, show, notice)
        threading.Event().wait()
    show("\nviewer     ended")


def _first(scenes: SceneSource, own: int | None) -> int:
    """The scene that is shown first."""
    first = int(scenes.numbers[0]) if own is None else own
    if first not in scenes.numbers:
        raise BankError(
            f"{scenes.name} has no scene {first}", f"{scenes.numbers[0]} to {scenes.numbers[-1]}"
        )
    return first


def native_model(recording: Replay) -> tuple[mujoco.MjModel, np.ndarray]:
    """The finished scene as a model with surfaces, light and a floor that carries, and its qpos f64[nq]."""
    placed = recording.placed
    poses = np.asarray(recording.poses[placed], np.float64)
    spec, qpos = scene_spec(
        [recording.objects[index] for index in placed], poses, recording.support
    )
    # What falls off the table is to stay in sight.
    spec.geom(FLOOR).contype = spec.geom(FLOOR).conaffinity = 1
    # Where the window's camera looks first, and from how far.
    spec.stat.center = (*recording.region.center, recording.support.top + 0.05)
    spec.stat.extent = float(2 * np.hypot(*recording.region.half_extents))
    for body, pose in zip((each for each in spec.bodies if each.joints), poses, strict=True):
        body.pos = pose[:3]
        body.quat = pose[3:]
    return spec.compile(), qpos
