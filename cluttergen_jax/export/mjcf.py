"""MuJoCo: one MJCF file per scene, meshes shared, poses in the bodies and in the keyframe `scene`."""

from __future__ import annotations

from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.xml import scene_xml


def mjcf_text(scene: Scene) -> bytes:
    """The scene as MJCF, to be saved in `scenes/`."""
    return scene_xml(
        scene.objects,
        scene.poses,
        scene.support,
        scene.stability,
        scene.contact,
        names=scene.names,
        cameras=scene.cameras,
    )
