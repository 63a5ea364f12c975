"""Files of scenes as MuJoCo models with one start or more: MJCF, URDF, USD, and arrays of states."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.evaluation.judging.usd_scene import read_usd
from cluttergen_jax.importing.readers.mjcf import check_before_mujoco
from cluttergen_jax.importing.readers.xml_tree import parse_xml, plain_tag

SUFFIXES = (".xml", ".mjcf", ".mjb", ".urdf", ".usd", ".usda", ".usdc", ".usdz")
_ARRAYS = (".npz", ".npy")
_GIVEN = "an MJCF, URDF or USD file, or a folder of them"
_ROOT = re.compile(rb"<\s*+(\w++)[\s/>]")
_CONVERT = "a file that numpy.savez wrote, of an array f64[S, nq], or [S, 1 + nq + nv] with the time first"


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
        raise ConfigError(f"no scenes in {', '.join(map(str, paths))}", _GIVEN, "a file by its name")
    return list(dict.fromkeys(found)), num_others


def _is_scene(path: Path) -> bool:
    """Whether the root of an XML file is that of MJCF or URDF; True for other formats."""
    if path.suffix.lower() != ".xml":
        return True
    root = parse_xml(path)
    if root is not None:
        return plain_tag(root) in ("mujoco", "robot")
    # Whoever reads it says what is wrong with it.
    found = _ROOT.search(path.read_bytes())
    return found is not None and found[1] in (b"mujoco", b"robot")


def read_model(path: Path) -> mujoco.MjModel:
    """The model of a file as MuJoCo loads it.

    Raises:
      AssetError: it cannot be loaded.
      MissingExtraError: it is USD, and usd-core is not installed.
    """
    suffix = path.suffix.lower()
    try:
        if suffix.startswith(".usd"):
            model = read_usd(path)
        elif suffix == ".mjb":
            check_before_mujoco(path)
            model = mujoco.MjModel.from_binary_path(str(path))
        elif suffix == ".urdf":
            text = _with_paths(path)
            check_before_mujoco(path, text)
            model = mujoco.MjModel.from_xml_string(text)
        else:
            check_before_mujoco(path)
            model = mujoco.MjModel.from_xml_path(str(path))
        model.names.decode()
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise AssetError(" ".join(str(error).split()) or "MuJoCo cannot load it") from error
    return model


def _with_paths(path: Path) -> str:
    """A URDF that names its meshes by paths from its folder: MuJoCo keeps the last part alone unless told."""
    text = path.read_text(encoding="utf-8")
    if re.search(r"<mujoco[\s>]", text):
        return text
    own = f'<mujoco><compiler strippath="false" meshdir="{path.parent.absolute()}"/></mujoco>'
    return re.sub(r"(<robot\b[^>]*>)", lambda found: found[1] + own, text, count=1).replace("package://", "")


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


def _arrays(states: str | Path | np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of states with what to call them."""
    if isinstance(states, np.ndarray):
        yield "", states
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
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise AssetError(f"the states {states} cannot be read ({error})", _CONVERT) from error


def _positions(model: mujoco.MjModel, states: np.ndarray) -> np.ndarray:
    """f64[S, nq]: the positions in rows of these alone, or with velocities behind and the time before them.

    What a row has of velocities and activations does not count: a start is at rest.
    """
    nq, nv, na = model.nq, model.nv, model.na
    first = {nq: 0, nq + nv: 0, nq + nv + na: 0, 1 + nq + nv: 1, 1 + nq + nv + na: 1}
    width = states.shape[-1] if states.ndim in (1, 2) else None
    if width not in first or not len(states) or not np.issubdtype(states.dtype, np.number):
        allowed = f"rows of nq = {nq}, nq + nv = {nq + nv} or 1 + nq + nv = {1 + nq + nv} numbers"
        raise AssetError(f"states of shape {states.shape} are none of this model", allowed)
    rows = np.atleast_2d(states)[:, first[width] : first[width] + nq].astype(float)
    if not np.isfinite(rows).all():
        raise AssetError("states that hold numbers that are not finite")
    return rows
