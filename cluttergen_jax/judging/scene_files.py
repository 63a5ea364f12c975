"""Files of scenes as MuJoCo models with one start or more: MJCF, URDF, USD, SDF, and arrays of states."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers.mjcf_compile import compile_with_notes
from cluttergen_jax.importing.readers.opening import check_openable
from cluttergen_jax.importing.readers.xml_tree import parse_xml, plain_tag
from cluttergen_jax.judging.worlds import read_sdf_world, read_usd

_SDF = (".sdf", ".world")
SUFFIXES = (".xml", ".mjcf", ".mjb", ".urdf", ".usd", ".usda", ".usdc", ".usdz", *_SDF)
_ARRAYS = (".npz", ".npy")
_FREE = mujoco.mjtJoint.mjJNT_FREE
_BALL = mujoco.mjtJoint.mjJNT_BALL
_UNIT = 0.01
"""How far from 1 the length of a quaternion may be: files keep few digits, and MuJoCo makes it 1."""
_GIVEN = "an MJCF, URDF, SDF or USD file, or a folder of them"
_ROOT = re.compile(rb"<\s*+(\w++)[\s/>]")
_SECONDS = 120
"""Of a processor, to load one file."""
_CONVERT = (
    "a file that numpy.savez wrote, of an array f64[S, nq], or [S, 1 + nq + nv] with the time first"
)


def find_scenes(paths: Sequence[str | Path]) -> tuple[list[Path], int]:
    """The files of scenes among files and folders, and how many XML files of folders are none.

    Of a folder with a folder `scenes` in it, such as a bank, those in there are meant; of any other all below
    it. What a file includes (`<mujocoinclude>`) and XML of other kinds is no scene.

    Raises:
      ConfigError: a path does not exist, or there is no such file.
    """
    found: list[Path] = []
    num_others = 0
    for path in map(Path, paths):
        if not path.is_dir():
            if not path.exists():
                raise ConfigError(f"{path}, which does not exist", _GIVEN)
            found.append(path)
            continue
        folder = path / "scenes" if (path / "scenes").is_dir() else path
        files = sorted(each for each in folder.rglob("*") if each.suffix.lower() in SUFFIXES)
        scenes = [each for each in files if each.is_file() and _is_scene(each)]
        num_others += len(files) - len(scenes)
        found += scenes
    if not found:
        raise ConfigError(
            f"no scenes in {', '.join(map(str, paths))}", _GIVEN, "a file by its name"
        )
    return list(dict.fromkeys(found)), num_others


def _is_scene(path: Path) -> bool:
    """Whether the root of an XML file is that of MJCF or URDF, or an SDF file holds a world.

    True for other formats, and for what cannot be read, which is said of it then.
    """
    if path.suffix.lower() not in (*_SDF, ".xml"):
        return True
    if (root := parse_xml(path)) is not None:
        is_sdf = path.suffix.lower() in _SDF
        return root.find("world") is not None if is_sdf else plain_tag(root) in ("mujoco", "robot")
    # Whoever reads it says what is wrong with it.
    try:
        found = _ROOT.search(path.read_bytes())
    except OSError:
        return True
    return path.suffix.lower() in _SDF or (found is not None and found[1] in (b"mujoco", b"robot"))


def read_model(path: Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of a file as MuJoCo loads it, and what it was loaded without.

    Raises:
      AssetError: it cannot be loaded.
      MissingExtraError: it is USD, and usd-core is not installed.
    """
    check_openable(path)
    if path.suffix.lower() in (".xml", ".mjcf"):
        return compile_with_notes(path, is_simulated=True)
    return call_limited(path, load_model, path, seconds=_SECONDS)


