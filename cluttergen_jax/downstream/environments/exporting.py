"""Writes the environment of a robot in a bank so that it runs without this package, beside a host's pins.

`cluttergen_env/` is a copy of `downstream.episodes` and of the modules that it stands on; `environment/`
holds the robot and all objects of the bank as MJCF, and what judges and controls have to know of them.
"""

from __future__ import annotations

import importlib.resources
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.assets import turn_symmetry
from cluttergen_jax.downstream.environments.world import RobotWorld, support_of, with_robot
from cluttergen_jax.downstream.episodes.exported import (
    FOLDER,
    FORMAT,
    PLAIN,
    RECORD,
    SHARED,
    WITH_STAND,
)
from cluttergen_jax.downstream.robot.description import RobotDescription, model_files
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.generation import load_bank

PACKAGE = "cluttergen_env"
MODULES = {
    "cluttergen_jax.bank_reader": "bank_reader",
    "cluttergen_jax.config": "config",
    "cluttergen_jax.errors": "errors",
    "cluttergen_jax.geometry": "geometry",
    "cluttergen_jax.physics": "standing",
    "cluttergen_jax.downstream.transforms": "transforms",
    "cluttergen_jax.downstream.words": "words",
}
"""Modules that `downstream.episodes` stands on, and what they are called in the copy."""
_FILES = {"cluttergen_jax.physics": "physics/standing.py"}
"""Where a module lies that is not what it is called."""
_EPISODES = "cluttergen_jax.downstream.episodes"
_IMPORT = re.compile(r"^(\s*)from (cluttergen_jax[\w.]*) import", re.MULTILINE)
_ASSETS = "assets"
_LICENCES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "COPYING")
_OPTIONS = ("timestep", "impratio", "tolerance", "density", "viscosity", "gravity")


def write_environment(folder: Path, robot: Any) -> str:
    """See `cluttergen_jax.robot_environments`."""
    try:
        import gymnasium  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError("gym", "the environment of an export `lerobot`") from error
    bank = load_bank(folder / "bank")
    stand = stand_beside(support_of(bank))
    worlds = {
        PLAIN: with_robot(bank, robot),
        WITH_STAND: with_robot(bank, robot, stands=(stand,)),
    }
    place = folder / FOLDER
    (place / _ASSETS).mkdir(parents=True)
    for name, world in worlds.items():
        _write_model(place, name, world)
    _write_numbers(place, {name: dict(exact_numbers(each.model)) for name, each in worlds.items()})
    record = _record(worlds[PLAIN])
    record["qpos0"] = {name: world.qpos0.tolist() for name, world in worlds.items()}
    (place / RECORD).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    write_package(folder / PACKAGE)
    return _copy_terms(place, worlds[PLAIN].description)


def write_package(folder: Path) -> None:
    """The copy of `downstream.episodes` and of what it stands on."""
    folder.mkdir()
    root = Path(str(importlib.resources.files("cluttergen_jax")))
    for module, name in MODULES.items():
        file = _FILES.get(module, module.partition(".")[2].replace(".", "/") + ".py")
        _copy_module(root / file, folder / f"{name}.py")
    for path in sorted((root / "downstream/episodes").glob("*.py")):
        _copy_module(path, folder / path.name)


def _copy_module(source: Path, target: Path) -> None:
    """A module whose imports of this package are of the copy."""

    def name_in_copy(found: re.Match[str]) -> str:
        return f"{found[1]}from {copied_name(found[2])} import"

    text = _IMPORT.sub(name_in_copy, source.read_text(encoding="utf-8"))
    target.write_text(text, encoding="utf-8")


def copied_name(module: str) -> str:
    """What a module is called in the copy; one that is not copied keeps its name."""
    if module in MODULES:
        return f"{PACKAGE}.{MODULES[module]}"
    return f"{PACKAGE}{module.removeprefix(_EPISODES)}" if module.startswith(_EPISODES) else module


