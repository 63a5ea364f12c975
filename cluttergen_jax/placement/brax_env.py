"""Brax's protocol of environments, imported without the remark that MJX makes.

Brax imports MJX, which prints that Warp is missing where it is not installed. Only the engine `warp` needs
it, and who asks for that is told what to install.
"""

from cluttergen_jax.physics.log import silent_import

with silent_import():
    from brax.envs.base import Env, State, Wrapper

__all__ = ["Env", "State", "Wrapper"]
