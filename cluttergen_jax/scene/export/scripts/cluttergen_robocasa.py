"""Exported objects in RoboCasa's kitchens. It needs robocasa and lies in the export's folder.

    import robocasa, robosuite, cluttergen_robocasa
    cluttergen_robocasa.register()
    env = robosuite.make("PickPlaceCounterToCabinet", robots="PandaOmron", obj_registries=("cluttergen",),
                         obj_groups="cluttergen")

Each object is a category of its own, or of what its synset says, in the registry and the group `cluttergen`;
`obj_groups` also takes the path of a model.xml, `model_paths()["mug"]`. scenes/*.json say what stands where.
"""

import json
import warnings
from pathlib import Path
from xml.etree import ElementTree

from host_checks import check_path, check_versions

ROOT = Path(__file__).resolve().parent
check_path(ROOT)
KNOWN = {"robosuite": ("1.5.",)}
"""How the versions begin that this was run with."""
REGISTRY = "cluttergen"


def model_paths():
    """The model.xml of every object, by its name."""
    found = sorted((ROOT / "objects" / REGISTRY).glob("*/*/model.xml"))
    return {path.parent.name: str(path) for path in found}


def _friction_of(folder, usual):
    """The friction of a category's models, which RoboCasa writes onto all their geoms."""
    found = set()
    for file in folder.glob("*/model.xml"):
        geoms = [each for each in ElementTree.parse(file).iter("geom") if each.get("priority")]
        own = {
            tuple(map(float, each.get("friction").split()))
            for each in geoms
            if each.get("friction")
        }
        found |= own or {usual}
    if len(found) > 1:
        told = (
            f"{folder.name} has models of different friction: RoboCasa gives all of a category one"
        )
        warnings.warn(told, stacklevel=3)
    return min(found, default=usual)


def register(graspable=True, **properties):
    """Adds the objects to RoboCasa's categories and groups; again, it changes nothing.

    Args:
      graspable, properties: of RoboCasa's `ObjCat` (washable, microwavable, cookable, freezable), for all.

    Returns:
      The names of the categories.
    """
    check_versions(
        KNOWN, "robosuite==1.5.2 mujoco==3.3.7 beside robocasa", ("robocasa", "robosuite")
    )
    from robocasa.models.objects import kitchen_object_utils as kitchen

    physics = json.loads((ROOT / "MANIFEST.json").read_text(encoding="utf-8"))["physics"]
    contact = {name: tuple(physics[name]) for name in ("solref", "solimp", "friction")}
    folders = sorted(
        path for path in (ROOT / "objects" / REGISTRY).iterdir() if path.name != "textures"
    )
    for folder in folders:
        contact["friction"] = _friction_of(folder, tuple(physics["friction"]))
        kind = kitchen.ObjCat(
            folder.name,
            types=(REGISTRY,),
            model_folders=[str(folder)],
            graspable=graspable,
            **{**contact, **properties},
        )
        kitchen.OBJ_CATEGORIES.setdefault(folder.name, {})[REGISTRY] = kind
        kitchen.OBJ_GROUPS.setdefault(folder.name, [folder.name])
    names = [folder.name for folder in folders]
    kitchen.OBJ_GROUPS[REGISTRY] = names
    return names