def load_model(path: Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """`read_model` of a file that is not MJCF, in this process, without limits."""
    suffix = path.suffix.lower()
    notes: tuple[str, ...] = ()
    try:
        if suffix.startswith(".usd"):
            model = read_usd(path)
        elif suffix in _SDF:
            model, notes = read_sdf_world(path)
        elif suffix == ".mjb":
            model = mujoco.MjModel.from_binary_path(str(path))
        else:
            model = mujoco.MjModel.from_xml_string(_with_paths(path))
        model.names.decode()
    except (ValueError, OSError, RecursionError, mujoco.FatalError) as error:
        raise AssetError(" ".join(str(error).split()) or "MuJoCo cannot load it") from error
    return model, notes


def _with_paths(path: Path) -> str:
    """A URDF that names its meshes by paths from its folder: MuJoCo keeps the last part alone unless told."""
    text = path.read_text(encoding="utf-8")
    if re.search(r"<mujoco[\s>]", text):
        return text
    own = f'<mujoco><compiler strippath="false" meshdir="{path.parent.absolute()}"/></mujoco>'
    return re.sub(r"(<robot\b[^>]*>)", lambda found: found[1] + own, text, count=1).replace(
        "package://", ""
    )


def read_starts(
    model: mujoco.MjModel, path: Path, states: str | Path | np.ndarray | None, most: int
) -> tuple[list[tuple[str, mujoco.MjData]], int]:
    """The starts of a file by name, at most so many, evenly spread; and how many more there are.

    They are the states that are given, else those in an array beside the file, else its keyframes, else the
    place of its bodies.

    Args:
      states: f64[S, nq] or wider rows (`_positions`), or a file of such arrays.

    Raises:
      AssetError: the states are not the model's, are not finite, or their file cannot be read.
    """
    beside = (path.with_suffix(suffix) for suffix in _ARRAYS)
    given = states if states is not None else next(filter(Path.is_file, beside), None)
    rows: list[tuple[str, np.ndarray | int]] = [("", -1)]
    if given is not None:
        rows = [
            (f"{name}{place}", row)
            for name, array in _arrays(given)
            for place, row in enumerate(_positions(model, array))
        ]
    elif model.nkey:
        rows = [(model.key(key).name or f"key-{key}", key) for key in range(model.nkey)]
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(int))
    starts = []
    for name, row in (rows[place] for place in chosen):
        data = mujoco.MjData(model)
        if isinstance(row, np.ndarray):
            data.qpos[:] = row
        elif row >= 0:
            mujoco.mj_resetDataKeyframe(model, data, row)
        starts.append((name, data))
    return starts, len(rows) - len(starts)


def _arrays(states: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of states with what to call them."""
    if not isinstance(states, str | Path):
        try:
            yield "", np.asarray(states)
        except (ValueError, TypeError) as error:
            raise AssetError(
                f"states that are no array ({error})", "an array f64[S, nq]"
            ) from error
        return
    try:
        loaded = np.load(states, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            yield "", loaded
            return
        with loaded:
            names = loaded.files
            for name in names:
                yield (f"{name}-" if len(names) > 1 else ""), loaded[name]
    except (OSError, EOFError, ValueError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise AssetError(f"the states {states} cannot be read ({error})", _CONVERT) from error


def _positions(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """f64[S, nq]: the positions in rows of these alone, or with velocities behind and the time before them.

    What a row has of velocities and activations does not count: a start is at rest.

    Raises:
      AssetError: they are not real numbers, not the model's, not finite, or a quaternion is not of unit
        length; the text says which.
    """
    if not (np.issubdtype(states.dtype, np.floating) or np.issubdtype(states.dtype, np.integer)):
        raise AssetError(f"states of type {states.dtype}", "real numbers")
    nq = model.nq
    nv = model.nv
    na = model.na
    first = {nq: 0, nq + nv: 0, nq + nv + na: 0, 1 + nq + nv: 1, 1 + nq + nv + na: 1}
    width = states.shape[-1] if states.ndim in (1, 2) else None
    if width not in first or not len(states):
        allowed = f"rows of nq = {nq}, nq + nv = {nq + nv} or 1 + nq + nv = {1 + nq + nv} numbers"
        raise AssetError(f"states of shape {states.shape} are none of this model", allowed)
    with np.errstate(over="ignore"):
        wide = np.atleast_2d(states).astype(float)
    if not (is_finite := np.isfinite(wide)).all():
        row, column = np.argwhere(~is_finite)[0].tolist()
        number = int((~is_finite).sum())
        given = f"states[{row}, {column}] = {wide[row, column]}, of {number} numbers that are not finite"
        raise AssetError(given, "finite numbers")
    rows = wide[:, first[width] : first[width] + nq]
    for joint in np.flatnonzero(np.isin(model.jnt_type, [int(_FREE), int(_BALL)])).tolist():
        start = int(model.jnt_qposadr[joint]) + (3 if model.jnt_type[joint] == _FREE else 0)
        length = np.linalg.norm(rows[:, start : start + 4], axis=1)
        if (wrong := np.abs(length - 1) > _UNIT).any():
            row = int(wrong.argmax())
            from_ = first[width] + start
            body = (
                model.body(int(model.jnt_bodyid[joint])).name
                or f"body-{int(model.jnt_bodyid[joint])}"
            )
            which = f"states[{row}, {from_}:{from_ + 4}], the quaternion of {body!r}"
            raise AssetError(
                f"{which}, is of length {length[row]:.4g}",
                f"unit quaternions wxyz, to within {_UNIT:g}",
                "dividing it by its length, if the order of the columns is right",
            )
    return rows
