"""One finished scene as a value and as MJCF text, its cameras, and many scenes as one model."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.scene.bank import (
        AGAIN,
        Bank,
        assets_section,
        front_matter,
        read_bank,
        read_scenes,
        region_of,
        write_unless_own,
    )
    from cluttergen_jax.scene.bank.remote import bank_folder
    from cluttergen_jax.scene.cameras import CAMERAS, FixedCamera, scene_cameras
    from cluttergen_jax.scene.collection import SceneCollection, collect
    from cluttergen_jax.scene.export.rerun import RerunFile
    from cluttergen_jax.scene.scene import Origin, Scene

__getattr__, __all__ = offer(
    __name__,
    {
        "bank": (
            "AGAIN",
            "Bank",
            "assets_section",
            "front_matter",
            "read_bank",
            "read_scenes",
            "region_of",
            "write_unless_own",
        ),
        "bank.remote": ("bank_folder",),
        "cameras": ("CAMERAS", "FixedCamera", "scene_cameras"),
        "collection": ("SceneCollection", "collect"),
        "export.rerun": ("RerunFile",),
        "scene": ("Origin", "Scene"),
    },
)
