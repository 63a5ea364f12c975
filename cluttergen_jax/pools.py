"""Pools and supports that there are: listed, removed, and the resting poses of a pool's objects."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.assets.pool import list_pools, remove_pool
    from cluttergen_jax.assets.support_file import list_supports
    from cluttergen_jax.importing.poses import pool_poses, set_pose

__all__ = ["list_pools", "list_supports", "pool_poses", "remove_pool", "set_pose"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "list_pools": "assets.pool:list_pools",
        "list_supports": "assets.support_file:list_supports",
        "pool_poses": "importing.poses:pool_poses",
        "remove_pool": "assets.pool:remove_pool",
        "set_pose": "importing.poses:set_pose",
    },
)
