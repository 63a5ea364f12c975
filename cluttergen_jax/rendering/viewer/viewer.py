"""The web viewer: a server, a session a browser, one thread that makes scenes for all; and MuJoCo's own."""

from __future__ import annotations

import contextlib
import errno
import html
import io
import itertools
import os
import platform
import socket
import threading
import time
import webbrowser
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.errors import ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.placement.replay import Replay
from cluttergen_jax.rendering.viewer.scene_nodes import SceneNodes, aim
from cluttergen_jax.rendering.viewer.source import SceneSource
from cluttergen_jax.rendering.viewer.words import attempt_words, scene_words

if TYPE_CHECKING:
    import viser

    from cluttergen_jax.rendering.viewer.guard import GuardedServer

_FRAMES_PER_SECOND = 20
_SECONDS_PER_ATTEMPT = 0.8
_PROPOSALS = 512
_FRAME_HEIGHT = 480
"""Pixels of the viewer in a notebook."""


@dataclass(frozen=True)
class SessionConfig:
    """What all browsers are offered alike.

    Attributes:
      source: the scenes.
      methods: the source's, for new scenes.
      first: the scene to begin with.
      folder: where screenshots go.
      worker: reads and makes scenes, one after another for all browsers.
    """

    source: SceneSource
    methods: tuple[str, ...]
    first: int
    folder: Path
    worker: Executor


