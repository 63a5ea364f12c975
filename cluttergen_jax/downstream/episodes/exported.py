"""The environment of a robot in an exported bank: NumPy, MuJoCo, Gymnasium and the bank's reader alone.

    env = make_env("folder", "place")        # as cg.robot.make_env, without JAX and the robot's packages

`register_ids(folder)` gives the ids of Gymnasium to the export: `gymnasium.make("cluttergen/Place-v1")`. The
export's env.py does so.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from cluttergen_jax.bank_reader import Bank
from cluttergen_jax.downstream.episodes.env import RobotAction, RobotEnv, check_settings
from cluttergen_jax.downstream.episodes.robot_parts import Gripper, PartNames, RobotParts
from cluttergen_jax.downstream.episodes.tasks import TASKS
from cluttergen_jax.downstream.episodes.world import BankRows, joints_of_objects
from cluttergen_jax.downstream.words import ENV_IDS, RenderMode, RobotReward
from cluttergen_jax.errors import ConfigError, closest

FOLDER = "environment"
"""In the export: what is there of the robot."""
RECORD = "environment.json"
FORMAT = 1
"""Of that file; newer ones are refused."""
WITH_STAND = "with_stand"
PLAIN = "plain"
SHARED = "shared"
"""Arrays of numbers that both models have."""
_GL = ("egl", "osmesa", "glfw")


@dataclass(frozen=True)
class Area:
    """A rectangle on a top, or a box: metres, and radians about z."""

    center: tuple[float, ...]
    half_extents: tuple[float, ...]
    yaw: float


@dataclass(frozen=True)
class Support:
    """What the judges have to know of it; metres."""

    region: Area
    top: float
    lowest: float


@dataclass(frozen=True)
class Resting:
    """How an object rests: metres of its origin above what it is on, quaternion wxyz."""

    height: float
    quaternion: tuple[float, ...]


@dataclass(frozen=True)
class ExportedObject:
    """An object; symmetry: equal turns about its z."""

    label: str
    half_extents: tuple[float, ...]
    resting: tuple[Resting, ...]
    symmetry: int


@dataclass(frozen=True, eq=False)
class ExportedScene:
    """A scene, as `SimulatedWorld.scene` says; index: its number in the bank."""

    names: tuple[str, ...]
    objects: tuple[ExportedObject, ...]
    poses: np.ndarray
    support: Support
    index: int
    reader: Bank = field(repr=False)

    def to_mjspec(self) -> mujoco.MjSpec:
        """The scene alone, as the bank's files have it."""
        return mujoco.MjSpec.from_string(self.reader.xml(self.index))


@dataclass(frozen=True, eq=False)
class ExportedState:
    """The beginning of an episode; index: the scene's number, names: of its objects.

    qpos f32[nq], ctrl f32[nu], xfrc_applied f32[nbody, 6]: what holds objects that the scene lacks.
    """

    qpos: np.ndarray
    ctrl: np.ndarray
    xfrc_applied: np.ndarray
    index: int
    names: tuple[str, ...]


