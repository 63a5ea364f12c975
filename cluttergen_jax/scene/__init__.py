"""One finished scene as a value, as an MJCF text, as a specification, and many as one model."""

from cluttergen_jax.scene.collection import SceneCollection, collect
from cluttergen_jax.scene.scene import Origin, Scene
from cluttergen_jax.scene.spec import Attachment, attach_to, to_mjspec

__all__ = ["Attachment", "Origin", "Scene", "SceneCollection", "attach_to", "collect", "to_mjspec"]
