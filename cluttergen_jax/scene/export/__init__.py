"""Scenes that travel: self-contained folders for MuJoCo, PyBullet, Drake, Isaac, glTF viewers and others.

folder: `export_scenes`, licences and origin; its cameras are those of `scene.cameras`. formats: what there
is. mjcf, links (URDF, SDF), usd, glb, molmospaces, moveit, rerun: one kind of file each. scene_json: that of
loaders, ManiSkill's included. shapes: what they share of a body. scripts: data: loaders that travel along.
"""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.scene.export.folder import BANK_FORMATS, export_bank, export_scenes
    from cluttergen_jax.scene.export.formats import FORMATS, Format, register_format

__getattr__, __all__ = offer(
    __name__,
    {
        "folder": ("BANK_FORMATS", "export_bank", "export_scenes"),
        "formats": ("FORMATS", "Format", "register_format"),
    },
)
