"""Figures of a recording: an object's attempts, ringed until it stands; where it was proposed, as heat."""

from __future__ import annotations

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane, transform_points
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.scene_renderer import (
    RED,
    PictureConfig,
    RenderStyle,
    SceneRenderer,
    open_scene_renderer,
)
from cluttergen_jax.rendering.sheet import ring_around, with_caption, with_rings
from cluttergen_jax.sensing.rays import SUPPORT

GREEN = (0.13, 0.55, 0.25)
_FEWEST_FAILURES = 2
_GHOST_ALPHA = 0.6
_GHOST_TINT = 0.72


def closed_loop_slot(recording: Replay) -> int:
    """The object that tells the most: it failed at least so often, then stood, on the fullest table.

    One whose attempts all ended near the region comes first: a picture that has to show the floor as well
    shows the table small.

    Raises:
      ConfigError: no object of the recording failed so often and stood in the end.
    """
    candidates = []
    for index in recording.placed:
        attempts = recording.last_turn(int(index))
        if len(attempts) > _FEWEST_FAILURES and attempts[-1].is_stable:
            crowd = int(attempts[-1].is_placed.sum())
            candidates.append(
                (not _is_scattered(recording, attempts), crowd, len(attempts), int(index))
            )
    if not candidates:
        most = max((len(recording.last_turn(int(i))) - 1 for i in recording.placed), default=0)
        raise ConfigError(
            f"{recording.title}: no object failed {_FEWEST_FAILURES} times and then stood (the most is "
            f"{most})",
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


def closed_loop_figure(recording: Replay, picture: PictureConfig | None = None) -> np.ndarray:
    """Draws an object where it stands, and where each earlier attempt left it: red, ringed, with its path.

    The other objects stand as they did then. Numbers count the attempts; the last one is ringed in green.

    Args:
      picture: None is 1200 x 900 pixels.

    Returns:
      uint8[height, width, 3].
    """
    picture = picture or PictureConfig(width=1200, height=900)
    index = closed_loop_slot(recording)
    attempts = recording.last_turn(index)
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


NUM_PROPOSALS = 2048
"""Drawn for a picture."""
SIDE = 40
"""Cells along each side of the region."""
_BLUR = 1.8
"""Cells: the standard deviation of what one proposal is spread over."""
_NEAR_TOP = 0.002
_FAINTEST = 0.05
"""Of the density's peak, below which points are left out."""
_FAINT = np.array([80.0, 205.0, 255.0])
_STRONG = np.array([70.0, 10.0, 150.0])
_MOST_OPAQUE = 0.85


def density_of(proposals: np.ndarray) -> np.ndarray:
    """f64[SIDE, SIDE], axis 0 along the region's x: how often proposals f[N, 4] fall there; the most is 1.

    Raises:
      ConfigError: there are none.
    """
    from scipy.ndimage import gaussian_filter

    if len(proposals) == 0:
        raise ConfigError("no proposals", "at least one", f"num_proposals={NUM_PROPOSALS}")
    counts, _, _ = np.histogram2d(
        proposals[:, 0], proposals[:, 1], bins=SIDE, range=((0, 1), (0, 1))
    )
    # What lies at the region's edge stays inside it.
    smooth = gaussian_filter(counts, _BLUR, mode="nearest")
    return smooth / smooth.max()


def heat_image(density: np.ndarray) -> np.ndarray:
    """uint8[side, side, 4]: clear where nothing is proposed, light blue, then violet; axes as `density`."""
    strength = np.sqrt(density)[..., None]
    rgb = _FAINT + (_STRONG - _FAINT) * strength
    return np.concatenate([rgb, 255 * _MOST_OPAQUE * strength], axis=-1).round().astype(np.uint8)


def density_figure(recording: Replay, picture: PictureConfig | None = None) -> np.ndarray:
    """The scene before the last object's first attempt, the table coloured by where that was proposed.

    Args:
      recording: with proposals (`Recorder.record`).
      picture: None is 1200 x 900 pixels.

    Returns:
      uint8[height, width, 3].

    Raises:
      ConfigError: there are no proposals, or no attempts; or objects go on a slope, or on
        several surfaces.
    """
    asked = [surface for surface, _ in recording.support.asked] if recording.support.named else []
    if len(asked) > 1 or not all(surface.is_level for surface in asked):
        what = f"{len(asked)} surfaces" if len(asked) > 1 else "a slope"
        raise ConfigError(
            f"a heat map of {recording.title}, on {what}", "scenes on one level surface"
        )
    picture = picture or PictureConfig(width=1200, height=900)
    if not recording.attempts:
        raise ConfigError(f"{recording.title}: no attempts", "a recording with attempts")
    attempt = recording.last_turn(recording.attempts[-1].object_index)[0]
    if attempt.proposals is None:
        raise ConfigError(
            f"{recording.title} without proposals", "a recording with `num_proposals`"
        )
    standing = np.flatnonzero(attempt.is_placed)
    objects = [recording.objects[index] for index in standing]
    region = recording.region
    top = recording.support.top
    corners = np.column_stack([region.corners, np.full(4, top)])
    points = np.concatenate(
        [close_points(objects, attempt.poses[standing], recording.support), corners]
    )
    with open_scene_renderer(objects, recording.support, points, picture) as renderer:
        styles = [RenderStyle(pose) for pose in attempt.poses[standing]]
        image = renderer.picture(styles)
        heat = _heat_seen(renderer, styles, recording, density_of(attempt.proposals))
    alpha = heat[..., 3:] / 255
    image = (image * (1 - alpha) + heat[..., :3] * alpha).round().astype(np.uint8)
    name = recording.names[attempt.object_index]
    return with_caption(image, f"where {name} is proposed, {len(standing)} objects standing")


def _heat_seen(
    renderer: SceneRenderer, styles: list[RenderStyle], recording: Replay, density: np.ndarray
) -> np.ndarray:
    """f64[height, width, 4]: the heat of each pixel that sees the region, clear elsewhere."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    seen = renderer.measure(styles)
    points = np.nan_to_num(renderer.camera.points(seen.depth), nan=1e3)
    region = recording.region
    local = rotate_in_plane(points[..., :2] - region.center, -region.yaw)
    action = (local / region.half_extents + 1) / 2
    is_top = (seen.label == SUPPORT) & (np.abs(points[..., 2] - recording.support.top) < _NEAR_TOP)
    is_top &= ((action >= 0) & (action <= 1)).all(-1)
    cells = np.clip(action, 0, 1) * len(density) - 0.5
    level = map_coordinates(density, np.moveaxis(cells, -1, 0), order=1, mode="nearest")
    heat = heat_image(level).astype(np.float64)
    # Edges of objects are smooth in the picture.
    heat[..., 3] = gaussian_filter(np.where(is_top, heat[..., 3], 0.0), 0.6)
    return heat


def heat_points(recording: Replay, attempt: Attempt) -> tuple[np.ndarray, np.ndarray, float]:
    """The heat of an attempt as points on the table: where anything to speak of is proposed.

    Returns:
      f32[M, 3], metres, world frame; their colours uint8[M, 3]; and how far apart neighbours are, metres.
    """
    assert attempt.proposals is not None
    density = density_of(attempt.proposals)
    region = recording.region
    side = len(density)
    along = (np.arange(side) + 0.5) / side * 2 - 1
    local = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1) * region.half_extents
    xy = rotate_in_plane(local, region.yaw) + region.center
    is_seen = density > _FAINTEST
    points = np.column_stack([xy[is_seen], np.full(is_seen.sum(), recording.support.top)])
    colours = heat_image(density)[is_seen, :3]
    return points.astype(np.float32), colours, 2 * max(region.half_extents) / side
