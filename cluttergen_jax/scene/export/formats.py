"""What scenes can be exported as: for each format who writes objects, the support and scenes."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import SHARED_IMAGES
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, ExportFormat
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.own_parts import load_module, module_name
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.glb import glb_bytes
from cluttergen_jax.scene.export.links import (
    PACKAGE_XML,
    model_directives,
    object_sdf,
    object_urdf,
    sdf_text,
    support_sdf,
    support_urdf,
)
from cluttergen_jax.scene.export.mjcf import object_xml, robosuite_xml, scene_xml
from cluttergen_jax.scene.export.molmospaces import asset_json, scene_metadata
from cluttergen_jax.scene.export.moveit import planning_scene
from cluttergen_jax.scene.export.scene_json import maniskill_json, scene_json
from cluttergen_jax.scene.export.shapes import (
    object_folder,
    registry_folder,
    usd_folder,
    write_meshes,
)

WriteObject = Callable[[Path, ObjectAsset, ContactConfig], None]
WriteSupport = Callable[[Path, SupportAsset, ContactConfig], None]
WriteScene = Callable[[Path, Scene], None]
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
HOST_CHECKS = "host_checks.py"
"""A script that others import: what they ask of their host first."""


@dataclass(frozen=True)
class Format:
    """One way to write scenes. One of your own is given to `export`, or made known by `register_format`.

    Attributes:
      name: as on the command line.
      opens_in: who reads it, and how, in a sentence for the folder's README.
      ending: of a scene's file in `scenes/`.
      write_object, write_support: write what all scenes share into a folder, of an asset or the support and
        the contact parameters; None where a scene holds all.
      write_scene: writes a scene's file, of its path and the `Scene`.
      scripts: stand-alone loaders that travel along, in `export/scripts`.
      object_folder: where an object's files lie, relative to the export's folder.
      takes_cameras: cameras are written into what the program reads; else into `scenes/*.json` alone.
      takes_grasps: grasps are written into objects' folders.
      reserved_folder: a name that no folder on the way to an export may have, since the program takes what
        follows it for files of its own; "" for none.
      notes: more for the README: the settings that the program needs, and what it takes from the files.
      require: raises MissingExtraError if a package that the format needs is not installed.
    """

    name: str
    opens_in: str
    ending: str
    write_object: WriteObject | None
    write_support: WriteSupport | None
    write_scene: WriteScene
    scripts: tuple[str, ...] = ()
    object_folder: Callable[[ObjectAsset], str] = object_folder
    takes_cameras: bool = True
    takes_grasps: bool = False
    reserved_folder: str = ""
    notes: str = ""
    require: Callable[[], None] = lambda: None


def _write_meshes(folder: Path, asset: Any, contact: ContactConfig) -> None:
    write_meshes(folder, asset)


def _files(
    model: Callable[[Any, ContactConfig], bytes], ending: str, name: str = ""
) -> Callable[[Path, Any, ContactConfig], None]:
    """Writes an object or the support: meshes, and a model called `name`, or as its folder."""

    def write(folder: Path, asset: Any, contact: ContactConfig) -> None:
        write_meshes(folder, asset)
        (folder / f"{name or folder.name}.{ending}").write_bytes(model(asset, contact))

    return write


def _scene_writer(make: Callable[[Scene], bytes]) -> WriteScene:
    def write(path: Path, scene: Scene) -> None:
        path.write_bytes(make(scene))

    return write


def _mjcf_text(scene: Scene, names_detector: bool = True, has_joints: bool = False) -> bytes:
    if has_joints and not scene.support.joints:
        raise ConfigError(
            f"`joints` with support {scene.support.name!r}, which has none",
            "furniture of a URDF or MJCF file with joints, as `cluttergen import --support` reads it",
            "leaving it out",
        )
    return scene_xml(
        scene.objects,
        scene.poses,
        scene.support,
        scene.stability,
        scene.contact,
        names=scene.names,
        cameras=scene.cameras,
        names_detector=names_detector,
        has_joints=has_joints,
    )


def _write_molmospaces_object(folder: Path, asset: ObjectAsset, contact: ContactConfig) -> None:
    write_meshes(folder, asset)
    (folder / f"{asset.name}.xml").write_bytes(object_xml(asset, contact, SHARED_IMAGES))
    (folder / f"{asset.name}.json").write_bytes(asset_json(asset))


def _write_molmospaces_scene(path: Path, scene: Scene) -> None:
    path.write_bytes(_mjcf_text(scene))
    path.with_name(f"{path.stem}_metadata.json").write_bytes(scene_metadata(scene))


def _write_sdf_support(folder: Path, support: SupportAsset, contact: ContactConfig) -> None:
    _files(support_sdf, "sdf")(folder, support, contact)
    (folder.parents[1] / "package.xml").write_text(PACKAGE_XML, encoding="ascii")


def _write_sdf_scene(path: Path, scene: Scene) -> None:
    path.write_bytes(sdf_text(scene))
    path.with_suffix(".dmd.yaml").write_bytes(model_directives(scene))


def _late(module: str, function: str) -> Callable[..., Any]:
    """A function of a module of this package, imported when it is called: some libraries load slowly."""
    return lambda *args: getattr(
        importlib.import_module(f"cluttergen_jax.scene.export.{module}"), function
    )(*args)


def _robocasa_file(asset: ObjectAsset) -> str:
    return f"{registry_folder(asset)}/model.xml"


_MOLMOSPACES_NOTES = (
    "With grasps (assets/objects/UID/franka/grasps.npz): python -m "
    "molmo_spaces.resources.generate_user_grasp_library_index assets/objects, then "
    "register_user_grasp_library('cluttergen', Path('assets/objects'), 'cluttergen')."
)
_DRAKE_NOTES = (
    "For Drake (1.40 or newer) parts and boxes are compliant hydroelastic bodies of 1e9 Pa with the friction "
    "of the scene (drake:proximity_properties); other readers skip this. The plant needs the time step named "
    "above and the solver SAP, in which scenes stand; by the default, lagged, objects creep and turn. "
    "scenes/NUMBER.dmd.yaml are the same as model directives, after "
    "parser.package_map().AddPackageXml('package.xml')."
)
_MOVEIT_NOTES = (
    "Files have what collides: convex parts and boxes, in the frame of the scene. Load them where that frame "
    "is the planning frame, or with an offset (PlanningScene::loadGeometryFromStream)."
)
_ROBOSUITE = (
    _files(robosuite_xml, "xml"),
    _files(robosuite_xml, "xml"),
    _scene_writer(partial(scene_json, ending="xml")),
)
"""Objects, support and scene as robosuite reads them, and LIBERO, which is built on it."""
_USD = Format(
    "usd",
    "Isaac Sim, Omniverse or usdview: open scenes/NUMBER.usda. Physics is UsdPhysics.",
    "usda",
    _late("usd", "write_object_usd"),
    _late("usd", "write_support_usd"),
    _late("usd", "write_scene_usd"),
    scripts=("cluttergen_isaaclab.py",),
    require=_late("usd", "require_usd"),
    object_folder=usd_folder,
    notes="Isaac Lab 2.1 to 3.0: from cluttergen_isaaclab import Clutter; its assets() and event() go into "
    "the configuration of an environment, whose resets put worlds as in scenes. It has not been run there.",
)
_MJCF = Format(
    "mjcf",
    "MuJoCo: python -m mujoco.viewer --mjcf=scenes/NUMBER.xml; the keyframe `scene` holds the poses too.",
    "xml",
    _write_meshes,
    _write_meshes,
    _scene_writer(_mjcf_text),
    scripts=("cluttergen_dm_control.py", "cluttergen_newton.py", HOST_CHECKS),
    notes="dm_control 1.0.50: from cluttergen_dm_control import ClutterArena; ClutterArena(scene=0) is "
    "an arena for its composer. Newton 1.8: import cluttergen_newton; "
    "cluttergen_newton.add_worlds(builder, [0, 1]).",
)
_OLD_NOTES = (
    "For MuJoCo before 3.2.3, from 2.3.7 on: without the flag nativeccd, which those do not know."
)
_JOINT_NOTES = (
    "Drawers and doors of the support can move: they come first in qpos. "
    "Limits, masses, damping, friction and armature of the support's joints are those of its file "
    "where it states them. Else masses are estimates, and friction is as much as what moves weighs; "
    "where a joint would fall, friction holds it in any case."
)


def _mjcf_variant(is_old: bool, has_joints: bool) -> Format:
    notes = [_OLD_NOTES] * is_old + [_JOINT_NOTES] * has_joints
    writer = partial(_mjcf_text, names_detector=not is_old, has_joints=has_joints)
    return replace(_MJCF, write_scene=_scene_writer(writer), scripts=(), notes=" ".join(notes))


_MJCF_VARIANTS = {
    (is_old, has_joints): _mjcf_variant(is_old, has_joints)
    for is_old, has_joints in ((True, False), (False, True), (True, True))
}
"""MJCF by its options `old_mujoco` and `joints`."""
_FORMER = {
    "mjcf-old": ("the format 'mjcf' with `old_mujoco`", "format='mjcf' and `old_mujoco`"),
    "mjcf-joints": ("the format 'mjcf' with `joints`", "format='mjcf' and `joints`"),
    "arena": (
        "another format: no version of Isaac Lab-Arena was ever seen to open this one",
        "format='usd', which Isaac Sim opens",
    ),
}
"""Formats of earlier versions: what is allowed instead, and what to try."""
_OPENED_BY = {
    "mujoco": "mjcf",
    "mjx": "mjcf",
    "dm_control": "mjcf",
    "newton": "mjcf",
    "genesis": "mjcf",
    "pybullet": "urdf",
    "bullet": "urdf",
    "drake": "sdf",
    "gazebo": "sdf",
    "isaac": "usd",
    "isaac_sim": "usd",
    "isaac_lab": "usd",
    "isaaclab": "usd",
    "omniverse": "usd",
    "blender": "glb",
    "gymnasium": "lerobot",
    "mujoco_playground": "playground",
}
"""Programs that open a format of another name."""
_ALL = (
    _MJCF,
    Format(
        "urdf",
        "PyBullet: python load_pybullet.py scenes/NUMBER.json (needs pybullet only; --direct opens no "
        "window). Objects and support are one URDF each.",
        "json",
        _files(object_urdf, "urdf"),
        _files(support_urdf, "urdf"),
        _scene_writer(partial(scene_json, ending="urdf")),
        scripts=("load_pybullet.py",),
        takes_cameras=False,
    ),
    Format(
        "sdf",
        "Drake: Parser(plant).AddModels('scenes/NUMBER.sdf'), the plant made by "
        "AddMultibodyPlant(MultibodyPlantConfig(time_step=1/240, discrete_contact_approximation='sap'), "
        "builder); Gazebo: gz sim scenes/NUMBER.sdf.",
        "sdf",
        _files(object_sdf, "sdf"),
        _write_sdf_support,
        _write_sdf_scene,
        notes=_DRAKE_NOTES,
    ),
    _USD,
    Format(
        "glb",
        "any glTF viewer; the second glTF scene shows the collision parts.",
        "glb",
        None,
        None,
        _scene_writer(glb_bytes),
    ),
    Format(
        "maniskill",
        "ManiSkill 3: import cluttergen_maniskill, then gymnasium.make('ClutterGenScene-v1', scene='N').",
        "json",
        _write_meshes,
        _write_meshes,
        _scene_writer(maniskill_json),
        scripts=("cluttergen_maniskill.py", HOST_CHECKS),
        takes_cameras=False,
    ),
    Format(
        "robosuite",
        "robosuite 1.5: import cluttergen_robosuite, then robosuite.make('ClutterGenScene', robots='Panda', "
        "scene='N').",
        "json",
        *_ROBOSUITE,
        scripts=("cluttergen_robosuite.py", HOST_CHECKS),
        reserved_folder="robosuite",
        takes_cameras=False,
    ),
    Format(
        "libero",
        "LIBERO: import cluttergen_libero, then cluttergen_libero.make_env(N). python cluttergen_libero.py "
        "writes LIBERO's task descriptions and initial states.",
        "json",
        *_ROBOSUITE,
        scripts=("cluttergen_libero.py", HOST_CHECKS),
        reserved_folder="robosuite",
        takes_cameras=False,
    ),
    Format(
        "robocasa",
        "RoboCasa: import cluttergen_robocasa, then cluttergen_robocasa.register(); tasks draw these objects "
        "with robosuite.make(TASK, obj_registries=('cluttergen',), obj_groups='cluttergen', ...).",
        "json",
        _files(partial(robosuite_xml, region=True), "xml", "model"),
        _ROBOSUITE[1],
        _scene_writer(partial(scene_json, ending="xml", file_of=_robocasa_file)),
        scripts=("cluttergen_robocasa.py", HOST_CHECKS),
        reserved_folder="robosuite",
        takes_cameras=False,
        object_folder=registry_folder,
    ),
    Format(
        "molmospaces",
        "MolmoSpaces 0.2: python -m molmo_spaces.resources.generate_user_asset_library_index assets/objects, "
        "then register_user_asset_library('cluttergen', Path('assets/objects')) and, with scene_dataset "
        "'user', scene_xml_paths=['scenes/NUMBER.xml'].",
        "xml",
        _write_molmospaces_object,
        _write_meshes,
        _write_molmospaces_scene,
        notes=_MOLMOSPACES_NOTES,
        takes_grasps=True,
    ),
    Format(
        "moveit",
        "MoveIt 1 or 2: PlanningScene::loadGeometryFromStream, or in RViz the panel MotionPlanning, Scene "
        "Objects, Import.",
        "scene",
        None,
        None,
        _scene_writer(planning_scene),
        takes_cameras=False,
        notes=_MOVEIT_NOTES,
    ),
    Format(
        "rerun",
        "Rerun (pip install rerun-sdk): rerun scenes/NUMBER.rrd.",
        "rrd",
        None,
        None,
        _late("rerun", "write_scene_rerun"),
        require=_late("rerun", "require_rerun"),
    ),
)
FORMATS = {each.name: each for each in _ALL}
"""Every format by name: those of this package, and what `register_format` was given."""


def is_own(format: Format) -> bool:
    """Whether a format is a user's, not one of this package."""
    return all(format is not each for each in (*_ALL, *_MJCF_VARIANTS.values()))