class ExportedWorld:
    """All objects of an exported bank and a robot in one model, as `SimulatedWorld` says.

    Args:
      folder: the export. has_stand: with the box that objects are placed from.
      bank: scenes of the same objects and support; the export's own if not given.

    Raises:
      ConfigError: it is no such export, a newer version made it, or the bank has other objects.
    """

    def __init__(self, folder: str | Path, has_stand: bool, bank: str | Path | None = None) -> None:
        self.folder = Path(folder)
        record = _read_record(self.folder)
        path = self.folder / FOLDER
        name = WITH_STAND if has_stand else PLAIN
        self.model = _read_model(path, name)
        self.reader = Bank(self.folder / "bank")
        if bank is not None:
            self.reader = _bank_alike(bank, self.reader, list(record["objects"]), self.folder)
        self.parts = PartNames(**{key: _frozen(each) for key, each in record["parts"].items()})
        self.robot = RobotParts.find(self.model, self.parts)
        table = record["gripper"]
        arrays = ("opening", "control", "joints", "depth", "side", "T_hand_tool")
        self.gripper = Gripper(
            **{key: np.array(table[key], np.float64) for key in arrays},
            driven=np.array(table["driven"], int),
            closed=table["closed"],
        )
        self.opened: float = record["opened"]
        self.prefix: str = record["prefix"]
        self.speed: list[float] = record["speed"]
        self.home: list[float] = record["home"]
        self.stand = Area(**record["stand"])
        support = record["support"]
        self.support = Support(Area(**support["region"]), support["top"], support["lowest"])
        self._objects = {
            key: ExportedObject(
                each["label"],
                tuple(each["half_extents"]),
                tuple(Resting(**pose) for pose in each["resting"]),
                each["symmetry"],
            )
            for key, each in record["objects"].items()
        }
        self._names = list(record["objects"])
        self._qpos0 = np.array(record["qpos0"][name], np.float64)
        self._ctrl0 = np.array(record["ctrl0"], np.float64)
        self._object_qpos = joints_of_objects(self.model, self._names)

    @cached_property
    def bank(self) -> BankRows:
        """Its scenes."""
        rows: BankRows = self.reader.arrays
        return rows

    def reset(self, seed: int, index: int | None = None) -> ExportedState:
        """The scene of this number, everything else at home; nothing is randomized here."""
        found = np.flatnonzero(self.bank.index == index)
        if not len(found):
            raise ConfigError(f"scene {index!r} of {self.folder}", "the number of a stable scene")
        place = int(found[0])
        numbers = self.bank.object_index[place]
        names = tuple(self.reader.names[number] for number in numbers if number >= 0)
        own = [self._names.index(name) for name in names]
        qpos = self._qpos0.astype(np.float32)
        qpos[self._object_qpos[own]] = self.bank.poses[place, : len(names)]
        bodies = [self.model.body(name).id for name in self._names]
        lift = -self.model.body_mass[bodies, None] * self.model.opt.gravity
        lift[own] = 0.0
        force = np.zeros((self.model.nbody, 6), np.float32)
        force[bodies, :3] = lift
        return ExportedState(qpos, self._ctrl0.astype(np.float32), force, int(index or 0), names)

    def put(self, data: mujoco.MjData, state: ExportedState) -> None:
        """Puts `data` at rest at the beginning of an episode."""
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = state.qpos
        data.ctrl[:] = state.ctrl
        data.xfrc_applied[:] = state.xfrc_applied
        mujoco.mj_forward(self.model, data)

    def scene(self, state: ExportedState) -> ExportedScene:
        """The scene of a state."""
        own = [self._names.index(name) for name in state.names]
        return ExportedScene(
            state.names,
            tuple(self._objects[name] for name in state.names),
            state.qpos.astype(np.float64)[self._object_qpos[own]],
            self.support,
            state.index,
            self.reader,
        )

    def symmetries(self, scene: ExportedScene) -> list[int]:
        """Of each object of a scene, after how many equal turns about its z it looks the same."""
        return [each.symmetry for each in scene.objects]

    def kinematics(self) -> Any:
        """None: actions of the tool need the package's inverse kinematics (ConfigError)."""
        raise ConfigError(
            "action = 'tool' in an exported environment",
            "joint, joint_delta",
            _beside(self.folder),
        )

    def new_context(self, width: int, height: int) -> Any:
        """A GL context, made current: of MUJOCO_GL, else the first that there is (RuntimeError: none)."""
        asked = os.environ.get("MUJOCO_GL", "")
        reasons = []
        for name in [asked] if asked in _GL else _GL:
            try:
                context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
                context.make_current()
            # Libraries that are not there fail in many ways.
            except Exception as error:
                reasons.append(f"{name}: {error}")
            else:
                return context
        raise RuntimeError(f"nothing here can draw ({'; '.join(reasons)})")


def make_env(
    folder: str | Path,
    task: str = "place",
    bank: str | Path | None = None,
    robot: str | None = None,
    *,
    action: RobotAction = "joint",
    cameras: Sequence[str] = (),
    image_size: tuple[int, int] = (240, 320),
    control_hz: float = 20.0,
    max_seconds: float | None = None,
    reward: RobotReward = "sparse",
    render_mode: RenderMode | None = "rgb_array",
    physics: str = "accurate",
    randomization: object = None,
    recording: object = None,
) -> RobotEnv:
    """The environment of `cluttergen_jax.robot.make_env` in an exported bank, with physics "accurate".

    Args:
      folder: the export. task: "place", "grasp" or "rearrange".
      bank: a folder with scenes of the same objects on the same support; the export's own if not given.
      robot: the export's own alone, by name.
      action: "joint" or "joint_delta". The others are as of `make_env`.
      physics, randomization, recording: "accurate" and None alone: the others are in the package.

    Raises:
      ConfigError: a setting is out of range or of the package alone, no scene suits the task, the bank has
        other objects, or the folder is no such export.
    """
    _check_own(
        Path(folder),
        {
            "robot": robot,
            "physics": physics,
            "randomization": randomization,
            "recording": recording,
        },
        action,
    )
    if task not in TASKS:
        raise ConfigError(
            f"task = {task!r}", ", ".join(TASKS), "task='place'", closest(task, TASKS)
        )
    check_settings(action, cameras, image_size, control_hz, max_seconds, reward, render_mode)
    given: dict[str, Any] = {
        "action": action,
        "cameras": tuple(cameras),
        "image_size": image_size,
        "control_hz": control_hz,
        "max_seconds": max_seconds,
        "reward": reward,
        "render_mode": render_mode,
    }
    kind = TASKS[task]
    own_bank = None if bank is None else str(Path(bank).absolute())
    recipe = partial(make_env, str(Path(folder).absolute()), task, own_bank, **given)
    return RobotEnv(ExportedWorld(folder, kind.has_stand, bank), kind, recipe=recipe, **given)