class Session:
    """Shows a source's scenes in one browser, until it leaves.

    The newest request counts: whatever the browser asked for before and has not begun is dropped.

    Args:
      config: what there is to see.
      client: the browser.
    """

    def __init__(self, config: SessionConfig, client: viser.ClientHandle) -> None:
        self.source = config.source
        self.folder = config.folder
        self.client = client
        self.nodes = SceneNodes(client)
        self.number = config.first
        self.recording = None
        self._note = ""
        self._request = 0
        self._lock = threading.RLock()
        self._worker = config.worker
        self._playing = threading.Event()
        self._is_closed = False
        self._build_panel(config.methods)
        self.show(config.first)

    recording: Replay | None
    _ask_again: Callable[[], None]
    # viser types the value of its handles as read-only, which it is not.
    _scene: Any
    _slider: Any
    _seed_entry: Any

    def close(self) -> None:
        """Stops what is under way."""
        self._playing.clear()
        with self._lock:
            self._is_closed = True
            self._request += 1

    # What the buttons do.

    def show(self, number: int) -> None:
        """Shows a scene by number; first as it is stored, then with its attempts."""
        with self._lock:
            self.number = number
        self._ask_again = partial(self.show, number)
        self._ask(
            lambda: self.source.still(number),
            lambda: self.source.replay(number, self._num_proposals),
            f"scene {number}",
            self.source.notice(),
        )

    def step(self, places: int) -> None:
        """The scene so many places further on, round and round."""
        numbers = self.source.numbers
        place = numbers.index(self.number) if self.number in numbers else -min(places, 0)
        number = int(numbers[(place + places) % len(numbers)])
        # The entry shows it, which is a change of the entry, which shows the scene.
        self._scene.value = number
        self.show(number)

    def sample(self) -> None:
        """A new scene by the chosen method."""
        method = self._method.value
        seed = int(self._seed_entry.value)
        self._seed_entry.value = seed + 1
        what = f"sampling by {method}, seed {seed}"

        def ask() -> None:
            number = self._num_proposals
            notice = self.source.notice(method)
            self._ask(lambda: self.source.sample(method, seed, number), None, what, notice)

        self._ask_again = ask
        ask()

    def screenshot(self) -> Path:
        """Saves what the browser shows as PNG here, and sends it to the browser as a download."""
        client = self.client
        height = client.camera.image_height
        width = client.camera.image_width
        pixels = client.get_render(height=height, width=width, transport_format="png", timeout=30)
        image = Image.new("RGB", (width, height), (255, 255, 255))
        layer = Image.fromarray(pixels)
        image.paste(layer, mask=layer.getchannel("A") if layer.mode == "RGBA" else None)
        buffer = io.BytesIO()
        image.save(buffer, format="PNG")
        self.folder.mkdir(parents=True, exist_ok=True)
        title = self.recording.title if self.recording else self.source.name
        path = _write_new(self.folder, title, buffer.getvalue())
        client.send_file_download(path.name, buffer.getvalue(), save_immediately=True)
        return path

    def play(self) -> None:
        """Plays the attempts from the chosen one to the end; called again, it stops."""
        if self._playing.is_set():
            self._playing.clear()
            return
        self._playing.set()
        self._play.label = "Stop"
        recording = self.recording
        attempts = recording.attempts if recording else ()
        last = len(attempts)
        start = int(self._slider.value)
        num_frames = round(_SECONDS_PER_ATTEMPT * _FRAMES_PER_SECOND)
        numbers = range(1 if start >= last else start + 1, last + 1)
        frames = [
            (number, frame)
            for number in numbers
            for frame in range(num_frames * (1 if attempts[number - 1].gathered is None else 2))
        ]
        for number, frame in frames:
            if not self._playing.is_set() or self.recording is not recording:
                break
            if frame == 0:
                self._slider.value = number
            self.nodes.at(number, min(frame / (num_frames - 1), 2.0))
            time.sleep(1 / _FRAMES_PER_SECOND)
        if self.recording is recording:
            self._redraw()
        self._playing.clear()
        self._play.label = "Play"

    # How it is done.

    @property
    def _num_proposals(self) -> int:
        """To be drawn at each attempt: none where they are not shown."""
        return _PROPOSALS if self.nodes.shown.density else 0

    def _ask(
        self, make: Callable[[], Replay], then: Callable[[], Replay] | None, what: str, notice: str
    ) -> None:
        with self._lock:
            self._request += 1
            request = self._request
        self._playing.clear()
        self._status.content = f"{what}: {notice} ..." if notice else f"{what} ..."
        self._worker.submit(self._answer, request, make, then)

    def _answer(
        self, request: int, make: Callable[[], Replay], then: Callable[[], Replay] | None
    ) -> None:
        """In the worker's thread: makes and shows a recording, and then its fuller version."""
        if request != self._request:
            return
        try:
            recording = make()
            is_whole = recording.attempts and (not self._num_proposals or _has_proposals(recording))
            if is_whole or then is None:
                self._set(request, recording, "")
                return
            self._set(
                request,
                recording,
                "_making its attempts again, which takes longer the first time ..._",
            )
            # In a turn of its own, so that other browsers need not wait for it.
            if request == self._request:
                self._worker.submit(self._answer, request, then, None)
        except ClutterGenError as error:
            self._report(request, str(error))
        except Exception as error:
            # Whatever goes wrong, the panel says so; a thread that dies in silence would leave it waiting.
            self._report(request, f"{type(error).__name__}: {error}")
            raise

    def _set(self, request: int, recording: Replay, note: str) -> None:
        with self._lock:
            if request != self._request or self._is_closed:
                return
            is_first = self.recording is None
            self.recording = recording
            self._note = note
            self.nodes.show(recording)
            if is_first:
                self._aim()
            last = len(recording.attempts)
            self._slider.max = max(last, 1)
            self._slider.value = last
            for control in (self._slider, self._play, self._failures, self._density):
                control.disabled = last == 0
            self._redraw()

    def _report(self, request: int, text: str) -> None:
        with self._lock:
            if request != self._request:
                return
            self._note = f"**Note:** {text}"
            if self.recording is None:
                self._status.content = self._note
            else:
                self._redraw()

    def _redraw(self) -> None:
        with self._lock:
            if self.recording is None:
                return
            number = int(self._slider.value) if self.recording.attempts else 0
            self.nodes.at(number if self.recording.attempts else 1, None)
            self._status.content = scene_words(self.recording, self._note)
            self._attempt.content = attempt_words(self.recording, number)

    def _aim(self) -> None:
        """Puts the camera where the whole region is seen."""
        if self.recording is None:
            return
        with self.client.atomic():
            self.client.camera.up_direction = (0.0, 0.0, 1.0)
            aim(self.client.camera, self.recording.region, self.recording.support.top)

    def _build_panel(self, methods: tuple[str, ...]) -> None:
        gui = self.client.gui
        numbers = self.source.numbers
        with gui.add_folder("Scene"):
            self._status = gui.add_markdown("")
            self._scene = gui.add_number(
                "Number", self.number, min=int(numbers[0]), max=int(numbers[-1]), step=1
            )
            turn = gui.add_button_group("Go to", ("Previous", "Next"))
        with gui.add_folder("Attempts"):
            self._attempt = gui.add_markdown("")
            self._slider = gui.add_slider("Attempt", min=0, max=1, step=1, initial_value=0)
            self._play = gui.add_button("Play")
            self._failures = gui.add_checkbox("All failed attempts", False)
            self._density = gui.add_checkbox("Where it may be proposed", False)
        with gui.add_folder("Show"):
            boxes = {
                "hulls": gui.add_checkbox("Hulls", False),
                "region": gui.add_checkbox("Queried region", True),
                "scene_cloud": gui.add_checkbox("Scene cloud", False),
                "object_cloud": gui.add_checkbox("Object cloud", False),
                "failures": self._failures,
                "density": self._density,
            }
        with gui.add_folder("New scene"):
            self._method = gui.add_dropdown("Method", methods or ("none",), disabled=not methods)
            self._seed_entry = gui.add_number("Seed", 1, min=0, max=2**31 - 1, step=1)
            sample = gui.add_button("Sample", disabled=not methods)
        with gui.add_folder("Camera"):
            camera = gui.add_button_group("View", ("Reset", "Screenshot"))
            self._saved = gui.add_markdown("")
        turn.on_click(lambda _: self.step(-1 if turn.value == "Previous" else 1))
        sample.on_click(lambda _: self.sample())
        self._play.on_click(lambda _: self.play())
        camera.on_click(lambda _: self._on_camera(camera.value))
        self._scene.on_update(self._on_number)
        self._slider.on_update(self._on_slider)
        for name, box in boxes.items():
            box.on_update(self._setter(name, box))

    def _setter(self, name: str, box: Any) -> Callable[[Any], None]:
        def update(_: Any) -> None:
            setattr(self.nodes.shown, name, box.value)
            if name == "density" and box.value and not _has_proposals(self.recording):
                self._ask_again()
            self._redraw()

        return update

    def _on_camera(self, request: str) -> None:
        if request == "Reset":
            self._aim()
            return
        try:
            self._saved.content = f"saved as {self.screenshot()}"
        except (OSError, RuntimeError, TimeoutError) as error:
            self._saved.content = f"not saved: {error}"

    def _on_number(self, event: Any) -> None:
        # Only what a person typed: the panel's own changes have no client.
        if event.client is None:
            return
        number = int(self._scene.value)
        if number in self.source.numbers:
            self.show(number)
        else:
            self._status.content = f"{self.source.name} has no scene {number}"

    def _on_slider(self, event: Any) -> None:
        if event.client is not None:
            self._playing.clear()
            self._redraw()


