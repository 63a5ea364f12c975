"""The closed-loop figure: one object on a crowded table, each failed attempt ringed, until it stands."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import transform_points
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import (
    RED,
    PictureConfig,
    RenderStyle,
    open_scene_renderer,
)
from cluttergen_jax.rendering.sheet import ring_around, with_rings

GREEN = (0.13, 0.55, 0.25)
_GHOST_ALPHA = 0.6
_GHOST_TINT = 0.72


def closed_loop_slot(recording: Replay, min_failures: int = 2) -> int:
    """The object that tells the most: it failed at least so often, then stood, on the fullest table.

    One whose attempts all ended near the region comes first: a picture that has to show the floor as well
    shows the table small.

    Raises:
      ConfigError: no object of the recording failed so often and stood in the end.
    """
    candidates = []
    for index in recording.placed:
        attempts = recording.last_turn(int(index))
        if len(attempts) > min_failures and attempts[-1].is_stable:
            crowd = int(attempts[-1].is_placed.sum())
            candidates.append(
                (not _is_scattered(recording, attempts), crowd, len(attempts), int(index))
            )
    if not candidates:
        most = max((len(recording.last_turn(int(i))) - 1 for i in recording.placed), default=0)
        raise ConfigError(
            f"{recording.title}: no object failed {min_failures} times and then stood (the most is {most})",
            "a recording with one",
            "another scene, or scenes by method='random'",
        )
    return max(candidates)[-1]


def _is_scattered(recording: Replay, attempts: tuple[Attempt, ...]) -> bool:
    """Whether an attempt ended farther from the region's middle than its corners are, or high above it."""
    region = recording.region
    top = recording.support.top
    ends = np.array([each.trajectory[-1, :3] for each in attempts])
    away = np.linalg.norm(ends[:, :2] - region.center, axis=1)
    height = np.abs(ends[:, 2] - top)
    return bool((away > np.hypot(*region.half_extents)).any() or (height > 0.4).any())


def closed_loop_figure(
    recording: Replay, object_index: int | None = None, picture: PictureConfig | None = None
) -> np.ndarray:
    """Draws an object where it stands, and where each earlier attempt left it: red, ringed, with its path.

    The other objects stand as they did then. Numbers count the attempts; the last one is ringed in green.

    Args:
      object_index: whose attempts; None takes `closed_loop_slot`.
      picture: None is 1200 x 900 pixels.

    Returns:
      uint8[height, width, 3].
    """
    picture = picture or PictureConfig(width=1200, height=900)
    index = closed_loop_slot(recording) if object_index is None else object_index
    attempts = recording.last_turn(index)
    if not attempts or not attempts[-1].is_stable:
        raise ConfigError(f"object {index} has no attempt that succeeded", "an object that stands")
    *failed, last = attempts
    others = np.flatnonzero(last.is_placed)
    actors = [recording.objects[i] for i in others] + [recording.objects[index]] * len(attempts)
    standing = [RenderStyle(pose) for pose in last.settled[others]] + [
        RenderStyle(last.settled[index])
    ]
    ghosts = [
        RenderStyle(each.trajectory[-1, :7], _GHOST_ALPHA, RED, _GHOST_TINT) for each in failed
    ]
    styles = [*standing, *ghosts]
    trails = [trail for each in failed for trail in trails_of(each)]
    poses = np.array([style.pose for style in styles])
    points = np.concatenate(
        [close_points(actors, poses, recording.support), *(trail.points for trail in trails)],
        axis=0,
    )
    with open_scene_renderer(actors, recording.support, points, picture) as renderer:
        image = renderer.picture(styles, trails)
        vertices = np.concatenate([part.vertices for part in recording.objects[index].parts])
        rings = []
        for order, pose in enumerate([*(ghost.pose for ghost in ghosts), last.settled[index]]):
            outline, _ = renderer.camera.project(transform_points(pose, vertices))
            rgb = RED if order < len(failed) else GREEN
            room = renderer.config.height / 90
            rings.append(ring_around(outline, rgb, str(order + 1), room))
    return with_rings(image, rings)


def trails_of(
    attempt: Attempt, num_steps: int | None = None, alpha: float = 0.9
) -> tuple[Trail, Trail]:
    """An attempt's path up to a step, and a dot where it began."""
    points = attempt.trajectory[: None if num_steps is None else num_steps + 1, :3]
    dot = points[:1] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e-4]])
    return Trail(points, RED, alpha), Trail(dot, RED, alpha, 0.0045)