def register_ids(folder: str | Path) -> None:
    """Gives Gymnasium's ids to an export, also where cluttergen_jax or another export had them before."""
    for name, task in ENV_IDS.items():
        # Gymnasium would warn of one that is replaced.
        gymnasium.registry.pop(name, None)
        gymnasium.register(
            name, entry_point=f"{__name__}:make_env", kwargs={"folder": str(folder), "task": task}
        )


def _check_own(folder: Path, given: dict[str, object], action: str) -> None:
    """Refuses what the package alone can do (ConfigError)."""
    name = _read_record(folder)["robot"]
    allowed: dict[str, tuple[object, ...]] = {"robot": (None, name), "physics": ("accurate",)}
    wrong = [
        f"{key} = {value!r}"
        for key, value in given.items()
        if value not in allowed.get(key, (None,))
    ]
    if action == "tool":
        wrong.append("action = 'tool'")
    if wrong:
        raise ConfigError(
            f"{', '.join(wrong)} in an exported environment",
            f"robot {name!r}, joint or joint_delta, physics 'accurate', no randomization and no recording",
            _beside(folder),
        )


def _beside(folder: Path) -> str:
    """What to try instead of the environment of an export."""
    return (
        "cluttergen_jax.robot.make_env; Gymnasium's ids are those of "
        f"{folder / 'env.py'} once that is imported"
    )


def _bank_alike(path: str | Path, own: Bank, names: list[str], folder: Path) -> Bank:
    """A bank whose scenes the models of an export can hold (ConfigError)."""
    if not isinstance(path, str | Path) or not (Path(path) / "bank.json").is_file():
        raise ConfigError(f"bank = {path!r}, which is no folder of a bank", "", _beside(folder))
    bank = Bank(path)
    mine = own.record["assets"]
    other = bank.record["assets"]
    parts = ("region", "stability", "contact")
    is_alike = (
        other["objects"].items() <= mine["objects"].items()
        and set(bank.names) <= set(names)
        and other["support"] == mine["support"]
        and all(bank.recipe.get(each) == own.recipe.get(each) for each in parts)
    )
    if not is_alike:
        raise ConfigError(
            f"bank = {str(path)!r}, which has other objects, another support or other contacts than {folder}",
            "the bank that was exported, or another one of the same",
            _beside(folder),
        )
    return bank


def _read_record(folder: Path) -> dict[str, Any]:
    path = folder / FOLDER / RECORD
    if not path.is_file():
        raise ConfigError(
            f"{folder}, which has no {FOLDER}/{RECORD}",
            "a folder of the export `lerobot`",
            "cluttergen export BANK --format lerobot --robot panda",
        )
    try:
        record: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} is damaged ({error})", "", "the export again") from error
    number = record.get("format") if isinstance(record, dict) else None
    if number != FORMAT:
        raise ConfigError(f"{path} of format {number!r}", f"format {FORMAT}")
    return dict(record)


def _read_model(folder: Path, name: str) -> mujoco.MjModel:
    """A model with the numbers that its file was written from, which text rounds.

    Another version of MuJoCo may hold other arrays; of those that differ in shape it keeps its own.
    """
    model = mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
    for file in (SHARED, name):
        with np.load(folder / f"{file}.npz", allow_pickle=False) as numbers:
            for field_name in numbers.files:
                _set_exactly(model, field_name, numbers[field_name])
    return model


def _set_exactly(model: mujoco.MjModel, name: str, value: np.ndarray) -> None:
    """Sets a field of a model, or "opt.FIELD" of its options, if it has one of this shape."""
    holder = model.opt if name.startswith("opt.") else model
    name = name.removeprefix("opt.")
    own = getattr(holder, name, None)
    if own is None or np.shape(own) != value.shape:
        return
    if np.ndim(own):
        own[:] = value
    else:
        setattr(holder, name, float(value))


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
