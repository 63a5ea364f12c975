"""The panel in a browser in which a person looks at layouts one by one and takes one of them."""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.downstream.rearrange.layouts import Layouts
from cluttergen_jax.downstream.rearrange.sheet import layout_words
from cluttergen_jax.downstream.rearrange.task import RearrangeTask
from cluttergen_jax.downstream.words import LayoutRule
from cluttergen_jax.placement import Replay
from cluttergen_jax.rendering import SceneNodes, add_ghost, aim

if TYPE_CHECKING:
    import viser

_ALPHA = 0.5
_BLUE = (40, 110, 220)
_LIFT = 0.01
_WAIT = "The arm is at work; the next scene comes when it has ended."


class LayoutPanel:
    """One scene after another: its layouts as translucent objects, and a button that takes the one shown.

    Several browsers see the same. It is a `task.Chooser`.

    Args:
      server: of viser.
      rule: what comes first, of the layouts.

    Attributes:
      number: of the layout that is shown.
    """

    def __init__(self, server: viser.ViserServer, rule: LayoutRule) -> None:
        self.server = server
        self.number = -1
        self._rule: LayoutRule = rule
        self._nodes = SceneNodes(server)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="layouts")
        self._taken: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._layouts: Layouts | None = None
        self._order: list[int] = []
        self._starts = np.zeros((0, 3))
        self._ghosts: list[Any] = []
        with server.gui.add_folder("Layout"):
            self._said = server.gui.add_markdown("The first scene is made ...")
            self._buttons = [
                server.gui.add_button(label)
                for label in ("Next layout", "Previous layout", "Take this one")
            ]
        for button, act in zip(self._buttons, (self.next, self.previous, self.take), strict=True):
            button.on_click(self._callback(act))
        self._enable(False)

    def __call__(self, task: RearrangeTask, poses: np.ndarray, layouts: Layouts) -> int:
        """Shows layouts, and waits until one is taken; its number."""
        self._worker.submit(self._show, task, poses, layouts).result()
        return self._taken.get()

    def close(self) -> None:
        """Ends what is under way."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    # What the buttons do.

    def next(self) -> None:
        """The next layout, round and round."""
        self._step(1)

    def previous(self) -> None:
        """The layout before."""
        self._step(-1)

    def take(self) -> None:
        """Takes the layout that is shown."""
        if self._layouts is None:
            return
        self._layouts = None
        self._enable(False)
        self._said.content = f"**layout {self.number}** was taken. {_WAIT}"
        self._taken.put(self.number)

    # How it is done.

    def _callback(self, act: Callable[[], None]) -> Callable[[Any], Any]:
        """A callback of viser's that does `act` after whatever was asked for before."""

        # Functions that are not async run in many threads, in any order.
        async def callback(_: Any) -> None:
            self._worker.submit(act)

        return callback

    def _enable(self, is_enabled: bool) -> None:
        for button in self._buttons:
            button.disabled = not is_enabled

    def _show(self, task: RearrangeTask, poses: np.ndarray, layouts: Layouts) -> None:
        """Another scene, and the best of its layouts."""
        scene = task.scene
        num_moved = task.setting.num_objects
        for ghost in self._ghosts:
            ghost.remove()
        self._nodes.show(
            Replay(
                title=task.setting.name,
                objects=scene.objects,
                names=scene.names,
                support=scene.support,
                region=task.setting.target,
                poses=poses,
                is_placed=np.ones(len(poses), bool),
                is_success=False,
                verdict="",
            )
        )
        self._ghosts = [
            add_ghost(self.server, f"/layout/{number}", asset, _colour(asset))
            for number, asset in enumerate(scene.objects[:num_moved])
        ]
        if self.number < 0:
            for each in (
                self.server.initial_camera,
                *(c.camera for c in self.server.get_clients().values()),
            ):
                aim(each, scene.support.region, scene.support.top)
        self._layouts = layouts
        self._starts = poses[:num_moved, :3]
        self._order = layouts.rank(self._rule).tolist()
        self.number = self._order[0]
        self._enable(True)
        self._draw()

    def _step(self, places: int) -> None:
        if self._layouts is None:
            return
        place = self._order.index(self.number) + places
        self.number = self._order[place % len(self._order)]
        self._draw()

    def _draw(self) -> None:
        assert self._layouts is not None
        goals = self._layouts.poses[self.number, : len(self._ghosts)]
        with self.server.atomic():
            for ghost, pose in zip(self._ghosts, goals, strict=True):
                ghost.position = pose[:3]
                ghost.wxyz = pose[3:]
            ways = np.stack([self._starts, goals[:, :3]], axis=1) + np.array([0.0, 0.0, _LIFT])
            self.server.scene.add_line_segments(
                "/ways", ways.astype(np.float32), _BLUE, thickness=0.003
            )
        place = self._order.index(self.number) + 1
        words = layout_words(self._layouts, self.number)
        self._said.content = f"**{place} of {len(self._order)}**: layout {words}"


def _colour(asset: ObjectAsset) -> tuple[float, float, float, float]:
    """The mean colour of an object, translucent."""
    if not asset.pieces:
        return (0.5, 0.5, 0.5, _ALPHA)
    weights = [len(piece.mesh.vertices) for piece in asset.pieces]
    red, green, blue, _ = np.average(
        [piece.mean_rgba for piece in asset.pieces], axis=0, weights=weights
    )
    return (float(red), float(green), float(blue), _ALPHA)
