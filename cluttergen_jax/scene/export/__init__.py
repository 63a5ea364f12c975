"""Scenes that travel: self-contained folders for MuJoCo, PyBullet, Drake, Isaac, glTF viewers and others.

folder: `export_scenes`; its cameras are those of `scene.cameras`. formats: what there is. urdf, sdf, usd,
glb, maniskill, robosuite: one kind of file each (MJCF is `scene.xml`). meshes, frames, friction, scene_json:
what they share. manifest: licences and origin. scripts: no package but data, loaders that travel along.
"""

from cluttergen_jax.scene.export.folder import export_scenes
from cluttergen_jax.scene.export.formats import FORMATS, Format

__all__ = ["FORMATS", "Format", "export_scenes"]
