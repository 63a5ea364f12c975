"""Scenes that travel: self-contained folders for MuJoCo, PyBullet, Drake, Isaac, glTF viewers and others.

folder: `export_scenes`, licences and origin; its cameras are those of `scene.cameras`. formats: what there
is. urdf, sdf, usd, glb, robosuite: one kind of file each (MJCF is `scene.xml`). scene_json: that of loaders,
ManiSkill's included. meshes, frames: what they share. scripts: data, not code: loaders that travel along.
"""

from cluttergen_jax.scene.export.folder import export_scenes
from cluttergen_jax.scene.export.formats import FORMATS, Format

__all__ = ["FORMATS", "Format", "export_scenes"]
