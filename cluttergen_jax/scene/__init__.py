"""One finished scene as a value, as an MJCF text, as a specification, and many as one model."""

from cluttergen_jax.scene.cameras import CAMERAS, Camera, scene_cameras
from cluttergen_jax.scene.collection import SceneCollection, collect
from cluttergen_jax.scene.scene import Origin, Scene
from cluttergen_jax.scene.spec import Attachment, attach_to, to_mjspec

__all__ = [
    "CAMERAS",
    "Attachment",
    "Camera",
    "Origin",
    "Scene",
    "SceneCollection",
    "attach_to",
    "collect",
    "scene_cameras",
    "to_mjspec",
]
