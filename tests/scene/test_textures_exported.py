"""Each exported image in a program that reads the format: the slab's four quarters show their own colours."""

import mujoco
import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.rendering.gl import gl_context
from tests.helpers import textured
from tests.helpers.drawing import needs_gl
from tests.helpers.textured import assert_upright


@pytest.fixture(scope="module")
def scene():
    """Two slabs that share an image."""
    return textured.scene(textured.asset("one"), textured.asset("two"))


def assert_colours(pixels, center, step):
    """A picture taken from above shows the quarters around `center` (x, y in pixels), each `step` away."""
    for (x, y), colour in textured.QUADRANTS.items():
        seen = pixels[round(center[1] - step * y), round(center[0] + step * x), :3].astype(float)
        # Lights differ: what counts is which colour it is.
        likeness = {
            other: np.dot(seen, other) / (np.linalg.norm(seen) * np.linalg.norm(other) + 1e-9)
            for other in textured.QUADRANTS.values()
        }
        assert max(likeness, key=likeness.get) == colour, (seen, colour)
        assert likeness[colour] > 0.95


def seen_from_above(model, height):
    """A picture of 200 x 200 pixels, 40 degrees wide, from a metre above the point (0, 0, height)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0, 0, height)
    camera.distance = 0.3
    camera.elevation = -90
    camera.azimuth = 90
    model.vis.global_.fovy = 40
    model.vis.global_.offwidth = 200
    model.vis.global_.offheight = 200
    pixels = np.empty((200, 200, 3), np.uint8)
    with gl_context(200, 200):
        view = mujoco.MjvScene(model, 200)
        context = mujoco.MjrContext(model, 100)
        option = mujoco.MjvOption()
        rectangle = mujoco.MjrRect(0, 0, 200, 200)
        option.geomgroup[:] = [0, 1, 1, 0, 0, 0]
        mujoco.mjv_updateScene(
            model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, view
        )
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        mujoco.mjr_render(rectangle, view, context)
        mujoco.mjr_readPixels(pixels, None, rectangle, context)
        context.free()
    return np.flipud(pixels)


def as_piece(geometry, image):
    """A trimesh geometry with an image as a piece."""
    return Piece(
        Mesh(geometry.vertices, geometry.faces),
        (1.0, 1.0, 1.0, 1.0),
        geometry.visual.uv,
        Texture.of(image),
    )


@pytest.mark.parametrize(
    "format", ["mjcf", "urdf", "sdf", "usd", "maniskill", "robosuite", "libero"]
)
def test_an_image_is_stored_once(format, folder_of):
    if format == "usd":
        pytest.importorskip("pxr", reason="needs the extra usd")
    images = [path for path in folder_of(format).rglob("*.png") if ".thumbs" not in path.parts]
    # A SimReady prop has all that it needs in its own folder.
    assert len(images) == (2 if format == "usd" else 1)


@needs_gl
def test_mujoco_shows_the_image_upright(folder_of, scene):
    top = scene.support.top
    seen = seen_from_above(
        mujoco.MjModel.from_xml_path(str(folder_of("mjcf") / "scenes" / "000000.xml")), top
    )
    assert_colours(seen, (100, 100), 20)
    assert_colours(seen_from_above(scene.to_mjspec().compile(), top), (100, 100), 20)


def test_gltf_holds_the_image(folder_of):
    data = trimesh.load_scene(str(folder_of("glb") / "scenes" / "000000.glb"), process=False)
    shown = [each for name, each in data.geometry.items() if name in ("one", "two")]
    assert len(shown) == 2
    for geometry in shown:
        assert_upright(as_piece(geometry, geometry.visual.material.baseColorTexture))
    raw = (folder_of("glb") / "scenes" / "000000.glb").read_bytes()
    assert raw.count(b"\x89PNG") == 1