def register_format(format: Format) -> Format:
    """Makes a format of your own known by its name, to `export` and `export_scenes` of this process.

    On the command line it is `cluttergen export BANK --format FILE.py:NAME`, where NAME is the variable of
    the file that holds the `Format`; the manifest of an export names that file and its digest.

    Args:
      format: what writes objects, the support and scenes; see `Format`. A format that was registered under
        the same name before is replaced.

    Returns:
      The format.

    Raises:
      ConfigError: it is no `Format`, its name is one of this package's formats, or a field is wrong.
    """
    _check_own(format)
    FORMATS[format.name] = format
    return format


def find_format(format: str | Format, *, old_mujoco: bool = False, joints: bool = False) -> Format:
    """The format of that name, or the one in `FILE.py:NAME` or `MODULE:NAME`, or the one that is given.

    Args:
      old_mujoco: MJCF for MuJoCo before 3.2.3. joints: MJCF in which the support's joints can move.

    Raises:
      ConfigError: there is none, or it is another one with an option of MJCF.
      MissingExtraError: it needs a package that is not installed.
    """
    if isinstance(format, str) and ":" in format:
        found = _load_format(format)
    elif isinstance(format, str) and format in FORMATS:
        found = FORMATS[format]
    elif isinstance(format, str) and format in _FORMER:
        raise ConfigError(f"format {format!r}, which is no more", *_FORMER[format])
    elif isinstance(format, str):
        raise _no_such_format(format)
    else:
        found = format
    if not isinstance(found, Format) or is_own(found):
        _check_own(found)
    found.require()
    if not (old_mujoco or joints):
        return found
    if found.name != "mjcf":
        given = " and ".join(["`old_mujoco`"] * old_mujoco + ["`joints`"] * joints)
        raise ConfigError(f"{given} with the format {found.name!r}", "format='mjcf'")
    return _MJCF_VARIANTS[old_mujoco, joints]


