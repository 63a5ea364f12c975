"""Layouts shown to people: all on one sheet, or one by one in a browser, where one of them is taken."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.downstream.rearrange.episode import draw_layouts
from cluttergen_jax.downstream.rearrange.layouts import Layouts
from cluttergen_jax.downstream.rearrange.observe import Observer
from cluttergen_jax.downstream.rearrange.task import (
    RearrangeOptions,
    RearrangeProblem,
    RearrangeResult,
)
from cluttergen_jax.downstream.words import LayoutRule
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import Replay
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import (
    GREEN,
    CameraView,
    PictureConfig,
    RenderStyle,
    SceneNodes,
    Trail,
    add_ghost,
    aim,
    close_points,
    contact_sheet,
    open_scene_renderer,
    save_png,
    with_frame,
)

if TYPE_CHECKING:
    import viser

_PICTURE = PictureConfig(360, 270, 16, CameraView(azimuth=0.0, elevation=-58.0))
"""From where the arm stands."""
_BLUE = (0.16, 0.43, 0.86)
_BLUE_BYTES = (40, 110, 220)
_GHOST_ALPHA = 0.62
_GHOST_TINT = 0.3
_LIFT = 0.01
_COLUMNS = 5


def layout_sheet(
    task: RearrangeProblem, layouts: Layouts, chosen: int = -1, picture: PictureConfig | None = None
) -> np.ndarray:
    """A contact sheet of layouts, under each what is known of it before it is chosen.

    Objects are opaque where they stand and translucent where they would go, a blue line from one to the
    other.

    Args:
      chosen: the number of the layout that is framed in green; -1 frames none.
      picture: of each layout.

    Returns:
      u8[H, W, 3].

    Raises:
      ConfigError: there is no such layout, or none at all.
      RendererError: nothing here can draw.
    """
    if not -1 <= chosen < len(layouts) or not len(layouts):
        raise ConfigError(f"layout {chosen} of {len(layouts)}", "-1, or the number of a layout")
    scene = task.scene
    num_moved = task.setting.num_objects
    goals = layouts.poses[:, :num_moved]
    ghosts = scene.objects[:num_moved]
    points = [close_points(scene.objects, scene.poses, scene.support)]
    points += [close_points(ghosts, each, None) for each in goals]
    picture = picture or _PICTURE
    standing = [RenderStyle(pose) for pose in scene.poses]
    images = []
    with open_scene_renderer(
        (*scene.objects, *ghosts), scene.support, np.concatenate(points), picture
    ) as shown:
        for number, goal in enumerate(goals):
            moved = [RenderStyle(pose, _GHOST_ALPHA, _BLUE, _GHOST_TINT) for pose in goal]
            ways = [_way(*ends) for ends in zip(scene.poses[:num_moved], goal, strict=True)]
            image = shown.picture([*standing, *moved], ways)
            images.append(with_frame(image, GREEN) if number == chosen else image)
    captions = [layout_words(layouts, number, number == chosen) for number in range(len(layouts))]
    return contact_sheet(images, captions, _COLUMNS)


def layout_words(layouts: Layouts, number: int, is_chosen: bool = False) -> str:
    """What is known of a layout, in a line."""
    gap = layouts.clearance[number]
    reach = layouts.reach[number]
    way = layouts.travel[number]
    mark = ", chosen" if is_chosen else ""
    return f"{number}{mark}: gap {1e3 * gap:.0f} mm, reach {reach:.0%}, way {1e2 * way:.0f} cm"


def _way(start: np.ndarray, goal: np.ndarray) -> Trail:
    """A line from where an object stands to where it would go."""
    points = np.stack([start[:3], goal[:3]])
    points[:, 2] += _LIFT
    return Trail(points, _BLUE)


def save_sheets(
    rows: Sequence[RearrangeResult],
    task_of: Callable[[int], RearrangeProblem],
    options: RearrangeOptions,
    observer: Observer,
    folder: Path,
) -> list[Path]:
    """Writes layouts-NUMBER.png for each episode that had layouts; those that are there already stay.

    Args:
      rows: of all episodes, by number. task_of: what an episode was given, by number.

    Returns:
      The sheets that were made.
    """
    paths = {
        number: folder / f"layouts-{number}.png" for number, row in enumerate(rows) if row.layouts
    }
    missing = {number: path for number, path in paths.items() if not path.exists()}
    with Progress("layouts", len(missing), "sheet") as progress:
        for number, path in missing.items():
            task = task_of(number)
            layouts = draw_layouts(task, options, observer)
            save_png(layout_sheet(task, layouts, rows[number].layout), path)
            progress.update()
    return list(missing.values())


_ALPHA = 0.5
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

    def __call__(self, task: RearrangeProblem, poses: np.ndarray, layouts: Layouts) -> int:
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

    def _show(self, task: RearrangeProblem, poses: np.ndarray, layouts: Layouts) -> None:
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
                "/ways", ways.astype(np.float32), _BLUE_BYTES, thickness=0.003
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