def _record(world: RobotWorld) -> dict[str, Any]:
    """What judges and controls have to know, as JSON values; numbers come back as they were."""
    support = world.support
    gripper = world.gripper
    names = ("opening", "control", "joints", "depth", "side", "driven", "T_hand_tool")
    objects = dict(zip(world.names, world.bank.compiled.objects, strict=True))
    return {
        "format": FORMAT,
        "robot": world.description.name,
        "mujoco": mujoco.__version__,
        "parts": world.parts._asdict(),
        "prefix": world.prefix,
        "speed": list(map(float, world.speed)),
        "home": list(map(float, world.home)),
        "opened": float(world.opened),
        "gripper": {
            **{name: getattr(gripper, name).tolist() for name in names},
            "closed": float(gripper.closed),
        },
        "stand": _area(world.stand),
        "support": {
            "region": _area(support.region),
            "top": float(support.top),
            "lowest": float(support.lowest),
        },
        "objects": {
            name: {
                "label": each.label,
                "half_extents": list(map(float, each.half_extents)),
                "resting": [
                    {"height": float(pose.height), "quaternion": list(map(float, pose.quaternion))}
                    for pose in each.resting
                ],
                "symmetry": int(turn_symmetry(each)),
            }
            for name, each in objects.items()
        },
        "ctrl0": world.ctrl0.tolist(),
    }


def _area(box: Any) -> dict[str, Any]:
    return {
        "center": list(map(float, box.center)),
        "half_extents": list(map(float, box.half_extents)),
        "yaw": float(box.yaw),
    }


def _write_model(folder: Path, name: str, world: RobotWorld) -> None:
    """The model as MJCF with its meshes and images, and its numbers, which text rounds."""
    tree = ET.fromstring(world.spec.to_xml())
    compiler = tree.find("compiler")
    assert compiler is not None
    compiler.attrib.pop("meshdir", None)
    compiler.attrib.pop("texturedir", None)
    compiler.set("assetdir", _ASSETS)
    for element in tree.iter():
        if "file" in element.attrib:
            element.set("file", _save_asset(folder / _ASSETS, element, world))
    ET.indent(tree)
    (folder / f"{name}.xml").write_text(ET.tostring(tree, "unicode") + "\n", encoding="utf-8")


def _write_numbers(folder: Path, models: dict[str, dict[str, np.ndarray]]) -> None:
    """The numbers of each model, those that all have alike in a file of their own."""
    first = next(iter(models.values()))
    shared = {
        name: value
        for name, value in first.items()
        if all(np.array_equal(each.get(name, ()), value) for each in models.values())
    }
    own = {
        model: {name: value for name, value in numbers.items() if name not in shared}
        for model, numbers in models.items()
    }
    for name, numbers in {SHARED: shared, **own}.items():
        arrays: dict[str, Any] = numbers
        np.savez_compressed(folder / f"{name}.npz", **arrays)


def exact_numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """All arrays of fractions of a model, and those of its options, by their names."""
    for name in dir(model):
        value = None if name.startswith("_") else getattr(model, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
            yield name, value
    for name in _OPTIONS:
        yield f"opt.{name}", np.asarray(getattr(model.opt, name), np.float64)


def _save_asset(folder: Path, element: ET.Element, world: RobotWorld) -> str:
    """Copies the file that an element names; returns its name in the copy."""
    given = element.attrib["file"]
    robot = world.description
    is_gripper = element.get("name", "").startswith(world.prefix + robot.of_gripper(""))
    paths = (
        (robot.gripper.path, robot.arm.path) if is_gripper else (robot.arm.path, robot.gripper.path)
    )
    known = [each for path in paths for each in model_files(path)]
    path = Path(given)
    found = (
        path
        if path.is_absolute()
        else next((each for each in known if each.name == path.name), None)
    )
    data = world.spec.assets.get(given)
    if data is None and (found is None or not found.is_file()):
        raise ConfigError(
            f"robot {robot.name}, whose file {given!r} was not found", "files beside its model"
        )
    if data is None:
        assert found is not None
        data = found.read_bytes()
    if isinstance(data, str):
        data = data.encode()
    name = path.name
    number = 0
    # Of an arm and of its gripper files may be called alike.
    while (folder / name).is_file() and (folder / name).read_bytes() != data:
        number += 1
        name = f"{path.stem}-{number}{path.suffix}"
    (folder / name).write_bytes(data)
    return name


def _copy_terms(folder: Path, robot: RobotDescription) -> str:
    """Copies what the robot's files say of their terms; that in words."""
    found = []
    for path in dict.fromkeys((robot.arm.path, robot.gripper.path)):
        terms = next(
            (path.parent / each for each in _LICENCES if (path.parent / each).is_file()), None
        )
        if terms is not None:
            name = f"LICENSE-{path.stem}.txt"
            (folder / name).write_bytes(terms.read_bytes())
            found.append(f"{FOLDER}/{name}")
    stated = ", ".join(found) or "not stated; ask the owner before you pass it on"
    return (
        f"The package {PACKAGE} is part of cluttergen_jax. Licence: Apache-2.0\n\n"
        f"The robot {robot.name}, in {FOLDER}/. Licence: {stated}"
    )