def _no_such_format(name: str) -> ConfigError:
    """The error for a name that is no format's, which may be that of a program that opens one."""
    known = tuple(dict.fromkeys((*get_args(ExportFormat), *FORMATS)))
    if name in known:
        return ConfigError(
            f"format {name!r} of scenes, which takes a whole bank",
            ", ".join(FORMATS),
            f"cluttergen_jax.export(bank, out, {name!r})",
        )
    meant = closest(name.replace("-", "_"), (*known, *_OPENED_BY))
    asked = _OPENED_BY.get(meant, meant)
    return ConfigError(
        f"format {name!r}",
        f"{', '.join(known)}, or one of your own as FILE.py:NAME",
        f"format={asked!r}" if asked else "docs/guide/export.md, which says what opens which",
        "" if meant == name else meant,
    )


def _check_own(format: object) -> None:
    """Refuses what is no whole format of a user's own (ConfigError)."""
    if not isinstance(format, Format):
        raise ConfigError(
            f"the format {format!r}",
            "a `cluttergen_jax.Format`, or a name",
            "Format(name, opens_in, ending, write_object, write_support, write_scene)",
        )
    for field in ("name", "ending"):
        value = getattr(format, field)
        if not isinstance(value, str) or not _NAME.fullmatch(value):
            raise ConfigError(
                f"a format with {field} {value!r}", "letters, digits, '.', '_' and '-'", "my-format"
            )
    if format.name in get_args(ExportFormat) and is_own(format):
        given = f"a format of your own called {format.name!r}, which this package has"
        raise ConfigError(given, "another name", f"name='my-{format.name}'")
    writers = {
        "write_object": format.write_object,
        "write_support": format.write_support,
        "write_scene": format.write_scene,
    }
    for field, writer in writers.items():
        if not callable(writer) and (writer is not None or field == "write_scene"):
            raise ConfigError(f"a format whose {field} is {writer!r}", "a function")
    if format.scripts and is_own(format):
        raise ConfigError(
            f"a format of your own with scripts {format.scripts!r}",
            "no scripts: those that travel along are this package's",
            "write_scene, which may write more files beside the scene's",
        )


