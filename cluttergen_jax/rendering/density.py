"""Where a method would put an object: its proposals as a heat map over the queried region."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.placement.replay import Attempt, Replay
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.scene_renderer import (
    PictureConfig,
    RenderStyle,
    SceneRenderer,
    open_scene_renderer,
)
from cluttergen_jax.rendering.sheet import with_caption
from cluttergen_jax.sensing.rays import SUPPORT

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


def density_of(proposals: np.ndarray, side: int = SIDE) -> np.ndarray:
    """f64[side, side], axis 0 along the region's x: how often proposals f[N, 4] fall there; the most is 1.

    Raises:
      ConfigError: there are none.
    """
    if len(proposals) == 0:
        raise ConfigError("no proposals", "at least one", f"num_proposals={NUM_PROPOSALS}")
    counts, _, _ = np.histogram2d(
        proposals[:, 0], proposals[:, 1], bins=side, range=((0, 1), (0, 1))
    )
    # What lies at the region's edge stays inside it.
    smooth = gaussian_filter(counts, _BLUR * side / SIDE, mode="nearest")
    return smooth / smooth.max()


def heat_image(density: np.ndarray) -> np.ndarray:
    """uint8[side, side, 4]: clear where nothing is proposed, light blue, then violet; axes as `density`."""
    strength = np.sqrt(density)[..., None]
    rgb = _FAINT + (_STRONG - _FAINT) * strength
    return np.concatenate([rgb, 255 * _MOST_OPAQUE * strength], axis=-1).round().astype(np.uint8)


def density_figure(
    recording: Replay, object_index: int | None = None, picture: PictureConfig | None = None
) -> np.ndarray:
    """The scene as it was before an object's first attempt, the table coloured by where it was proposed.

    Args:
      recording: with proposals (`Recorder.record`).
      object_index: of the world; None takes the object of the last attempt.
      picture: None is 1200 x 900 pixels.

    Returns:
      uint8[height, width, 3].

    Raises:
      ConfigError: there are no proposals, or no attempt at that object; or objects go on a slope, or on
        several surfaces.
    """
    asked = [surface for surface, _ in recording.support.asked] if recording.support.named else []
    if len(asked) > 1 or not all(surface.is_level for surface in asked):
        what = f"{len(asked)} surfaces" if len(asked) > 1 else "a slope"
        raise ConfigError(
            f"a heat map of {recording.title}, on {what}", "scenes on one level surface"
        )
    picture = picture or PictureConfig(width=1200, height=900)
    attempt = _attempt_at(recording, object_index)
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


def _attempt_at(recording: Replay, object_index: int | None) -> Attempt:
    attempts = recording.attempts
    if object_index is None and attempts:
        object_index = attempts[-1].object_index
    turn = () if object_index is None else recording.last_turn(object_index)
    if not turn:
        raise ConfigError(
            f"{recording.title}: no attempt at object {object_index}", "a recording with attempts"
        )
    return turn[0]


def _heat_seen(
    renderer: SceneRenderer, styles: list[RenderStyle], recording: Replay, density: np.ndarray
) -> np.ndarray:
    """f64[height, width, 4]: the heat of each pixel that sees the region, clear elsewhere."""
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
