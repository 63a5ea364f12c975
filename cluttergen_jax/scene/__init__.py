"""One finished scene as a value and as MJCF text, its cameras, and many scenes as one model."""

from cluttergen_jax.scene.cameras import CAMERAS, FixedCamera, scene_cameras
from cluttergen_jax.scene.collection import SceneCollection, collect
from cluttergen_jax.scene.scene import Attachment, Origin, Scene

__all__ = [
    "CAMERAS",
    "Attachment",
    "FixedCamera",
    "Origin",
    "Scene",
    "SceneCollection",
    "collect",
    "scene_cameras",
]
