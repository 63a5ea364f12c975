"""One model in one pose as an image, drawn without a screen."""

from __future__ import annotations

import colorsys
import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import COLLISION_GROUP, VISUAL_GROUP
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.camera import drawn_points, fit_camera
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.renderer import (
    HIDDEN_GROUP,
    Trail,
    check_size,
    open_renderer,
    set_range,
)
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

__all__ = ["contact_sheet", "distinct_colour", "render_model", "save_png"]

DEFAULT_VIEW = CameraView()


def distinct_colour(index: int) -> tuple[float, float, float, float]:
    """The colour of the index-th part: neighbours in the row differ in hue and in brightness."""
    hue = (0.08 + index * 0.618034) % 1.0
    red, green, blue = colorsys.hsv_to_rgb(
        hue, (0.62, 0.45, 0.75)[index % 3], (0.92, 0.80, 0.68)[index % 3]
    )
    return red, green, blue, 1.0


def prepare_model(
    model: mujoco.MjModel, hulls: bool, show: Sequence[str] | None
) -> tuple[mujoco.MjModel, np.ndarray]:
    """A copy whose drawn geoms are in the visual group and the others hidden; bool[ngeom] says which."""
    model = copy.copy(model)
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    is_drawn = model.geom_group == VISUAL_GROUP
    is_hull = model.geom_group == COLLISION_GROUP
    if hulls:
        # A support without surfaces of its own is drawn by its colliding boxes, so these stay.
        is_drawn = is_hull | (is_drawn & (touches | is_plane))
    if show is not None:
        bodies = {mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in show}
        if -1 in bodies:
            raise ConfigError(f"show={list(show)!r} names a body that the model does not have")
        is_drawn &= np.isin(model.geom_bodyid, [*bodies, 0])
    if hulls:
        for index, geom in enumerate(np.flatnonzero(is_drawn & is_hull)):
            model.geom_rgba[geom] = distinct_colour(index)
    model.geom_group[:] = np.where(is_drawn, VISUAL_GROUP, HIDDEN_GROUP)
    return model, is_drawn


def render_model(
    model: mujoco.MjModel,
    qpos: np.ndarray | None = None,
    *,
    camera: CameraView = DEFAULT_VIEW,
    width: int = 640,
    height: int = 480,
    hulls: bool = False,
    show: Sequence[str] | None = None,
    focus: np.ndarray | None = None,
    samples: int = 32,
    trails: Sequence[Trail] = (),
) -> np.ndarray:
    """Draws a model as it stands in `qpos`; the model is left as it was.

    Many pictures are drawn with the lights and the pixel grid moved a little, and averaged: that gives soft
    shadows, light from the whole sky, and smooth edges. It looks its best on
    a model that `add_lighting` prepared.

    Args:
      model: any compiled model; geoms of group 2 are drawn.
      qpos: f64[nq]; None is the model's qpos0.
      camera: a view that is fitted to the content.
      width, height: pixels, each in [16, 8192].
      hulls: draw the collision geoms (group 3) instead, each in a colour of its own.
      show: names of the bodies to draw beside the world's own geoms; None draws all.
      focus: f64[P, 3], points that have to be in the picture, world frame; None is all that is drawn.
      samples: pictures averaged, at least 1. Time is proportional to it.
      trails: lines to draw as well; they are in the picture wholly.

    Returns:
      uint8[height, width, 3], RGB.

    Raises:
      RendererError: nothing here can draw.
      ConfigError: a size or a body that cannot be.
    """
    check_size(width, height, samples)
    model, is_drawn = prepare_model(model, hulls, show)
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    content = drawn_points(model, data, is_drawn)
    if len(content) == 0:
        raise ConfigError(
            "a model with nothing to draw", "geoms of group 2, or of group 3 with hulls=True"
        )
    content = np.concatenate([content, *(trail.points for trail in trails)])
    reach = set_range(model, content, camera, width, height)
    eye = fit_camera(content if focus is None else focus, camera, width, height)
    with open_renderer(model, width, height) as renderer:
        return renderer.average(data, eye, samples, reach, trails=trails)
