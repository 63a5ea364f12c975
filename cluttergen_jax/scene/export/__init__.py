"""Scenes that travel: self-contained folders for MuJoCo, PyBullet, Drake, Isaac, glTF viewers and others.

folder: `export_scenes`, licences and origin; its cameras are those of `scene.cameras`. formats: what there
is. bank_folder: formats that take a whole bank. urdf, sdf, usd, glb, robosuite, molmospaces, arena: one kind
of file each (MJCF is `scene.xml`). simready: what USD objects say of themselves. scene_json: that of loaders,
ManiSkill's included. meshes, frames: what they share. scripts: data, not code: loaders that travel along.
"""

from cluttergen_jax.scene.export.folder import BANK_FORMATS, export_bank, export_scenes
from cluttergen_jax.scene.export.formats import FORMATS, Format, register_format

__all__ = ["BANK_FORMATS", "FORMATS", "Format", "export_bank", "export_scenes", "register_format"]
