"""Recordings as they are read: in which environment episodes were run, how each began, what was done.

What a recording says of its environment is all that makes it again (`environment_of`, `Recording.settings`);
of each episode it has the start, as numbers and names (`SavedStart`).
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cluttergen_jax.assets import object_hash, support_hash
from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
from cluttergen_jax.downstream.episodes.starts import SavedStart
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot, list_robots
from cluttergen_jax.downstream.robot.recorder import DATA, EPISODE_TABLE, STORE
from cluttergen_jax.errors import BankError, ConfigError, MissingExtraError, range_text
from cluttergen_jax.evaluation import versions
from cluttergen_jax.generation import BankArrays
from cluttergen_jax.schema import SchemaError, convert

if TYPE_CHECKING:
    from cluttergen_jax.downstream.episodes.env import RobotEnv

CONTRACT = 1
"""What numbers mean in a recording and its environment; another one is another contract."""
_SETTINGS = (
    "action",
    "cameras",
    "image_size",
    "physics",
    "control_hz",
    "max_seconds",
)
"""Of `make_env`, as they are; task, bank, robot and randomization are written otherwise."""
_AGAIN = "recording again: cluttergen robot record BANK"


def world_digest(bank: BankArrays) -> str:
    """Hex digest of what a bank gives to the model and the judges: objects, support, region, contacts."""
    compiled = bank.compiled
    told = {
        "objects": [
            [name, object_hash(each)]
            for name, each in zip(bank.names, compiled.objects, strict=True)
        ],
        "support": support_hash(bank.bank.support),
        "rules": [repr(bank.bank.stability), repr(bank.bank.contact)],
        "slots": int((np.asarray(bank.object_index) >= 0).sum(1).max()),
    }
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:32]


def environment_of(env: RobotEnv) -> dict[str, Any]:
    """What a recording says of its environment, as JSON values."""
    assert env.recipe is not None
    task, bank, robot = env.recipe.args
    given = env.recipe.keywords
    arrays = env.world.bank
    place = arrays.bank.path if isinstance(bank, BankArrays) else bank
    randomization = given["randomization"]
    told = {
        "contract": CONTRACT,
        "task": task,
        "bank": str(Path(place).absolute()) if Path(place).is_dir() else str(place),
        "bank_digest": world_digest(arrays),
        "robot": _robot_record(robot, env.world.description),
        "robot_digest": env.world.description.hash,
        **{name: given[name] for name in _SETTINGS},
        "randomization": randomization and asdict(randomization),
        "versions": versions(),
    }
    return dict(json.loads(json.dumps(told)))


def _robot_record(robot: Any, description: RobotDescription) -> Any:
    """A name, a file, or all of a description."""
    if not isinstance(robot, RobotDescription):
        name = str(robot)
        return name if name in list_robots() else str(Path(name).absolute())
    name = description.name
    if name in list_robots() and find_robot(name).hash == description.hash:
        return name
    return asdict(description)


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded episodes, by number from 0; made by `read_recording`.

    Attributes:
      path: the folder, or robomimic's file. form: "lerobot" or "robomimic".
      environment: what is said of the environment.
      starts: how each episode began, as text. outcomes: how each ended, "" of one that was not over.
    """

    path: Path
    form: str
    environment: Mapping[str, Any]
    starts: tuple[str, ...]
    outcomes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def successes(self) -> list[int]:
        """The episodes that ended in success: what to learn from."""
        return [k for k, outcome in enumerate(self.outcomes) if outcome == "success"]

    def __str__(self) -> str:
        """How many there are, and how they ended."""
        good = len(self.successes)
        return (
            f"{self.path}: {len(self)} episodes of {self.environment['task']!r}, {good} successes"
        )

    def start(self, episode: int) -> SavedStart:
        """How an episode began. Raises BankError: what is said of it is damaged."""
        with reading(self.path):
            return SavedStart.of_text(self.starts[episode])

    def actions(self, episode: int) -> np.ndarray:
        """f32[T, A]: what was done, for `step` of `make_env(recording=...)`.

        Raises:
          BankError: the episode is damaged. ConfigError: there is none of that number.
        """
        if not 0 <= episode < len(self):
            raise ConfigError(f"episode {episode} of {self.path}", range_text(0, len(self) - 1))
        with reading(self.path):
            if self.form == "robomimic":
                with _hdf5(self.path) as file:
                    return np.asarray(file[f"data/demo_{episode}/actions"], np.float32)
            place = self.path / DATA.format(chunk_index=episode // 1000, file_index=episode % 1000)
            table = pq.read_table(place, columns=["action"])
            return np.array(table["action"].to_pylist(), np.float32)

    @cached_property
    def bank(self) -> str:
        """Where its bank is: a folder, or OWNER/NAME on a hub.

        Raises:
          BankError: it is no longer there.
        """
        place = str(self.environment["bank"])
        folder = self.path if self.path.is_dir() else self.path.parent
        # It may have moved together with the recording.
        for each in (Path(place), folder / Path(place).name):
            if each.is_dir():
                return str(each)
        if Path(place).is_absolute() or place.count("/") != 1:
            raise BankError(
                f"{self.path}: the bank {place}, in which it was recorded, is not there",
                "its folder",
                "make_env(recording=..., bank=FOLDER), or " + _AGAIN,
            )
        return place

    @property
    def settings(self) -> dict[str, Any]:
        """The arguments of `make_env` that make its environment, but for the bank."""
        told = self.environment
        found = {name: told[name] for name in _SETTINGS}
        found |= {name: tuple(found[name]) for name in ("cameras", "image_size")}
        drawn = told["randomization"]
        robot = told["robot"]
        if isinstance(robot, dict):
            robot = convert(robot, RobotDescription)
        randomization = None if drawn is None else convert(drawn, RandomizationConfig)
        return {"task": told["task"], "robot": robot, "randomization": randomization, **found}

    def check(self, env: RobotEnv) -> None:
        """Refuses an environment of another bank or robot (BankError); says if a version is another one."""
        told = self.environment
        if world_digest(env.world.bank) != told["bank_digest"]:
            raise BankError(
                f"{env.world.bank.bank.path}: other objects, support or rules than those of {self.path}",
                f"the bank {told['bank']} as it was",
                "another `bank`, or " + _AGAIN,
            )
        if env.world.description.hash != told["robot_digest"]:
            raise BankError(
                f"{self.path}: its robot {env.world.description.name} has changed since",
                "the robot as it was",
                _AGAIN,
            )
        here = versions()
        if other := [
            f"{name} {value} (here {here.get(name)})"
            for name, value in told["versions"].items()
            if here.get(name) != value
        ]:
            print(
                f"note: {self.path} was recorded with {', '.join(other)}: episodes may end otherwise",
                file=sys.stderr,
            )


def read_recording(path: str | Path) -> Recording:
    """Reads a recording: a folder that `robot record` or `--record` made, or robomimic's file of it.

        recording = cg.robot.read_recording("demos")
        env = cg.robot.make_env(recording=recording)
        env.reset(options={"episode": 3})
        for action in recording.actions(3):
            observation, reward, terminated, truncated, info = env.step(action)

    Raises:
      BankError: there is none, it is damaged or unfinished, or of a version that knew no environments.
      MissingExtraError: robomimic's files need the extra `record`.
    """
    place = Path(path)
    if place.is_file():
        return _of_hdf5(place)
    record = STORE.read_record(place)
    form = record.get("recipe", {}).get("format")
    if form == "robomimic":
        return _of_hdf5(place / "demo.hdf5")
    environment = check_environment(record.get("recipe", {}).get("environment"), place)
    rows: list[dict[str, Any]] = []
    with reading(place):
        while True:
            number = len(rows)
            file = place / EPISODE_TABLE.format(
                chunk_index=number // 1000, file_index=number % 1000
            )
            if not file.is_file():
                break
            rows += pq.read_table(file, columns=["start", "outcome"]).to_pylist()
    starts, outcomes = (tuple(row[name] for row in rows) for name in ("start", "outcome"))
    return Recording(place, "lerobot", environment, starts, outcomes)


def _of_hdf5(place: Path) -> Recording:
    if not place.is_file():
        raise BankError(f"{place} is not there", "a finished recording", "rerun what records it")
    starts = []
    outcomes = []
    with reading(place), _hdf5(place) as file:
        told = json.loads(file["data"].attrs["env_args"])
        environment = check_environment(told["env_kwargs"].get("environment"), place)
        for k in range(len(file["data"])):
            demo = file[f"data/demo_{k}"].attrs
            starts.append(str(demo["start"]))
            outcomes.append(str(demo["outcome"]))
    return Recording(place, "robomimic", environment, tuple(starts), tuple(outcomes))


def check_environment(told: Any, place: Path) -> dict[str, Any]:
    """Refuses what this version does not know (BankError)."""
    if not isinstance(told, dict) or told.get("contract") != CONTRACT:
        found = told.get("contract") if isinstance(told, dict) else None
        what = "names no environment" if found is None else f"has contract {found!r}"
        raise BankError(
            f"{place} is a recording of another version: it {what}",
            f"contract {CONTRACT}",
            "the version that made it, or " + _AGAIN,
        )
    return told


@contextmanager
def reading(place: Path) -> Iterator[None]:
    """A recording is read in the block. Raises BankError: it is damaged."""
    try:
        yield
    except (pa.ArrowException, OSError, SchemaError, ValueError, LookupError, TypeError) as error:
        raise BankError(f"{place}: damaged ({error})", "a whole recording", _AGAIN) from error


def _hdf5(place: Path) -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("record", "reading HDF5") from error
    return h5py.File(place)
