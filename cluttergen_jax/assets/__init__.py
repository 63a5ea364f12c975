"""Objects, supports and pools as values and files, and the modeller that makes the embedded ones. No JAX."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.assets.facts import ObjectFacts
    from cluttergen_jax.assets.mesh import Mesh, join_meshes
    from cluttergen_jax.assets.mjcf import VISUAL_GROUP, add_object, add_part, populated_spec
    from cluttergen_jax.assets.obj import mesh_text
    from cluttergen_jax.assets.object import ObjectAsset
    from cluttergen_jax.assets.object_files import object_hash
    from cluttergen_jax.assets.pool import embedded_root, find_pool, public_name, user_root
    from cluttergen_jax.assets.support import Box, Rectangle, SupportAsset, parse_region
    from cluttergen_jax.assets.support_file import find_support, support_hash
    from cluttergen_jax.assets.symmetry import ROUND, turn_symmetry

__getattr__, __all__ = offer(
    __name__,
    {
        "facts": ("ObjectFacts",),
        "mesh": ("Mesh", "join_meshes"),
        "mjcf": ("VISUAL_GROUP", "add_object", "add_part", "populated_spec"),
        "obj": ("mesh_text",),
        "object": ("ObjectAsset",),
        "object_files": ("object_hash",),
        "pool": ("embedded_root", "find_pool", "public_name", "user_root"),
        "support": ("Box", "Rectangle", "SupportAsset", "parse_region"),
        "support_file": ("find_support", "support_hash"),
        "symmetry": ("ROUND", "turn_symmetry"),
    },
)
