"""The panel for placing objects by hand: a handle on the current object, buttons, and what came of it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.placement.hand import HandScene
from cluttergen_jax.placement.replay import Replay
from cluttergen_jax.rendering.viewer.scene_nodes import (
    FailedAttempt,
    ObjectNodes,
    SceneNodes,
    Shown,
    aim,
    outline,
)
from cluttergen_jax.rendering.viewer.source import HandScenes
from cluttergen_jax.rendering.viewer.words import (
    check_words,
    drop_words,
    lowered_words,
    progress_words,
)
from cluttergen_jax.types import Verdict

if TYPE_CHECKING:
    import viser

_UPRIGHT = np.array([0, 0, 0, 1, 0, 0, 0], np.float64)
_GREEN = (20, 130, 60)
_HANDLE = 0.09
"""Metres by which a handle's arrows are longer than the object is wide."""
_HELP = "Drag the square or the arrows to move the object, the arc to turn it; then lower it and let it go."


class PlacingPanel:
    """One scene at a time in the hands of the user who has the page open; several browsers see the same.

    Whatever is asked for is done in one thread, in the order in which it was asked.

    Args:
      scenes: what is to be made, and where it is kept; server: of viser.

    Attributes:
      scene: under way, or just kept.
      handle: what drags the current object.
    """

    def __init__(self, scenes: HandScenes, server: viser.ViserServer) -> None:
        self.scenes = scenes
        self.server = server
        self.nodes = SceneNodes(server)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="placing")
        self._closed = threading.Event()
        self._failed: FailedAttempt | None = None
        self._held: ObjectNodes | None = None
        self._shadow: Any = None
        self._shown_object: int | None = None
        self._build_panel()
        self._begin()
        aim(server.initial_camera, scenes.region, scenes.support.top)
        server.on_client_connect(self._enter)
        threading.Thread(target=self._tick, daemon=True).start()

    scene: HandScene
    handle: viser.TransformControlsHandle
    # viser types the value of its handles as read-only, which it is not.
    _object: Any

    def close(self) -> None:
        """Ends what is under way; what was not kept is lost."""
        self._closed.set()
        self._worker.shutdown(wait=True, cancel_futures=True)

    # What the buttons do; each returns what the panel then shows.

    def lower(self) -> str:
        """Lowers the current object to first contact."""
        return lowered_words(self.scene, self.scene.lower())

    def drop(self) -> str:
        """Lets the current object go; what fails is shown in red where it ended."""
        drop = self.scene.drop()
        attempt = drop.attempt
        if not attempt.is_stable:
            asset = self.scene.objects[attempt.object_index]
            self._failed = FailedAttempt(self.server, 0, asset, attempt)
            self._failed.place(None, True)
        words = drop_words(self.scene, drop)
        return words if self.scene.left else f"{words}. Every object is placed: save the scene"

    def undo(self) -> str:
        """Takes the object that was placed last back."""
        return f"{self.scene.names[self.scene.undo()]} was taken back"

    def skip(self) -> str:
        """The next object's turn."""
        self.scene.skip()
        return ""

    def choose(self) -> str:
        """The turn of the object that the list names."""
        self.scene.choose(self.scene.names.index(self._object.value))
        return ""

    def save(self) -> str:
        """Keeps the scene if all its objects stand together."""
        check = self.scene.check()
        words = check_words(self.scene, check)
        if check.verdict != Verdict.STABLE:
            return words
        self.scenes.keep(self.scene)
        return f"**saved** as scene {self.scene.number} of {self.scenes.name}: {words}"

    def new(self) -> str:
        """The next scene; one that is under way is given up only if that is confirmed."""
        if self.scene.is_closed:
            self._begin()
            self.scene.touch()
            return _HELP
        if not self.scene.num_attempts:
            return "nothing was tried in this scene yet"
        with self.server.gui.add_modal(f"Give up scene {self.scene.number}?") as modal:
            self.server.gui.add_markdown(
                "It is not saved. Given up, it is kept in the bank as one that failed, unless all its "
                "objects are placed and stand together."
            )
            scene = self.scene
            for label, act in (
                ("Give up", lambda: self.give_up(scene)),
                ("Go on with it", lambda: ""),
            ):
                button = self.server.gui.add_button(label)
                button.on_click(lambda _: modal.close())
                button.on_click(self._make_callback(act))
        return ""

    def give_up(self, scene: HandScene) -> str:
        """Keeps the scene as it is, and begins the next; a scene that is over stays what it is."""
        if scene is not self.scene or scene.is_closed:
            return ""
        if not self.scene.left:
            self.scene.check()
        self.scenes.keep(self.scene)
        words = f"scene {self.scene.number} was kept as one that failed"
        if self.scene.result().is_success:
            words = f"scene {self.scene.number} stands, and was saved"
        self._begin()
        self.scene.touch()
        return words

    # How it is done.

    def _begin(self) -> None:
        self.scene = self.scenes.begin()
        everything = np.zeros_like(self.scene.is_placed)
        everything[self.scene.all] = True
        self.nodes.show(
            Replay(
                title=f"scene {self.scene.number}",
                objects=self.scene.objects,
                names=self.scene.names,
                support=self.scenes.support,
                region=self.scenes.region,
                poses=self.scene.poses,
                is_placed=everything,
                is_success=False,
                verdict="",
                keep_out=self.scenes.keep_out,
            )
        )
        self._show(_HELP)

    def _make_callback(self, act: Callable[[], str]) -> Callable[[Any], Any]:
        """A callback of viser's that does `act` after whatever was asked for before."""

        # Functions that are not async run in many threads, in any order.
        async def callback(_: Any) -> None:
            if not self._closed.is_set():
                self._worker.submit(self._do, act)

        return callback

    def _do(self, act: Callable[[], str]) -> None:
        if self._failed is not None:
            self._failed.remove()
            self._failed = None
        try:
            words = act()
        except ClutterGenError as error:
            words = f"**Note:** {error}"
        except Exception as error:
            # A thread that dies in silence would leave the panel waiting.
            self._show(f"**Note:** {type(error).__name__}: {error}")
            raise
        self._show(words)

    def _show(self, words: str) -> None:
        """Shows the scene as it is now, and says something."""
        scene = self.scene
        server = self.server
        with server.atomic():
            self.nodes.put(scene.poses, scene.is_placed)
            self._show_held()
            is_open = bool(scene.left) and not scene.is_closed
            self._object.options = tuple(scene.names[index] for index in scene.left) or ("none",)
            self._object.value = self._object.options[0]
            for control in (self._object, self._lower, self._drop, self._skip):
                control.disabled = not is_open
            self._undo.disabled = not scene.can_undo
            self._save.disabled = is_open or scene.is_closed
            self._said.content = words
            self._status.content = progress_words(scene)

    def _show_held(self) -> None:
        scene = self.scene
        current = self.scene.current
        self.handle.visible = current is not None and not scene.is_closed
        if current != self._shown_object:
            for node in (self._held, self._shadow):
                if node is not None:
                    node.remove()
            self._held = self._shadow = None
            if current is not None:
                asset = scene.objects[current]
                self._held = ObjectNodes(self.server, "/held/object", asset)
                self._held.place(_UPRIGHT, True, Shown(), False)
                half = asset.half_extents
                footprint = Rectangle((0.0, 0.0), (float(half[0]), float(half[1])), 0.0)
                self._shadow = self.server.scene.add_line_segments(
                    "/held/footprint", outline(footprint, 0.0), _GREEN, thickness=0.003
                )
                self.handle.scale = float(np.hypot(*half[:2])) + _HANDLE
            self._shown_object = current
        pose = scene.held_pose
        self.handle.position = pose[:3]
        self.handle.wxyz = pose[3:]
        if self._shadow is not None:
            # Where it is held over, drawn on the top.
            self._shadow.position = (0.0, 0.0, 0.002 - scene.held.z)

    def _build_panel(self) -> None:
        gui = self.server.gui
        scene = self.server.scene
        with gui.add_folder("Scene"):
            self._status = gui.add_markdown("")
            self._said = gui.add_markdown("")
            self._save = gui.add_button("Save scene")
            new = gui.add_button("New scene")
        with gui.add_folder("Current object"):
            self._object = gui.add_dropdown("Object", ("none",))
            self._lower = gui.add_button("Lower")
            self._drop = gui.add_button("Drop")
            self._undo = gui.add_button("Undo")
            self._skip = gui.add_button("Next object")
        for button, act in (
            (self._save, self.save),
            (new, self.new),
            (self._lower, self.lower),
            (self._drop, self.drop),
            (self._undo, self.undo),
            (self._skip, self.skip),
        ):
            button.on_click(self._make_callback(act))
        chosen = self._make_callback(self.choose)

        async def on_choice(event: Any) -> None:
            # Only what a person chose: the panel's own changes have no client.
            if event.client is not None:
                await chosen(event)

        self._object.on_update(on_choice)
        # Only along x and y, and about z.
        self.handle = scene.add_transform_controls(
            "/held", active_axes=(True, True, False), depth_test=False, line_width=4.0
        )
        self.handle.on_update(self._on_drag)

    async def _on_drag(self, event: Any) -> None:
        self.scene.touch()
        if event.phase == "end" and not self._closed.is_set():
            position = np.array(event.target.position)
            wxyz = np.array(event.target.wxyz)
            self._worker.submit(self._move, position, wxyz)

    def _move(self, position: np.ndarray, wxyz: np.ndarray) -> None:
        """In the worker's thread: the object is held elsewhere; why it failed before is still to be seen."""
        self.scene.hold_at(position, wxyz)
        self._show(self._said.content)

    def _enter(self, client: viser.ClientHandle) -> None:
        seen = np.zeros(7)

        @client.camera.on_update
        async def _(camera: viser.CameraHandle) -> None:
            # Looking around is work, too; a window that changes its size is not.
            pose = np.array([*camera.position, *camera.wxyz])
            if not np.allclose(pose, seen):
                self.scene.touch()
            seen[:] = pose

    def _tick(self) -> None:
        """Shows the seconds."""
        while not self._closed.wait(1.0):
            words = progress_words(self.scene)
            if words != self._status.content:
                self._status.content = words