def _has_proposals(recording: Replay | None) -> bool:
    return recording is not None and any(
        attempt.proposals is not None for attempt in recording.attempts
    )


def _write_new(folder: Path, title: str, data: bytes) -> Path:
    """Writes a file that is not there yet, TITLE-001.png and so on, whoever else writes there."""
    name = "".join(c if c.isalnum() or c in "-_" else "-" for c in title).replace("--", "-")
    for number in itertools.count(1):
        path = folder / f"{name}-{number:03d}.png"
        with suppress(FileExistsError), path.open("xb") as file:
            file.write(data)
            return path
    raise AssertionError("numbers do not end")


def free_port(host: str, port: int) -> int:
    """`port` itself if nobody listens there, or any free one for 0.

    Raises:
      ConfigError: the port is taken or may not be used, or the host is none of this machine's.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"port = {port}", "0 to 65535")
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            # As servers do: a port whose last connection is only just over is free.
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
            return int(trial.getsockname()[1])
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
            raise ConfigError(
                f"host = {host!r} cannot be listened on: {reason}",
                "a name or an address of this machine",
                "host='localhost', or host='0.0.0.0' for other machines too",
            ) from error
        raise ConfigError(
            f"{host}:{port} cannot be listened on: {reason}",
            "a free port",
            "port=0, which takes any",
        ) from error


def open_server(host: str, port: int, title: str) -> GuardedServer:
    """Starts a server that answers requests with its whole address, `server.url`, and no others.

    Raises:
      MissingExtraError: the extra `viewer` is not installed.
      ConfigError: the port cannot be had.
      ClutterGenError: this version of viser cannot be guarded.
    """
    try:
        from cluttergen_jax.rendering.viewer.guard import GuardedServer
    except ImportError as error:
        raise MissingExtraError("viewer", "the web viewer") from error
    # viser would take the next port without asking, and greets at length.
    port = free_port(host, port)
    with contextlib.redirect_stdout(io.StringIO()):
        server = GuardedServer(host, port, title)
    server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
    return server


def announce(
    server: GuardedServer,
    browser: bool,
    show: Callable[[str], None],
    notice: str = "",
    end: str = "Ctrl-C ends it",
) -> None:
    """Says where a server is and what ends it, and opens a browser if wanted."""
    show(f"viewer     {server.url} ({end})")
    if elsewhere := server.url_elsewhere:
        show(f"elsewhere  {elsewhere}")
    if notice:
        show(f"first      {notice}")
    if browser:
        webbrowser.open(server.url)


class Viewer:
    """Shows a source's scenes to whatever browsers come, until `close`.

    In a notebook it is shown below the cell, where the browser reaches this machine as localhost. A context
    manager, which closes it.

    Args:
      source: the scenes.
      server: of viser; see `open_server`.
      first: the scene that each browser begins with.
      folder: where screenshots go.

    Attributes:
      sessions: of the browsers that are there, by viser's number of the client.
    """

    def __init__(
        self, source: SceneSource, server: GuardedServer, first: int, folder: Path
    ) -> None:
        self.source = source
        self.server = server
        self.sessions: dict[int, Session] = {}
        self._is_closed = False
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="scenes")
        self._session_config = SessionConfig(source, source.methods, first, folder, self._worker)
        if source.notice():
            # What has to be compiled is begun before the first browser has come.
            self._worker.submit(source.still, first)
        server.on_client_disconnect(self._leave)
        server.on_client_connect(self._enter)

    @property
    def url(self) -> str:
        """The address, with its token, for a browser on this machine."""
        return self.server.url

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.source.name!r}, {'closed' if self._is_closed else self.url})"

    def _repr_html_(self) -> str:
        if self._is_closed:
            return html.escape(repr(self))
        url = html.escape(self.url)
        frame = (
            f'<iframe src="{url}" width="100%" height="{_FRAME_HEIGHT}" style="border: 0"></iframe>'
        )
        return f'{frame}<br><a href="{url}" target="_blank">{url}</a>'

    def close(self) -> None:
        """Stops what is under way and the server; of a closed viewer, nothing."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            sessions = list(self.sessions.values())
        for session in sessions:
            session.close()
        self._worker.shutdown(wait=True, cancel_futures=True)
        self.server.stop()

    def _enter(self, client: viser.ClientHandle) -> None:
        session = Session(self._session_config, client)
        with self._lock:
            self.sessions[client.client_id] = session
        if client.client_id not in self.server.get_clients():
            # It left while its panel was being made.
            self._leave(client)

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()


class DisplayError(ClutterGenError):
    """There is no screen to open a window on."""


def check_display() -> None:
    """Refuses to open a window where there is no screen (DisplayError: there is none)."""
    if platform.system() == "Linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise DisplayError(
            "MuJoCo's viewer needs a screen, and there is none (DISPLAY is not set)",
            hint="the web viewer, which is the same command without `native`, or ssh -X",
        )


def show_native(model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Opens MuJoCo's viewer and returns when its window is closed.

    Args:
      model: of the scene; qpos: f64[nq], as it begins.

    Raises:
      DisplayError: there is no screen, or no window can be opened on it.
    """
    check_display()
    import mujoco.viewer

    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    try:
        mujoco.viewer.launch(model, data)
    except (RuntimeError, mujoco.FatalError) as error:
        raise DisplayError(
            f"MuJoCo's viewer could not open a window ({error})",
            hint="the web viewer: leave `native` out",
        ) from error
