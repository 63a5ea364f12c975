"""Reads a bank of scenes anywhere: one file, which needs NumPy and pyarrow and nothing of cluttergen_jax.

    from bank_reader import Bank             # beside every bank; in the package cluttergen_jax.bank_reader

    bank = Bank("folder")
    for scene in bank.successes():           # `for scene in bank` has failures, too
        print(scene.names, scene.poses)
    scene = bank.reset(0)                    # drawn with a seed, or with a generator of NumPy
    model = bank.model(scene.index)          # MuJoCo from 2.3.7 on; the keyframe `scene` holds the poses
    scenes = jax.vmap(bank.reset_jax)(keys)  # arrays of JAX

`python bank_reader.py FOLDER` prints what a bank holds. Poses are T_world_object: metres, quaternion wxyz; z
points up, the origin is on the floor below the support's centre. Python 3.8 or newer. Long as it is, it stays
one file, so that it can be copied alone.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import re
import stat
import sys
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, NamedTuple, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

if int(pa.__version__.partition(".")[0]) < 15:
    raise ImportError(f"bank_reader needs pyarrow 15 or newer, and this is {pa.__version__}")
FORMAT = 1
"""Of banks; newer ones are refused."""
_FORMATS = (1, 2, 3)
"""Of their assets."""
# Scenes of a row group; row groups that are read together.
_BLOCK_SIZE = 256
_AT_ONCE = 32

_TRIES = 100
"""So often a folder is listed again that changes while it is read."""
_MOST_BLOCKS = 768
"""Row groups of a file of rows."""
_MOST_UNPACKED = 2**30
"""Bytes of a row group once it is unpacked: four megabytes for each of its scenes."""
_MOST_BYTES = {".json": 2**28, ".parquet": 2**34}
"""Of a file, by its ending; a mesh or an image has at most `_MOST_MESH`."""
_MOST_MESH = 2**30
_FAR = 1000.0
"""Metres beyond which nothing of a bank is."""
# What is above zero (kilograms, metres, kg m^2, coefficients of friction) is between these.
_TINY = 1e-12
_HEAVY = 1e9

_FILE = re.compile(r"scenes-(\d{6,9})(?:-(\d{6,9}))?\.parquet")
_NAME = re.compile(r"[a-z0-9_-]+(#\d+)?")
_IMAGE = re.compile(r"[a-z0-9_-]+\.png")
_DIGEST = re.compile("[0-9a-f]{64}")
_MAPS = ("normal", "orm")
_LISTS = ("objects", "is_placed", "poses")
_COLUMNS = ("index", "is_success", "verdict", *_LISTS)
_KINDS: dict[str, Callable[[Any], bool]] = {
    "index": pa.types.is_integer,
    "is_success": pa.types.is_boolean,
    "verdict": pa.types.is_string,
    "objects": pa.types.is_string,
    "is_placed": pa.types.is_boolean,
    "poses": pa.types.is_floating,
}
"""Of the values in a column."""
_AGAIN = "the same `cluttergen generate` again, which mends a bank, or a copy that is whole"
_WAIT = (50.0, 10.0, 0.1)
"""Metres: from which x on and at which z objects wait that a scene lacks, and the gap between two."""
_WITH_ROUGHNESS = (3, 2)
_WITH_LAYERS = (3, 2, 7)
"""MuJoCo that reads maps of a material."""
_NEWEST = "3.17"
"""MuJoCo whose words are written where none is installed."""
_TOUCH = ("friction", "solref", "solimp", "condim")
_SOLVER = ("impratio", "iterations", "noslip_iterations")
_MJCF = """<mujoco model="cluttergen scene">
<compiler angle="radian" meshdir={assets} texturedir={assets}/>
<option timestep="{timestep!r}" gravity="0 0 {gravity:.9g}" cone={cone} {solver}>
<flag multiccd="enable"{flag}/></option>
<default><geom {touch} gap="0"/></default>
<visual><headlight ambient="0.32 0.32 0.33" diffuse="0.28 0.28 0.28" specular="0.05 0.05 0.05"/>
<global offwidth="1280" offheight="960"/><quality shadowsize="4096"/><map haze="0.6"/>
<rgba haze="0.90 0.905 0.915 1"/></visual>
<asset>{files}
</asset>
<worldbody>{bodies}
</worldbody>
{key}</mujoco>
"""
_SKY = """<texture name="sky" type="skybox" builtin="gradient" width="256" height="1536"
rgb1="0.62 0.69 0.78" rgb2="0.90 0.905 0.915"/>
"""
_FLOOR = """<light name="sun" pos="0.6 -0.8 3" dir="-0.2 0.45 -1" directional="true" diffuse="0.62 0.61 0.59"
specular="0.15 0.15 0.15"/><geom name="floor" type="plane" size="0 0 0.1" rgba="0.82 0.82 0.83 1"/>
"""


def _printable(text: str) -> str:
    """A text of a file with its control characters as escapes, so that a terminal does not obey them."""
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


class BankError(Exception):
    """A bank cannot be read.

    Args:
      given: what was given; allowed: what is allowed; hint: what to try. Control characters are escaped.
    """

    def __init__(self, given: str, allowed: str = "", hint: str = "") -> None:
        given, allowed, hint = map(_printable, (given, allowed, hint))
        self.given = given
        self.allowed = allowed
        self.hint = hint
        parts = (given, allowed and f"Allowed: {allowed}", hint and f"Try: {hint}")
        super().__init__(" ".join(f"{part}." for part in parts if part))


class _GoneError(Exception):
    """A file that was listed is not there any more."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene of N placed objects, in the order of placement.

    Attributes:
      index: its number in the bank.
      is_success: every object was placed, and the finished scene is stable.
      verdict: "stable", or why it failed.
      names: of the objects, unique: the second mug is `mug#2`.
      object_index: i32[N], their numbers in `Bank.names`.
      poses: f64[N, 7], world frame.
      unplaced: the objects that found no place.
    """

    index: int
    is_success: bool
    verdict: str
    names: tuple[str, ...]
    object_index: np.ndarray
    poses: np.ndarray
    unplaced: tuple[str, ...]

    @property
    def qpos(self) -> np.ndarray:
        """f64[7 N]: the configuration of `Bank.model(index)`."""
        return self.poses.ravel()


class SceneArrays(NamedTuple):
    """S scenes of up to N objects; or one of them, without the leading axis. To JAX it is a pytree.

    Attributes:
      index: i32[S], their numbers in the bank.
      object_index: i32[S, N], numbers in `Bank.names`, -1 for none.
      is_placed: bool[S, N], whether the object is there.
      poses: f32[S, N, 7], world frame; the identity where there is none.
    """

    index: Any
    object_index: Any
    is_placed: Any
    poses: Any

    def reset(self, key: Any) -> SceneArrays:
        """One of the scenes, all equally likely, drawn with a key of JAX; to be compiled and mapped."""
        import jax

        place = jax.random.randint(key, (), 0, self.index.shape[0])
        return SceneArrays(*(each[place] for each in self))


class Asset(NamedTuple):
    """An object or the support, with the paths of its meshes; SI units, in the frame of its poses.

    Attributes:
      record: of an object `mass`, `center_of_mass`, `inertia` about it, `friction` if it came with one,
        `resting` poses, `provenance` with the licence; of the support its `top`, and `boxes` that carry.
      parts: OBJ files of the convex collision parts.
      surfaces: what is seen: for each piece an OBJ file, its rgba, and an image that it multiplies or None.
      finishes: for each piece how it reflects light, None where that is not known: `roughness`, `metallic`,
        `transmission`, which may be absent, and the paths of its maps, `normal` and `orm` (as glTF's).
    """

    name: str
    label: str
    record: dict[str, Any]
    parts: tuple[Path, ...]
    surfaces: tuple[tuple[Path, list[float], Path | None], ...]
    finishes: tuple[dict[str, Any] | None, ...] = ()


class _Rows(NamedTuple):
    """S scenes as columns; the last three hold all their slots in a row, `num_slots` i64[S] of each."""

    number: np.ndarray
    is_success: np.ndarray
    verdict: np.ndarray
    num_slots: np.ndarray
    object_index: np.ndarray
    is_placed: np.ndarray
    poses: np.ndarray


class Bank:
    """A bank in a folder. Opening it reads `bank.json` alone; what is read later is kept.

    Whatever is read is checked: files are regular ones within the folder and not too large, they have the
    digests that `bank.json` states (each file of rows is hashed once, when it is first read), and numbers are
    finite and in range.

    Attributes:
      path: the folder.
      record: what `bank.json` holds.
      recipe: how its scenes were made: `pool`, `method`, `seed`, `placement`, `stability`, `contact`.
      num_asked: how many scenes it was asked for; more than `len` says if it was interrupted.

    Raises:
      BankError: the folder is no bank, it is damaged, or a newer version of cluttergen_jax made it.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.record = _read_record(self.path)
        self.recipe: dict[str, Any] = self.record["recipe"]
        self.num_asked: int = self.record["num_scenes"]
        self._assets: dict[str, Asset] = {}

    def __repr__(self) -> str:
        return f"Bank({str(self.path)!r}, {len(self)} of {self.num_asked} scenes)"

    def __len__(self) -> int:
        """How many scenes are there, failures included."""
        return len(self.indices)

    def __iter__(self) -> Iterator[Scene]:
        """All scenes that are there, failures included, in order."""
        return (
            scene
            for rows in self._blocks.read(self._convert, _COLUMNS)
            for scene in self._scenes(rows)
        )

    def successes(self) -> Iterator[Scene]:
        """The scenes that succeeded, in order."""
        return (scene for scene in self if scene.is_success)

    def scene(self, index: int) -> Scene:
        """The scene of this number; its block alone is read (BankError: it is not there)."""
        if index not in self.indices:
            held = (
                f"{self.indices[0]} to {self.indices[-1]}, {len(self)} scenes"
                if len(self)
                else "none yet"
            )
            raise BankError(f"{self.path} has no scene {index}", held, "a number of `bank.indices`")
        (rows,) = self._blocks.read(self._convert, _COLUMNS, [int(index) // _BLOCK_SIZE])
        return next(scene for scene in self._scenes(rows) if scene.index == index)

    @cached_property
    def indices(self) -> np.ndarray:
        """i64, sorted: the numbers of the scenes that are there."""
        numbers = map(self._blocks.numbers, list(self._blocks.places))
        return np.concatenate([np.zeros(0, np.int64), *numbers])

    @cached_property
    def _blocks(self) -> Blocks:
        digests = RowDigests(self.record["files"], lambda: _read_record(self.path)["files"])
        return Blocks(self.path, digests)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The objects that `object_index` numbers; not every one of them is in a scene."""
        found = self._blocks.read(
            lambda rows: pc.unique(pc.list_flatten(rows["objects"])).to_pylist(), ("objects",)
        )
        names = self.recipe.get("names") or [name for each in found for name in each]
        if not isinstance(names, list) or not all(
            isinstance(name, str) and _NAME.fullmatch(name) for name in names
        ):
            raise BankError(
                f"{self.path / 'bank.json'} names objects that cannot be", "a-z, 0-9, _ and -"
            )
        return tuple(dict.fromkeys(names))

    @property
    def labels(self) -> dict[str, str]:
        """What each object is, by the name of its asset."""
        return {name: self.asset(name).label for name in self.record["assets"]["objects"]}

    @property
    def region(self) -> dict[str, Any]:
        """Where objects were put on the top: `center`, `half_extents` (metres) and `yaw` (radians)."""
        with _reading(self.path):
            region = self.recipe.get("region") or self.support.record["region"]
            _check_region(region)
            sides = {name: tuple(map(float, region[name])) for name in ("center", "half_extents")}
            return {**sides, "yaw": float(region["yaw"])}

    @cached_property
    def arrays(self) -> SceneArrays:
        """All scenes that succeeded, as arrays of NumPy (BankError: there are none)."""
        parts = list(self._blocks.read(self._convert, _COLUMNS))
        if not any(rows.is_success.any() for rows in parts):
            raise BankError(
                f"{self.path}: none of its {len(self)} scenes succeeded", "", "more scenes"
            )
        rows = _Rows(*map(np.concatenate, zip(*parts)))
        row = np.repeat(np.arange(len(rows.number)), rows.num_slots)
        is_kept = rows.is_placed & rows.is_success[row]
        scene = (np.cumsum(rows.is_success) - 1)[row[is_kept]]
        slot = np.arange(len(scene)) - np.searchsorted(scene, scene)
        shape = (int(rows.is_success.sum()), int(slot.max(initial=-1)) + 1)
        object_index = np.full(shape, -1, np.int32)
        poses = np.zeros((*shape, 7), np.float32)
        poses[..., 3] = 1
        object_index[scene, slot] = rows.object_index[is_kept]
        poses[scene, slot] = rows.poses[is_kept]
        index = rows.number[rows.is_success].astype(np.int32)
        return SceneArrays(index, object_index, object_index >= 0, poses)

    def reset(self, rng: np.random.Generator | int) -> Scene:
        """A scene that succeeded, all equally likely, drawn with a generator of NumPy, or a seed."""
        place = np.random.default_rng(rng).integers(len(self.arrays.index))
        index, objects, is_placed, poses = (each[place] for each in self.arrays)
        names = tuple(self.names[number] for number in objects[is_placed])
        poses = poses[is_placed].astype(np.float64)
        return Scene(int(index), True, "stable", names, objects[is_placed], poses, ())

    def reset_jax(self, key: Any) -> SceneArrays:
        """A scene that succeeded, all equally likely, drawn with a key of JAX; to be compiled and mapped.

        All scenes become a constant of what is compiled. Of a large bank give `jax.device_put(bank.arrays)`
        to a compiled `lambda arrays, key: arrays.reset(key)`.
        """
        return self._device_arrays.reset(key)

    def state(self, scene: SceneArrays) -> tuple[Any, Any]:
        """How a scene begins in the model of all objects, `model()`: one of `reset_jax`, or of `arrays`.

        Returns:
          f[7 K], its qpos; f[K, 6], newtons, for `xfrc_applied[2:]`: what holds the objects that it lacks.
        """
        used, waiting, weight = self._crowd
        is_it = (scene.object_index[:, None] == used) & scene.is_placed[:, None]
        is_there = is_it.any(0)[:, None]
        poses = (is_it[..., None] * scene.poses[:, None]).sum(0)
        return (is_there * poses + ~is_there * waiting).ravel(), ~is_there * weight

    @cached_property
    def _crowd(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Objects of scenes that stand, i32[K]; where they wait, f32[K, 7]; what holds them, f32[K, 6]."""
        used = np.unique(self.arrays.object_index[self.arrays.is_placed])
        assets = [self.asset(self.names[number]) for number in used]
        poses = np.zeros((len(used), 7), np.float32)
        weight = np.zeros((len(used), 6), np.float32)
        with _reading(self.path):
            vertices = [
                np.concatenate([np.array(part) for part in each.record["parts"]]) for each in assets
            ]
            radius = np.array([np.linalg.norm(each, axis=1).max() for each in vertices])
            weight[:, 2] = [
                asset.record["mass"] * self.recipe["contact"]["gravity"] for asset in assets
            ]
        poses[:, 0] = _WAIT[0] + np.cumsum(2 * radius + _WAIT[2]) - radius
        poses[:, 2] = _WAIT[1]
        poses[:, 3] = 1
        return used, poses, weight

    @cached_property
    def _device_arrays(self) -> SceneArrays:
        import jax

        # Asked for within what is being compiled, they are arrays too, and no part of it.
        with jax.ensure_compile_time_eval():
            return SceneArrays(*map(jax.numpy.asarray, self.arrays))

    def asset(self, name: str) -> Asset:
        """The object called `name`, or that of a name such as `mug#2`, from the bank's own copy.

        Raises:
          BankError: there is none, or a file of it is missing or not what was written.
        """
        name = name.partition("#")[0]
        folder = f"assets/objects/{name}"
        if not (_NAME.fullmatch(name) and (self.path / folder).is_dir()):
            known = ", ".join(sorted(self.record["assets"]["objects"]))
            raise BankError(f"{self.path} has no files of an object {name!r}", known)
        if name not in self._assets:
            self._assets[name] = self._read_asset(name, folder, "object.json", "assets/textures")
        return self._assets[name]

    @cached_property
    def support(self) -> Asset:
        """What the objects stand on (BankError: a file of it is missing or not what was written)."""
        return self._read_asset("support", "assets/support", "support.json", "assets/support")

    def xml(self, index: int | None = None, *, version: str = "", assets: str = "") -> str:
        """MJCF of a scene: each object a free body, poses in the bodies and in the keyframe `scene`.

        Options, contacts and the detector of collisions are those of files that `cluttergen generate` writes.

        Args:
          index: of a scene that succeeded. Without it, the text is of all objects that such scenes have, in
            the order of `names`; they wait in the air, where they touch nothing, for the `state` of a scene.
          version: of the MuJoCo that will read it, such as "3.5.0"; of the one installed if not given.
          assets: the folder `assets`, seen from where the text will lie; its absolute path if not given.

        Raises:
          BankError: there is no such scene, it failed, or an asset is damaged.
        """
        if index is None:
            names = [self.names[number] for number in self._crowd[0]]
            poses = self._crowd[1]
        else:
            scene = self.scene(index)
            names = list(scene.names)
            poses = scene.poses
            if not scene.is_success:
                raise BankError(
                    f"scene {index} of {self.path} failed ({scene.verdict})", "those that succeeded"
                )
        return self._text(
            names, [self.asset(name) for name in names], poses, self.support, version, assets
        )

    def object_xml(self, name: str, body: str = "", *, version: str = "", assets: str = "") -> str:
        """MJCF of one object, a free body at the origin called `body` or as it, to be attached to a model.

        Raises:
          BankError: there is no such object, or a file of it is damaged.
        """
        pose = np.array([[0, 0, 0, 1, 0, 0, 0]])
        return self._text([body or name], [self.asset(name)], pose, None, version, assets)

    def support_xml(self, *, version: str = "", assets: str = "") -> str:
        """MJCF of the support alone, a fixed body called `support`, likewise."""
        return self._text([], [], np.zeros((0, 7)), self.support, version, assets, alone=True)

    def _text(
        self,
        names: Sequence[str],
        objects: Sequence[Asset],
        poses: np.ndarray,
        support: Asset | None,
        version: str,
        assets: str,
        alone: bool = False,
    ) -> str:
        numbers = tuple(map(int, re.findall(r"\d+", version or _installed_version())[:3]))
        if not numbers:
            raise BankError(f"version {version!r} of MuJoCo", "numbers such as 3.5.0")
        folder = assets or (self.path / "assets").absolute().as_posix()
        with _reading(self.path):
            return _mjcf(
                self, names, objects, poses, support, numbers, folder, alone or support is None
            )

    def model(self, index: int | None = None) -> Any:
        """`xml(index)`, compiled by the MuJoCo installed here (BankError: there is none, or it refuses)."""
        try:
            import mujoco
        except ImportError as error:
            raise BankError(
                "a model without MuJoCo", "2.3.7 or newer", "pip install mujoco"
            ) from error
        text = self.xml(index)
        try:
            return mujoco.MjModel.from_xml_string(text)
        except (ValueError, mujoco.FatalError) as error:
            given = f"MuJoCo {mujoco.__version__} refuses a model of {self.path} ({_line(error)})"
            raise BankError(given, "2.3.7 or newer") from error

    def summary(self) -> str:
        """What it holds, for people (BankError: it is damaged)."""
        verdicts: Counter[str] = Counter()
        used: set[str] = set()
        number = 0
        half = self.region["half_extents"]
        for rows in self._blocks.read(self._convert, _COLUMNS):
            verdicts.update(rows.verdict.tolist())
            placed = np.unique(rows.object_index[rows.is_placed])
            used.update(self.names[each].partition("#")[0] for each in placed)
            number += int(rows.is_success.sum())
        recipe = self.recipe
        rest = f"; {_AGAIN.partition(',')[0]} makes the others"
        made = (f"{name} {recipe.get(name)}" for name in ("pool", "support", "method", "seed"))
        with _reading(self.path):
            versions = [f"{name} {text}" for name, text in recipe.get("versions", {}).items()]
        lines = {
            "bank": ", ".join([str(self.path), *made]),
            "versions": ", ".join(versions),
            "scenes": f"{len(self)} of {self.num_asked} are there, {number} succeed",
            "verdicts": ", ".join(f"{name} {count}" for name, count in verdicts.most_common()),
            "objects": f"{len(used)}: {', '.join(sorted(used))}",
            "region": f"{2 * half[0]:g} x {2 * half[1]:g} m",
        }
        lines["scenes"] += rest if len(self) < self.num_asked else ""
        return "".join(f"{name:10} {_printable(text)}\n" for name, text in lines.items())

    def _convert(self, table: pa.Table) -> _Rows:
        """Rows as arrays (ValueError: they name an object that the bank does not)."""
        columns = {name: table[name].combine_chunks() for name in _COLUMNS}
        objects, is_placed, poses = (pc.list_flatten(columns[name]) for name in _LISTS)
        num_slots = np.array(pc.list_value_length(columns["objects"]), np.int64)
        is_there = np.array(is_placed, bool)
        places = np.array(pc.list_flatten(poses), np.float32).reshape(-1, 7)
        coded = objects.dictionary_encode()
        known = {name: number for number, name in enumerate(self.names)}
        object_index = np.array(
            [known.get(name, -1) for name in coded.dictionary.to_pylist()], np.int32
        )
        if (object_index < 0).any():
            raise ValueError("it names an object that bank.json does not name")
        object_index = object_index[np.array(coded.indices)]
        index = np.array(columns["index"], np.int64)
        is_success = np.array(columns["is_success"], bool)
        verdict = np.array(columns["verdict"].to_pylist(), object)
        return _Rows(index, is_success, verdict, num_slots, object_index, is_there, places)

    def _scenes(self, rows: _Rows) -> Iterator[Scene]:
        ends = np.cumsum(rows.num_slots)
        for place, end in enumerate(ends.tolist()):
            slots = slice(end - int(rows.num_slots[place]), end)
            is_placed = rows.is_placed[slots]
            objects = rows.object_index[slots]
            yield Scene(
                index=int(rows.number[place]),
                is_success=bool(rows.is_success[place]),
                verdict=rows.verdict[place],
                names=tuple(self.names[each] for each in objects[is_placed]),
                object_index=objects[is_placed],
                poses=rows.poses[slots][is_placed].astype(np.float64),
                unplaced=tuple(self.names[each] for each in objects[~is_placed]),
            )

    def _read_asset(self, name: str, folder: str, file: str, images: str) -> Asset:
        path = self._file(f"{folder}/{file}")
        with _reading(path):
            record = _parse(path.read_bytes())
            if record["format"] not in _FORMATS:
                raise ValueError(
                    f"its format is {record['format']!r}, which this file does not know"
                )
            (_check_support if file == "support.json" else _check_object)(record)
            # A support has its pieces as a list of records, an object as a list of each of their fields.
            pieces = record.get("pieces") or [{"rgba": rgba} for rgba in record.get("rgba", [])]
            digests = [piece.get("texture") for piece in pieces]
            names = record.get("textures") or [
                digest and f"texture-{digest[:12]}.png" for digest in digests
            ]
            if not all(each is None or _IMAGE.fullmatch(each) for each in names):
                raise ValueError(f"it names images {names}")
            meshes = [self._file(f"{folder}/visual-{number}.obj") for number in range(len(pieces))]
            textures = [each and self._file(f"{images}/{each}") for each in names]
            finishes = _finishes_of(record) or [None] * len(pieces)
            for finish in filter(None, finishes):
                _check_finish(finish)
            parts = (
                f"{folder}/part-{number:02d}.obj" for number in range(len(record.get("parts", [])))
            )
            surfaces = tuple(zip(meshes, [piece["rgba"] for piece in pieces], textures))
            shining = tuple(
                finish
                and {
                    key: self._file(f"{images}/texture-{value[:12]}.png") if key in _MAPS else value
                    for key, value in finish.items()
                }
                for _, finish in zip(surfaces, finishes)
            )
            files = tuple(map(self._file, parts))
            return Asset(name, record["label"], record, files, surfaces, shining)

    def _file(self, name: str) -> Path:
        """A file of the bank that is what was written, as far as `bank.json` knows."""
        path = self.path / name
        digest = self.record["files"].get(name)
        with _reading(path):
            if digest not in (None, _digest_of(_regular_file(self.path, name))):
                raise ValueError("it is not what was written")
        return path


class RowDigests:
    """Whether files of rows are what was written; each is hashed once, when it is first read.

    Args:
      known: digests by name, as `bank.json` states them; a file without one passes.
      again: what it states now, should one not fit.
    """

    def __init__(self, known: dict[str, str], again: Callable[[], dict[str, str]]) -> None:
        self._known = known
        self._again = again
        self._sound: set[str] = set()

    def check(self, name: str, path: Path) -> None:
        """ValueError if a file is not what was written."""
        known = self._known
        for _ in range(_REWRITES):
            # Of a file without a digest, which may be large, nothing is known that it could be held against.
            if name in self._sound or name not in known or known[name] == _digest_of(path):
                self._sound.add(name)
                return
            # It may have been written again since the bank was opened.
            known = self._again()
        raise ValueError("it is not what was written")


class Blocks:
    """The rows of a bank's folder, by blocks of 256 scenes: where each lies at one time, and its rows.

    A writer may put blocks into another file after they were listed: listing and reading are one step, which
    is done again. Damaged is what was read, and is not what was written.

    Args:
      path: the folder.
      digests: what its files of rows are held against; None for nothing.

    Attributes:
      places: by block, in order: its file, and its row group there.

    Raises:
      BankError: of the kind `error`; a file's name states more blocks than a file has, or none.
    """

    error: type[Exception] = BankError
    again = _AGAIN

    def __init__(self, path: Path, digests: RowDigests | None = None) -> None:
        self.path = path
        self._digests = digests
        self._latest: tuple[str, Any] = ("", None)
        self.places = self._list()

    def numbers(self, block: int) -> np.ndarray:
        """i64: the numbers of a block's scenes, as its file states them."""
        return self._use(block, lambda name: self._numbers_in(name, block))

    def read(
        self,
        convert: Callable[[pa.Table], Any],
        columns: Sequence[str] | None = None,
        blocks: Iterable[int] | None = None,
    ) -> Iterator[Any]:
        """What `convert` makes of rows, some thousand at a time, every value of theirs looked at.

        Args:
          columns: those that are wanted beside `index`, all if None; blocks: likewise.

        Raises:
          BankError: of the kind `error`; a block is missing or damaged, or `convert` refuses its rows.
        """
        rest = list(self.places if blocks is None else blocks)

        def together(name: str) -> list[int]:
            kept = (self.places.get(each, ("", 0))[0] == name for each in rest)
            run = takewhile(
                lambda each: next(kept) and each // _AT_ONCE == rest[0] // _AT_ONCE, rest
            )
            return list(run)

        def read(name: str) -> Any:
            numbers = together(name)
            groups = [self.places[block][1] for block in numbers]
            # Before anything is allocated: it checks the sizes that the file states.
            indices = np.concatenate([self._numbers_in(name, block) for block in numbers])
            wanted = None if columns is None else list({"index": 0, **dict.fromkeys(columns)})
            rows = self._open(name).read_row_groups(groups, wanted)
            rows.validate(full=True)
            check_rows(rows, indices)
            return numbers, convert(rows)

        while rest:
            numbers, made = self._use(rest[0], read)
            rest = rest[len(numbers) :]
            yield made

    def names(self) -> Iterable[str]:
        """The files of rows that are there now."""
        return files_of_rows(self.path)

    def open_file(self, name: str) -> Any:
        """A file of rows for Arrow (FileNotFoundError, OSError, ValueError: it cannot be read)."""
        path = _regular_file(self.path, name)
        self.check_digest(name, path)
        # pyarrow takes a relative path with a colon in it for a URL.
        return pa.OSFile(str(path.absolute()))

    def check_digest(self, name: str, path: Path) -> None:
        """ValueError if a file of rows, read for the first time, is not what was written."""
        if self._digests is not None:
            self._digests.check(name, path)

    def _list(self) -> dict[int, tuple[str, int]]:
        blocks = {name: file_blocks(name) for name in self.names()}
        for name, held in blocks.items():
            if not 1 <= len(held) <= _MOST_BLOCKS:
                with self._reading(name):
                    raise ValueError(
                        f"its name says {len(held)} blocks; a file has 1 to {_MOST_BLOCKS}"
                    )
        places: dict[int, tuple[str, int]] = {}
        # A file of one block was written after one of many that holds it too.
        for name in sorted(blocks, key=lambda name: (len(blocks[name]) == 1, blocks[name][-1])):
            places.update({block: (name, group) for group, block in enumerate(blocks[name])})
        return dict(sorted(places.items()))

    def _open(self, name: str) -> Any:
        # One at a time: blocks are read in order, and each open file costs memory.
        if self._latest[0] != name:
            self._latest = ("", None)
            try:
                file = self.open_file(name)
            except FileNotFoundError as error:
                raise _GoneError from error
            except OSError as error:
                reason = error.strerror or _line(error)
                given = f"{self.path / name} cannot be read ({reason})"
                raise self.error(given, "", self.again) from error
            rows = pq.ParquetFile(file, page_checksum_verification=True)
            number = rows.metadata.num_row_groups
            held = len(file_blocks(name))
            if number != held:
                raise ValueError(f"its name says {held} blocks, and it holds {number}")
            self._latest = name, rows
        return self._latest[1]

    def _use(self, block: int, use: Callable[[str], Any]) -> Any:
        """What `use` makes of the file of a block."""
        for _ in range(_TRIES):
            if block not in self.places:
                break
            name = self.places[block][0]
            try:
                with self._reading(name):
                    return use(name)
            except _GoneError:
                self.places = self._list()
        raise self.error(f"{self.path / f'scenes-{block:06d}.parquet'} is missing", "", self.again)

    def _reading(self, name: str) -> Any:
        return _reading(self.path / name, self.error, self.again)

    def _numbers_in(self, name: str, block: int) -> np.ndarray:
        """The numbers of a block's scenes, as its file states them (ValueError: more than there can be)."""
        group = self._open(name).metadata.row_group(self.places[block][1])
        # What it states of its columns is not asked: Arrow ends the process where that is damaged.
        if not (0 < group.num_rows <= _BLOCK_SIZE and 0 <= group.total_byte_size <= _MOST_UNPACKED):
            raise ValueError(
                f"block {block} has {group.num_rows} scenes, {group.total_byte_size} bytes"
            )
        return block * _BLOCK_SIZE + np.arange(group.num_rows)


def check_rows(table: pa.Table, indices: np.ndarray) -> None:
    """ValueError if these are not the rows of these scenes, as far as the columns that are there tell."""
    if not np.array_equal(table["index"], indices):
        raise ValueError("its scenes are not those that its name says")
    columns = {
        name: table[name].combine_chunks() for name in _COLUMNS if name in table.schema.names
    }
    flat = {name: pc.list_flatten(columns[name]) for name in _LISTS if name in columns}
    if "poses" in flat:
        # Poses are lists in lists: slots, and seven numbers each.
        flat["numbers"] = pc.list_flatten(flat["poses"])
    values = {**columns, **flat, "poses": flat.get("numbers")}
    for name in columns:
        if not _KINDS[name](values[name].type):
            raise ValueError(f"its column {name!r} is of another type")
    if any(each.null_count for each in (*columns.values(), *flat.values())):
        raise ValueError("it has gaps")
    lists = [columns[name] for name in _LISTS if name in columns]
    num_slots = [np.array(pc.list_value_length(each), np.int64) for each in lists]
    if any((each != num_slots[0]).any() for each in num_slots):
        raise ValueError("its lists of objects are of different lengths")
    if "objects" in flat:
        known = pc.unique(flat["objects"]).to_pylist()
        strange = [name for name in known if not _NAME.fullmatch(name)]
        if strange:
            raise ValueError(f"it names an object {strange[0]!r}")
    if "is_placed" not in flat:
        return
    is_placed = np.array(flat["is_placed"], bool)
    row = np.repeat(np.arange(table.num_rows), num_slots[0])
    is_sure = np.zeros(len(row), bool)
    if "is_success" in columns:
        is_sure = np.array(columns["is_success"], bool)[row]
    if "objects" in flat:
        pairs = np.stack([row, np.array(flat["objects"].dictionary_encode().indices)])[:, is_placed]
        if np.unique(pairs, axis=1).shape != pairs.shape:
            raise ValueError("it has an object twice in one scene")
    if not is_placed[is_sure].all():
        raise ValueError("a scene that succeeded lacks an object")
    if "poses" in flat:
        numbers = np.array(flat["numbers"], np.float32)
        if len(numbers) != 7 * len(is_placed):
            raise ValueError("its lists of objects are of different lengths")
        poses = numbers.reshape(-1, 7)
        if not np.isfinite(poses[is_placed]).all():
            raise ValueError("an object that was placed has a pose that is not finite")
        turns = np.linalg.norm(poses[is_placed, 3:], axis=1)
        if not (np.abs(turns - 1) < 1e-3).all():
            raise ValueError("an object that was placed has a quaternion that is not of length 1")
        if (np.abs(poses[is_sure, :3]) > _FAR).any():
            raise ValueError(f"an object of a scene that succeeded is farther away than {_FAR:g} m")


def _mjcf(
    bank: Bank,
    names: Sequence[str],
    objects: Sequence[Asset],
    poses: np.ndarray,
    support: Asset | None,
    version: tuple[int, ...],
    folder: str,
    alone: bool,
) -> str:
    """MJCF in the words of a version of MuJoCo; `folder` is where the bank's assets are.

    What stands `alone` comes without floor, light and keyframe.
    """
    stability = bank.recipe["stability"]
    contact = bank.recipe["contact"]
    _check_rules(stability, contact)
    both = stability.get("both_detectors", False)
    # Flat surfaces need the word since MuJoCo 3.3, which those before refuse.
    shell = ' inertia="shell"' if version >= (3, 3) else ""
    files: dict[str, str] = {}

    def add_file(kind: str, name: str, file: Path, more: str) -> None:
        path = file.relative_to(bank.path / "assets").as_posix()
        files[f"{kind} {name}"] = f'<{kind} name="{name}"{more} file="{path}"/>'

    def geoms(name: str, asset: Asset, part: str) -> Iterator[str]:
        for number, file in enumerate(asset.parts):
            add_file("mesh", f"{name}.part-{number}", file, "")
            yield f'<geom type="mesh" mesh="{name}.part-{number}" {part}/>'
        finishes = asset.finishes or [None] * len(asset.surfaces)
        for number, ((file, rgba, image), finish) in enumerate(zip(asset.surfaces, finishes)):
            mesh = f"{name}.visual-{number}"
            material = ""
            add_file("mesh", mesh, file, shell)
            if finish is not None:
                own = _finish_name(rgba, image, finish)
                images = {"rgb": image, **{role: finish.get(role) for role in _MAPS}}
                layers = {role: each for role, each in images.items() if each is not None}
                if version < _WITH_LAYERS:
                    layers = {role: each for role, each in layers.items() if role == "rgb"}
                for each in layers.values():
                    add_file("texture", each.stem, each, ' type="2d"')
                files[f"material {own}"] = _material(own, rgba, finish, layers, version)
                material = f' material="{own}"'
            elif image is not None:
                add_file("texture", image.stem, image, ' type="2d"')
                shown = (
                    f'name="{image.stem}" texture="{image.stem}" specular="0.25" shininess="0.35"'
                )
                files[f"material {image.stem}"] = f"<material {shown}/>"
                material = f' material="{image.stem}"'
            unseen = 'contype="0" conaffinity="0" group="2" mass="0"'
            yield f'<geom type="mesh" mesh="{mesh}" {unseen} {_words(rgba=rgba)}{material}/>'

    bodies = [] if alone else [_FLOOR]
    if support is not None:
        group = f'group="{3 if support.surfaces else 2}"'
        bodies.append('<body name="support">')
        for number, box in enumerate(support.record["boxes"]):
            turn = [math.cos(box["yaw"] / 2), 0, 0, math.sin(box["yaw"] / 2)]
            place = _words(pos=box["center"], quat=turn, size=box["half_extents"], rgba=box["rgba"])
            bodies.append(f'<geom name="support.box-{number}" type="box" {place} {group}/>')
        bodies += [*geoms("support", support, f'{group} rgba="0.72 0.55 0.38 1"'), "</body>"]
    for name, asset, pose in zip(names, objects, poses):
        record = asset.record
        (x, y, z) = asset.record["inertia"]
        part = 'group="3"'
        if (friction := record.get("friction")) is not None:
            # It holds against all that has none of its own; of two such objects the more slippery decides.
            own = np.array(contact["friction"]) * (friction / 0.5)
            part += (
                f' {_words(friction=own)} priority="{max(1, round(100_000 * (1 - friction / 10)))}"'
            )
        full = [x[0], y[1], z[2], x[1], x[2], y[2]]
        inertial = _words(pos=record["center_of_mass"], mass=record["mass"], fullinertia=full)
        bodies += [
            f'<body name="{name}" {_words(pos=pose[:3], quat=pose[3:])}><freejoint name="{name}"/>'
        ]
        bodies += [f"<inertial {inertial}/>", *geoms(asset.name, asset, part), "</body>"]
    margin = {"margin": 5e-5} if both and stability.get("robust_tilt") else {}
    return _MJCF.format(
        assets=quoteattr(folder),
        timestep=stability["timestep"] / (2 if both else 1),
        gravity=-contact["gravity"],
        cone=quoteattr(contact["cone"]),
        solver=_words(**{name: contact[name] for name in _SOLVER}),
        # The older detector, which before was the only one.
        flag=' nativeccd="disable"' if both and version >= (3, 2, 3) else "",
        touch=_words(**margin, **{name: contact[name] for name in _TOUCH}),
        files=("" if alone else _SKY) + "\n".join(files.values()),
        bodies="\n".join(bodies),
        key="" if alone else f'<keyframe><key name="scene" {_words(qpos=poses)}/></keyframe>\n',
    )


def _material(
    name: str,
    rgba: Sequence[float],
    finish: dict[str, Any],
    layers: dict[str, Path],
    version: tuple[int, ...],
) -> str:
    """The material of a piece with a finish; `layers` are its images by their role in MJCF."""
    roughness, metallic = finish.get("mean", (finish["roughness"], finish["metallic"]))
    exponent = round(min(2 / max(roughness, 0.01) ** 4 - 2, 1000.0), 4)
    numbers = {
        "specular": round(0.5 * (1 + metallic) * (1 - roughness), 6),
        "shininess": round(min(exponent / 128, 1.0), 6),
    }
    if version >= _WITH_ROUGHNESS:
        numbers.update(roughness=finish["roughness"], metallic=finish["metallic"])
    own = f'name="{name}" {_words(**numbers, rgba=rgba)}'
    if set(layers) == {"rgb"}:
        return f'<material {own} texture="{layers["rgb"].stem}"/>'
    inner = "".join(
        f'<layer role="{role}" texture="{image.stem}"/>' for role, image in layers.items()
    )
    return f"<material {own}>{inner}</material>"


def _finish_name(rgba: Sequence[float], image: Path | None, finish: dict[str, Any]) -> str:
    """As the package calls its material: of a digest of all that it says."""
    numbers = [float(finish.get(key, 0)) for key in ("roughness", "metallic", "transmission")]
    images = [image, *map(finish.get, _MAPS)]
    names = [each and each.name for each in images]
    text = json.dumps([list(map(float, rgba)), numbers, names])
    return f"finish-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def _finishes_of(record: dict[str, Any]) -> list[dict[str, Any] | None]:
    """Of each piece of an object's or a support's record; empty where no piece has one."""
    return record.get("finishes") or [piece.get("finish") for piece in record.get("pieces", [])]


def _words(**numbers: Any) -> str:
    """Attributes of XML (ValueError: a number is not finite)."""
    texts = {
        name: np.asarray(values, np.float64).ravel().tolist() for name, values in numbers.items()
    }
    strange = [name for name, values in texts.items() if not all(map(math.isfinite, values))]
    if strange:
        raise ValueError(f"its {strange[0]} is not finite")
    return " ".join(
        f'{name}="{" ".join(f"{x:.9g}" for x in values)}"' for name, values in texts.items()
    )


def _installed_version() -> str:
    try:
        import mujoco
    except ImportError:
        return _NEWEST
    return str(mujoco.__version__)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())


def files_of_rows(folder: Path) -> list[str]:
    """The names of the files of rows in a folder, sorted; none if there is no folder."""
    names: list[str] | None = None
    # A listing that is made while a writer exchanges files may have neither the old ones nor the new one.
    for _ in range(_TRIES):
        before = names
        found = os.listdir(folder) if folder.is_dir() else []
        names = sorted(filter(_FILE.fullmatch, found))
        if names == before:
            break
    return names or []


def file_blocks(name: str) -> range:
    """The blocks of a file of rows, by its name."""
    match = _FILE.fullmatch(name)
    return range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)


def _regular_file(folder: Path, name: str) -> Path:
    """The path of a file within a folder that can be read (ValueError, OSError: it is none, or too large)."""
    path = folder / name
    real = os.path.realpath(folder / name)
    roots = [os.path.realpath(folder)]
    # The Hugging Face Hub's cache keeps the files of a snapshot beside it, and links to them.
    snapshots = [each for each in folder.absolute().parents if each.name == "snapshots"]
    # Files there are not links themselves, and neither is their folder.
    roots += [os.path.join(os.path.realpath(each.parent), "blobs") for each in snapshots]
    found = path.stat()
    if not any(os.path.commonpath([root, real]) == root for root in roots):
        raise ValueError(
            "it is a link that leads out of the bank; cp -rL makes a copy without links"
        )
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("it is not a regular file")
    most = _MOST_BYTES.get(path.suffix, _MOST_MESH)
    if found.st_size > most:
        raise ValueError(f"it has {found.st_size} bytes, and at most {most} are read")
    return path


def _digest_of(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for data in iter(lambda: file.read(2**20), b""):
            digest.update(data)
    return digest.hexdigest()


def _parse(data: bytes) -> Any:
    """What JSON says, all numbers finite and no key twice (ValueError)."""

    def refuse(text: str) -> float:
        raise ValueError(f"it holds the number {text}")

    def finite(text: str) -> float:
        number = float(text)
        return number if math.isfinite(number) else refuse(text)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError(
                f"it holds the key {Counter(key for key, _ in pairs).most_common(1)[0][0]!r} twice"
            )
        return found

    return json.loads(data, parse_constant=refuse, parse_float=finite, object_pairs_hook=once)


def _check(
    name: str, value: Any, shape: tuple[int, ...], low: float = -_FAR, high: float = _FAR
) -> None:
    """ValueError if a value of JSON is not numbers of a shape (-1: one or more) within a range."""
    numbers = np.array(value)
    is_shaped = len(numbers.shape) == len(shape) and all(
        length == wanted or (wanted == -1 and length)
        for length, wanted in zip(numbers.shape, shape)
    )
    if (
        numbers.dtype.kind not in "iuf"
        or not is_shaped
        or not ((low <= numbers) & (numbers <= high)).all()
    ):
        raise ValueError(f"its {name} is of another type or shape, or out of range")


def _check_object(record: dict[str, Any]) -> None:
    """ValueError (TypeError, LookupError) if the numbers of an object are none of a body."""
    _check("mass", record["mass"], (), _TINY, _HEAVY)
    _check("center_of_mass", record["center_of_mass"], (3,))
    _check("inertia", record["inertia"], (3, 3), -_HEAVY, _HEAVY)
    _check("inertia", np.diag(np.array(record["inertia"])), (3,), 0, _HEAVY)
    for part in record["parts"]:
        _check("parts", part, (-1, 3))
    for rgba in record["rgba"]:
        _check("rgba", rgba, (4,))
    if record.get("friction") is not None:
        _check("friction", record["friction"], (), _TINY, _HEAVY)
    for pose in record.get("resting", []):
        _check("resting poses", pose["quaternion"], (4,), -1.001, 1.001)
        _check("resting poses", np.linalg.norm(pose["quaternion"]), (), 0.999, 1.001)
        _check("resting poses", [pose["height"], pose["likelihood"]], (2,))


def _check_finish(finish: dict[str, Any]) -> None:
    """ValueError (TypeError, LookupError) if a finish is none."""
    for name in ("roughness", "metallic", "transmission"):
        _check(name, finish.get(name, 0.0) if name == "transmission" else finish[name], (), 0, 1)
    _check("mean finish", finish.get("mean", (0, 0)), (2,), 0, 1)
    for name in _MAPS:
        if name in finish and not _DIGEST.fullmatch(finish[name]):
            raise ValueError(f"it names a map {finish[name]!r}")


def _check_support(record: dict[str, Any]) -> None:
    """The same of a support."""
    _check("top", record["top"], ())
    _check_region(record["region"])
    for box in record["boxes"]:
        _check("boxes", [*box["center"], box["yaw"]], (4,))
        _check("boxes", box["half_extents"], (3,), _TINY)
        _check("boxes", box["rgba"], (4,))
    for part in record.get("parts", []):
        _check("parts", part, (-1, 3))
    for piece in record.get("pieces", []):
        _check("pieces", piece["rgba"], (4,))


def _check_region(region: dict[str, Any]) -> None:
    _check("region", region["center"], (2,))
    _check("region", region["half_extents"], (2,), _TINY)
    _check("region", region["yaw"], ())


def _check_rules(stability: dict[str, Any], contact: dict[str, Any]) -> None:
    """ValueError if the rules of a recipe are none that a simulation can have."""
    _check("timestep", stability["timestep"], (), _TINY, 1)
    _check("gravity", contact["gravity"], (), 0)
    _check("friction", contact["friction"], (3,), 0, _HEAVY)
    _check("solref", contact["solref"], (2,), -_HEAVY, _HEAVY)
    _check("solimp", contact["solimp"], (5,), 0, _HEAVY)
    for name in ("condim", *_SOLVER):
        _check(name, contact[name], (), 0, _HEAVY)
    if contact["cone"] not in ("elliptic", "pyramidal"):
        raise ValueError(f"its cone is {contact['cone']!r}")


_REWRITES = 5
"""Times that a file which is being written again is looked at."""
_CAUSES = (
    pa.ArrowException,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    TypeError,
    ValueError,
)


@contextmanager
def _reading(path: Path, kind: type[Exception] = BankError, again: str = _AGAIN) -> Iterator[None]:
    """Inside, whatever a damaged file causes becomes an error, a BankError by default, that names it."""
    try:
        yield
    except _CAUSES as error:
        reason = f"no {error}" if isinstance(error, KeyError) else _line(error)
        raise kind(f"{path} is damaged ({reason})", "", again) from error


def _read_record(path: Path) -> dict[str, Any]:
    """What the `bank.json` of a folder holds (BankError)."""
    index = path / "bank.json"
    if not index.exists():
        raise BankError(
            f"{path} is not a bank: it has no bank.json", "a folder of `cluttergen generate`"
        )
    with _reading(index):
        try:
            record = parse_record(_regular_file(path, "bank.json").read_bytes())
        except NewerFormatError as error:
            given = f"{path} was made by a newer version ({error}; this file reads {FORMAT})"
            hint = "the bank_reader.py of a newer cluttergen_jax"
            raise BankError(given, "", hint) from error
    record.setdefault("assets", {"objects": {}})
    record.setdefault("files", {})
    return record


class NewerFormatError(ValueError):
    """The record of a bank that a newer version made."""


def parse_record(data: bytes) -> dict[str, Any]:
    """The record that `bank.json` holds, without its digest (NewerFormatError, ValueError, TypeError,
    LookupError, RecursionError: it is none)."""
    record = _parse(data)
    number = record["format"]
    if isinstance(number, int) and number > FORMAT:
        raise NewerFormatError(f"format {number}")
    if number != FORMAT:
        raise ValueError(f"it is not the record of a bank of format {FORMAT}")
    if record.pop("hash", None) not in (None, digest_of_record(record)):
        raise ValueError("it does not match its own digest")
    check_record(record)
    return record


def digest_of_record(record: Any) -> str:
    """The digest of all else in a record, which stands in it as `hash`."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def check_record(record: dict[str, Any]) -> None:
    """ValueError if what a record says is not what a bank's says."""
    number = record.get("num_scenes")
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise ValueError(f"num_scenes is {number!r}")
    if not isinstance(record.get("recipe"), dict):
        raise ValueError("it has no recipe")
    assets = record.get("assets", {"objects": {}})
    if not isinstance(assets, dict) or not isinstance(assets.get("objects"), dict):
        raise ValueError("its digests of assets are not understood")
    files = record.get("files", {})
    if not isinstance(files, dict) or not all(isinstance(each, str) for each in files.values()):
        raise ValueError("its digests of files are not understood")


def main(words: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="What a bank of scenes holds, or one of its scenes as MJCF."
    )
    parser.add_argument(
        "folder", nargs="?", default=Path(__file__).parent, help="default: this file's own"
    )
    parser.add_argument(
        "--xml", type=int, metavar="INDEX", help="print this scene, for the MuJoCo here"
    )
    given = parser.parse_args(words)
    if hasattr(sys.stdout, "reconfigure"):
        # A terminal that cannot show a letter gets its code.
        sys.stdout.reconfigure(
            errors="backslashreplace" if given.xml is None else "xmlcharrefreplace"
        )
    try:
        bank = Bank(given.folder)
        print(bank.summary() if given.xml is None else bank.xml(given.xml), end="", flush=True)
    except BankError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # Whoever read it has seen enough, `head` for instance.
        os._exit(1)
    except OSError as error:
        said = f"error: the output (stdout) cannot be written: {error.strerror or error}"
        print(said, file=sys.stderr, flush=True)
        os._exit(2)
    return 0


if __name__ == "__main__":
    sys.exit(main())
