"""The independent check: a saved file, loaded afresh in plain MuJoCo, everything awake, for ten seconds."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from cluttergen_jax.bank.bank import INDEX
from cluttergen_jax.config import VerifyConfig
from cluttergen_jax.errors import BankError, UnsafePathError
from cluttergen_jax.files import inside
from cluttergen_jax.physics.log import silent_log
from cluttergen_jax.physics.rotation import turn_between

_STRIDE = 12
_SHORTEST_STEP, _LONGEST_STEP = 1e-4, 0.05
_GIVEN = "the folder of a bank with files, or one MJCF file"
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_OURS = "files written by `cluttergen generate`"


@dataclass(frozen=True, eq=False)
class Verification:
    """How a saved scene behaved.

    Attributes:
      path: the file.
      objects: names of its free bodies.
      shift: f64[N], the farthest each was from its start, metres.
      turn: f64[N], the most each had turned, radians.
      stands: all of them stayed within the limits.
    """

    path: Path
    objects: tuple[str, ...]
    shift: np.ndarray
    turn: np.ndarray
    stands: bool

    @property
    def worst(self) -> str:
        """The object that moved the most."""
        return self.objects[int(np.argmax(self.shift))]


def verify_scene(path: str | Path, config: VerifyConfig | None = None) -> Verification:
    """Simulates one MJCF file from its keyframe `scene`, at rest.

    Raises:
      BankError: the file cannot be loaded, has no such keyframe, or its bodies and keyframe disagree.
      UnsafePathError: the file is one of a bank, and names files outside of that bank.
    """
    config = config or VerifyConfig()
    path = Path(path)
    if (path.parent.parent / INDEX).is_file():
        _check_links(path, path.parent.parent)
    try:
        with silent_log():
            return _simulated(path, *_loaded(path), config)
    except mujoco.FatalError as error:
        raise BankError(f"{path} cannot be simulated: {error}", _OURS) from error


def _check_links(path: Path, bank: Path) -> None:
    """Refuses a bank's scene file that makes MuJoCo read what is not the bank's."""
    try:
        elements = list(ET.parse(path).iter())
    except (OSError, ET.ParseError):
        # What cannot be parsed is for MuJoCo to explain.
        return
    if any(element.tag == "include" for element in elements):
        raise UnsafePathError(f"{path} includes another file", _OURS)
    folders = {element.get(name, ".") for element in elements for name in _FOLDERS}
    for folder in (path.parent / each for each in folders):
        if not Path(os.path.realpath(folder)).is_relative_to(os.path.realpath(bank)):
            raise UnsafePathError(f"{path} names the folder {folder}", f"folders of {bank}")
        for element in elements:
            for attribute in element.attrib:
                if attribute.startswith("file"):
                    inside(folder, element.get(attribute))


def _loaded(path: Path) -> tuple[mujoco.MjModel, int]:
    """The model of a scene file, and its keyframe `scene`."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        model.names.decode()
    except (ValueError, OSError) as error:
        told = " ".join(str(error).split())
        raise BankError(f"{path} cannot be loaded: {told}", _OURS, "generating the bank again") from error
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "scene")
    if key < 0:
        raise BankError(f"{path} has no keyframe called 'scene'", _OURS)
    if not model.njnt or (model.jnt_type != mujoco.mjtJoint.mjJNT_FREE).any():
        raise BankError(f"{path} holds no free bodies, or joints of another kind", _OURS)
    if not np.allclose(model.key_qpos[key], model.qpos0, atol=1e-6):
        raise BankError(f"{path}: the bodies' poses and the keyframe 'scene' differ")
    if not _SHORTEST_STEP <= model.opt.timestep <= _LONGEST_STEP:
        allowed = f"{_SHORTEST_STEP} to {_LONGEST_STEP} s"
        raise BankError(f"{path}: its time step is {model.opt.timestep:g} s", allowed)
    return model, key


def _simulated(path: Path, model: mujoco.MjModel, key: int, config: VerifyConfig) -> Verification:
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    # A diverging scene must be seen, not put back to where it started.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    data.qvel[:] = 0
    start = data.qpos.reshape(-1, 7).copy()
    shift, turn = np.zeros(len(start)), np.zeros(len(start))
    for num_steps in _strides(round(config.seconds / model.opt.timestep)):
        mujoco.mj_step(model, data, num_steps)
        poses = data.qpos.reshape(-1, 7)
        shift = np.maximum(shift, np.linalg.norm(poses[:, :3] - start[:, :3], axis=1))
        turn = np.maximum(turn, turn_between(np, poses[:, 3:], start[:, 3:]))
    names = tuple(model.body(int(body)).name for body in model.jnt_bodyid)
    stands = bool((shift <= config.max_shift).all() and (turn <= np.radians(config.max_turn_deg)).all())
    return Verification(path, names, shift, turn, stands)


def _strides(num_steps: int) -> list[int]:
    """`num_steps` in strides after each of which the scene is looked at."""
    whole, rest = divmod(num_steps, _STRIDE)
    return [_STRIDE] * whole + [rest] * (rest > 0)


def scene_files(path: str | Path) -> list[Path]:
    """The MJCF files of a bank, or the one that is given.

    Raises:
      BankError: there is nothing to verify.
    """
    path = Path(path)
    if path.suffix in (".parquet", ".json"):
        raise BankError(f"{path} is a part of a bank", _GIVEN, f"cluttergen verify {path.parent}")
    if path.is_file():
        return [path]
    files = sorted((path / "scenes").glob("*.xml"))
    if not files:
        raise BankError(
            f"{path} holds no scene files",
            _GIVEN,
            "cluttergen generate --out DIR, which writes files unless it is told otherwise",
        )
    return files
