"""What MuJoCo's own renderer shows of a model: of a source file, and of the pieces that were read of it."""

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import _add_visual, add_texture, set_surface
from cluttergen_jax.rendering.gl import gl_context

SIDE = 128
VIEWS = ((90, -90), (90, 90), (90, 0), (180, 0), (-90, 0), (0, 0), (125, -30))
"""Azimuth and elevation, degrees: along the axes, from all sides, and from above aslant."""


def pictures(model):
    """u8[7, H, W, 3] and bool[7, H, W], where something is: all views, without perspective or light."""
    model.mat_specular[:] = model.mat_reflectance[:] = model.mat_emission[:] = 0
    model.vis.headlight.ambient[:] = 1
    model.vis.headlight.diffuse[:] = 0
    model.vis.headlight.specular[:] = 0
    model.light_active[:] = 0
    model.vis.global_.offwidth = model.vis.global_.offheight = SIDE
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 500)
    viewport = mujoco.MjrRect(0, 0, SIDE, SIDE)
    for flag in (
        mujoco.mjtRndFlag.mjRND_SHADOW,
        mujoco.mjtRndFlag.mjRND_SKYBOX,
        mujoco.mjtRndFlag.mjRND_HAZE,
    ):
        scene.flags[flag] = 0
    colours = np.zeros((len(VIEWS), SIDE, SIDE, 3), np.uint8)
    depths = np.ones((len(VIEWS), SIDE, SIDE), np.float32)
    with gl_context(SIDE, SIDE):
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        for view, (azimuth, elevation) in enumerate(VIEWS):
            camera = mujoco.MjvCamera()
            camera.azimuth = azimuth
            camera.elevation = elevation
            camera.orthographic = 1
            camera.lookat[:] = model.stat.center
            camera.distance = 2.5 * model.stat.extent
            mujoco.mjv_updateScene(
                model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
            )
            mujoco.mjr_render(viewport, scene, context)
            mujoco.mjr_readPixels(colours[view], depths[view], viewport, context)
        context.free()
    # MuJoCo turns depth over, so that what is far is 0 or 1.
    return colours[:, ::-1], (depths != depths[:, :1, :1])[:, ::-1]


def model_of(pieces, like):
    """The model of surfaces, to be seen from where `like` is seen."""
    spec = mujoco.MjSpec()
    for index, piece in enumerate(pieces):
        mesh = spec.add_mesh(name=f"surface-{index}")
        set_surface(mesh, piece)
        _add_visual(spec.worldbody, mesh, piece, add_texture(spec, piece.texture))
    model = spec.compile()
    model.stat.center[:] = like.stat.center
    model.stat.extent = like.stat.extent
    return model


def beside(source, pieces, bins=8):
    """How the pieces look beside their source.

    Returns:
      The share of pixels of another colour, of those where both are; and how much of the colours' histograms
      they have in common, from 0 to 1.
    """
    drawn = pictures(model_of(pieces, source)), pictures(source)
    both = drawn[0][1] & drawn[1][1]
    assert both.sum() > 0.97 * max(mask.sum() for _, mask in drawn)
    away = np.abs(drawn[0][0].astype(int) - drawn[1][0]).max(-1)[both]
    counts = [
        np.histogramdd(image[mask], bins=bins, range=[(0, 256)] * 3)[0] for image, mask in drawn
    ]
    overlap = np.minimum(*(each / each.sum() for each in counts)).sum()
    return float((away > 40).mean()), float(overlap)
