"""Pictures of objects, supports and scenes.

gl: which OpenGL backend draws here. lighting: light, floor and background. camera: framing. renderer: many
pictures of one model, averaged. photo, photo_scene: path tracing instead. picture: one model as an image.
look: how scenes are furnished and lit. surfaces, furnish: images of materials, supports drawn as furniture.
sheet: contact sheets and files. assets: objects, supports and scenes.
"""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.rendering.assets import close_points, render_object
    from cluttergen_jax.rendering.camera import fit_camera
    from cluttergen_jax.rendering.config import CameraView
    from cluttergen_jax.rendering.figure import GREEN
    from cluttergen_jax.rendering.film import check_format, find_ffmpeg, save_film
    from cluttergen_jax.rendering.gl import find_backend, new_context
    from cluttergen_jax.rendering.lighting import KEY_LIGHT, add_lighting
    from cluttergen_jax.rendering.renderer import (
        HIDDEN_GROUP,
        Renderer,
        Trail,
        open_renderer,
        set_range,
    )
    from cluttergen_jax.rendering.scene_renderer import (
        RED,
        PictureConfig,
        RenderStyle,
        open_scene_renderer,
    )
    from cluttergen_jax.rendering.sheet import contact_sheet, save_png, with_caption, with_frame
    from cluttergen_jax.rendering.variation import (
        TEXTURES_OF,
        add_table_materials,
        table_materials,
    )
    from cluttergen_jax.rendering.viewer.scene_nodes import SceneNodes, add_ghost, aim
    from cluttergen_jax.rendering.viewer.viewer import announce, open_server

__getattr__, __all__ = offer(
    __name__,
    {
        "assets": ("close_points", "render_object"),
        "camera": ("fit_camera",),
        "config": ("CameraView",),
        "figure": ("GREEN",),
        "film": ("check_format", "find_ffmpeg", "save_film"),
        "gl": ("find_backend", "new_context"),
        "lighting": ("KEY_LIGHT", "add_lighting"),
        "renderer": ("HIDDEN_GROUP", "Renderer", "Trail", "open_renderer", "set_range"),
        "scene_renderer": ("PictureConfig", "RED", "RenderStyle", "open_scene_renderer"),
        "sheet": ("contact_sheet", "save_png", "with_caption", "with_frame"),
        "variation": ("TEXTURES_OF", "add_table_materials", "table_materials"),
        "viewer.scene_nodes": ("SceneNodes", "add_ghost", "aim"),
        "viewer.viewer": ("announce", "open_server"),
    },
)
