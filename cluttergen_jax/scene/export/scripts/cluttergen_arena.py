"""Exported objects and their support in the registry of Isaac Lab-Arena; it lies in the export's folder.

    import cluttergen_arena                     # once Isaac's application has started
    cluttergen_arena.register()                 # before a layouts/*.yaml is read

Then `environment_runner.py --env_spec layouts/NAME.yaml --placement_layouts layouts/NAME.jsonl --num_envs 64`
replays the layouts, another one with each reset.
"""

import hashlib
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent


def registry_name(name):
    """An object's name in the registry, as in layouts/*.yaml; distinct for distinct ones."""
    plain = re.sub("[^A-Za-z0-9_]", "_", name)
    behind = "" if plain == name else "_" + hashlib.sha256(name.encode()).hexdigest()[:6]
    return f"cluttergen_{plain}{behind}"


def usd_paths():
    """The USD of every object, and of the support, by its name in the registry."""
    found = {path.stem: path for path in sorted(ROOT.glob("assets/objects/*/usd/*.usda"))}
    paths = {registry_name(name): str(path) for name, path in found.items()}
    return {**paths, "cluttergen_support": str(ROOT / "assets/support/support.usda")}


def register():
    """Adds them; names that are there already stay as they are. Returns the names."""
    from isaaclab_arena.assets.background_library import LibraryBackground
    from isaaclab_arena.assets.object_library import LibraryObject
    from isaaclab_arena.assets.register import register_asset
    from isaaclab_arena.assets.registries import AssetRegistry

    for name, path in usd_paths().items():
        if AssetRegistry().is_registered(name):
            continue
        fields = {"name": name, "usd_path": path}
        if name == "cluttergen_support":
            fields.update(tags=["background"], object_min_z=-0.05)
            register_asset(type(name, (LibraryBackground,), fields))
        else:
            register_asset(type(name, (LibraryObject,), {**fields, "tags": ["object"]}))
    return sorted(usd_paths())