def _load_format(text: str) -> Format:
    """The format that a variable of a file or of a module holds: `FILE.py:NAME` or `MODULE:NAME`."""
    module, name, _ = load_module(text, "format")
    found = getattr(module, name, None)
    if isinstance(found, Format):
        return found
    held = [key for key, value in vars(module).items() if isinstance(value, Format)]
    fault = "missing" if found is None else "no Format"
    raise ConfigError(
        f"format {text!r}: {name!r} of {text.rpartition(':')[0]} is {fault}",
        ", ".join(held) or "a variable that holds a `cluttergen_jax.Format`",
        meant=closest(name, held),
    )


def own_record(format: Format) -> dict[str, Any]:
    """What a manifest says of a user's own format: where its writer of scenes is from; {} of others.

    `defined_in` names module and function, `file` the file without its folder, and `sha256` its content;
    the last two are left out where there is no file.
    """
    if not is_own(format):
        return {}
    writer: Any = format.write_scene
    while isinstance(writer, partial):
        writer = writer.func
    writer = writer if inspect.isroutine(writer) else type(writer)
    record = {"defined_in": f"{module_name(writer)}:{writer.__qualname__}"}
    try:
        file = Path(inspect.getsourcefile(writer) or "")
        record |= {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    except (TypeError, OSError):
        pass
    return {"own_format": record}
