"""Layouts as pictures: each drawn over the scene as it stands, side by side on one sheet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from cluttergen_jax.downstream.rearrange.episode import draw_layouts
from cluttergen_jax.downstream.rearrange.layouts import Layouts
from cluttergen_jax.downstream.rearrange.observe import Observer
from cluttergen_jax.downstream.rearrange.task import (
    RearrangeOptions,
    RearrangeResult,
    RearrangeTask,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import (
    GREEN,
    CameraView,
    PictureConfig,
    RenderStyle,
    Trail,
    close_points,
    contact_sheet,
    open_scene_renderer,
    save_png,
    with_frame,
)

_PICTURE = PictureConfig(360, 270, 16, CameraView(azimuth=0.0, elevation=-58.0))
"""From where the arm stands."""
_BLUE = (0.16, 0.43, 0.86)
_GHOST_ALPHA = 0.62
_GHOST_TINT = 0.3
_LIFT = 0.01
_COLUMNS = 5


def layout_sheet(
    task: RearrangeTask, layouts: Layouts, chosen: int = -1, picture: PictureConfig | None = None
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
    task_of: Callable[[int], RearrangeTask],
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
