"""One object on disk: a folder of plain files, no pickle.

    object.json    everything but the surfaces and the cloud; collision parts inline, rounded to 0.1 um
    visual-N.obj   one piece: vertices and triangles, and texture coordinates where it has an image
    texture-DIGEST.png  the images; in a bank they lie together in a folder of their own
    cloud.npy      f32[1024, 3]
    object.xml     the object alone as MJCF, which opens in plain MuJoCo; written for others, never read
    ATTRIBUTION.txt  where the object's licence asks for one

`object.json` holds the digest of each surface, image and cloud file and of itself, so damage is noticed and
named.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any
from weakref import WeakKeyDictionary

import msgspec
import numpy as np

from cluttergen_jax.assets.finish import StoredFinish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import object_xml
from cluttergen_jax.assets.obj import parse_surface, surface_text
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, Quality, RestingPose
from cluttergen_jax.assets.shape import Piece, Provenance, Texture, texture_name
from cluttergen_jax.errors import AssetError, PoolError
from cluttergen_jax.files import inside, read_inside, read_regular, write_atomically
from cluttergen_jax.schema import (
    Numbers,
    SchemaError,
    check_numbers,
    convert,
    digest_of,
    parse_json,
    refuse_control_characters,
)

FORMAT = 1
NAME_PATTERN = re.compile(r"[a-z0-9_-]+")
RESERVED = "support"
"""What the support's body is called in every scene, so that no object can be."""
_FILE = re.compile(r"[a-z0-9_-]+\.[a-z]+")
SHARED_IMAGES = "../../textures/"
"""Where the images of an object lie in a bank or an export, relative to the object's folder."""
_DIGITS = 5
"""Significant ones of a surface's coordinates."""
_CLOUD = "cloud.npy"
_RECORD = "object.json"
_HASHES: WeakKeyDictionary[ObjectAsset, str] = WeakKeyDictionary()
"""Of objects whose hash was asked for."""


def object_files(asset: ObjectAsset, images: str = "") -> dict[str, bytes]:
    """The files of an object's folder by name. Equal assets give equal bytes, before and after disk.

    Args:
      images: where the images will lie, relative to the folder; the folder itself if empty.

    Raises:
      AssetError: the name is not `[a-z0-9_-]+`.
    """
    if not NAME_PATTERN.fullmatch(asset.name):
        raise AssetError(f"an object called {asset.name!r}", "names of a-z, 0-9, '_' and '-'")
    files = _surfaces(asset)
    record = _record(asset, files)
    record["hash"] = digest_of(_canonical(record))
    files[_RECORD] = (json.dumps(record, separators=(",", ":")) + "\n").encode()
    if asset.provenance.attribution:
        files["ATTRIBUTION.txt"] = (asset.provenance.attribution + "\n").encode()
    files["object.xml"] = object_xml(
        asset, tuple(f"visual-{i}.obj" for i in range(len(asset.pieces))), files, images
    )
    return files


def object_hash(asset: ObjectAsset) -> str:
    """Hex digest of everything that `write_object` would store."""
    if asset not in _HASHES:
        _HASHES[asset] = digest_of(_canonical(_record(asset, _surfaces(asset))))
    return _HASHES[asset]


def _surfaces(asset: ObjectAsset) -> dict[str, bytes]:
    """The files whose digests are in the record."""
    files = {
        f"visual-{i}.obj": _surface_text(piece).encode() for i, piece in enumerate(asset.pieces)
    }
    files[_CLOUD] = _npy_bytes(asset.cloud)
    return files | {each.file_name: each.data for each in asset.textures}


def _surface_text(piece: Piece) -> str:
    return surface_text(piece, _DIGITS)


def stored_mesh(piece: Piece) -> Mesh:
    """A piece's mesh with its vertices rounded as they are on disk."""
    return parse_surface(_surface_text(piece))[0]


def write_object(folder: Path, asset: ObjectAsset, images: Path | None = None) -> None:
    """Writes the object's files into `folder`, which is made if need be.

    Args:
      images: the folder that objects keep their images in together, two floors up from where `folder` will be
        and called `textures`; None keeps them in `folder`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in object_files(asset, "" if images is None else SHARED_IMAGES).items():
        if images is None or not name.endswith(".png"):
            (folder / name).write_bytes(data)
    if images is not None:
        write_images(images, asset.textures)


def write_images(folder: Path, textures: Iterable[Texture]) -> None:
    """Writes images into a folder that objects share; one that is there already stays."""
    for each in textures:
        path = folder / each.file_name
        if not (path.is_file() and path.read_bytes() == each.data):
            write_atomically(path, each.data)


def read_object(folder: Path, images: Path | None = None) -> ObjectAsset:
    """Reads what `write_object` wrote.

    Args:
      images: the folder of its images, if that is another.

    Raises:
      PoolError: a file is missing, damaged or of another format, or the object's name is none; the message
        names it.
      UnsafePathError: a file is a link that leads out of the folder.
    """
    record = _read_record(inside(folder, _RECORD))
    if not (isinstance(record.get("name"), str) and NAME_PATTERN.fullmatch(record["name"])):
        raise PoolError(
            f"{folder / _RECORD}: an object called {record.get('name')!r}",
            "names of a-z, 0-9, '_' and '-'",
        )
    try:
        stored = convert(record, _Stored)
    except SchemaError as error:
        raise PoolError(
            f"{folder / _RECORD} cannot be understood: {error!r}", hint=_REWRITE
        ) from error
    blobs: dict[str, bytes] = {}
    for name, digest in stored.files.items():
        where = images if images is not None and name.endswith(".png") else folder
        try:
            blobs[name] = read_inside(where, name)
        except OSError as error:
            raise _unreadable(where / name, error) from error
        if digest_of(blobs[name]) != digest:
            raise PoolError(f"{where / name} does not match its digest in {_RECORD}", hint=_REWRITE)
    try:
        return _asset(stored, blobs)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise PoolError(
            f"{folder / _RECORD} cannot be understood: {error!r}", hint=_REWRITE
        ) from error


_REWRITE = "importing or building the pool again"


def _canonical(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record, sort_keys=True, separators=(",", ":")).encode()


def _round(values: np.ndarray, digits: int) -> Any:
    # Adding zero turns a rounded -0.0 into 0.0, so that equal bodies are equal bytes.
    return (np.round(np.asarray(values, np.float64), digits) + 0.0).tolist()


_Positive = Annotated[float, msgspec.Meta(gt=0, le=1e9)]
_Length = Annotated[float, msgspec.Meta(ge=-1000, le=1000)]
"""Metres."""
_Point = tuple[_Length, _Length, _Length]


class _Stored(msgspec.Struct, kw_only=True, omit_defaults=True):
    """What `object.json` holds, in this order.

    What has a default is absent where it is that: objects keep the digest that they had before there was such
    a thing.
    """

    friction: _Positive | None = None
    scale: _Positive = 1.0
    notes: tuple[str, ...] = ()
    synset: str = ""
    textures: list[str | None] | None = None
    finishes: list[StoredFinish | None] | None = None
    format: int
    name: str
    label: str
    tier: str
    mass: _Positive
    center_of_mass: _Point
    inertia: list[tuple[float, float, float]]
    parts: list[list[_Point]]
    rgba: list[tuple[float, float, float, float]]
    resting: list[RestingPose]
    provenance: Provenance
    quality: Quality
    flags: tuple[str, ...]
    files: dict[Annotated[str, msgspec.Meta(pattern=f"^{_FILE.pattern}$")], str]


def _floats(values: Iterable[Any]) -> Any:
    return tuple(map(float, values))


def _record(asset: ObjectAsset, contents: dict[str, bytes]) -> dict[str, Any]:
    images = [None if piece.texture is None else piece.texture.file_name for piece in asset.pieces]
    finishes = [
        None if piece.finish is None else piece.finish.to_record() for piece in asset.pieces
    ]
    stored = _Stored(
        friction=None if asset.friction is None else float(asset.friction),
        scale=float(asset.scale),
        notes=asset.notes,
        synset=asset.synset,
        textures=images if any(images) else None,
        finishes=finishes if any(finishes) else None,
        format=FORMAT,
        name=asset.name,
        label=asset.label,
        tier=asset.tier,
        mass=float(asset.mass),
        center_of_mass=_round(asset.center_of_mass, 7),
        inertia=[_floats(f"{value:.6e}" for value in row) for row in asset.inertia],
        parts=[_round(part.vertices, 7) for part in asset.parts],
        rgba=[_floats(piece.rgba) for piece in asset.pieces],
        resting=list(asset.resting),
        provenance=asset.provenance,
        quality=asset.quality,
        flags=asset.flags,
        files={name: digest_of(data) for name, data in contents.items()},
    )
    plain = msgspec.to_builtins(stored, enc_hook=np.generic.item)
    record = {**plain, "provenance": asset.provenance.record()}
    if asset.scale == 1:
        # msgspec leaves out a default of this class itself, not any number equal to it.
        record.pop("scale", None)
    return record


def _asset(stored: _Stored, blobs: dict[str, bytes]) -> ObjectAsset:
    turns = [math.hypot(*pose.quaternion) for pose in stored.resting]
    if any(abs(turn - 1) > 1e-3 for turn in turns):
        raise ValueError("a resting pose has a quaternion that is not of length 1")
    if len(stored.inertia) != 3 or min(row[axis] for axis, row in enumerate(stored.inertia)) < 0:
        raise ValueError("an inertia with a negative moment, or not of 3 x 3 numbers")
    files = stored.textures or [None] * len(stored.rgba)
    finishes = stored.finishes or [None] * len(stored.rgba)
    textures = {name: Texture(data) for name, data in blobs.items() if name.endswith(".png")}
    pieces = []
    for i, (rgba, name, said) in enumerate(zip(stored.rgba, files, finishes, strict=True)):
        mesh, uv = parse_surface(blobs[f"visual-{i}.obj"].decode("ascii"))
        texture = None if name is None else textures[name]
        finish = None
        if said is not None:
            finish = said.finish(lambda digest: textures[texture_name(digest)])
        pieces.append(Piece(mesh, rgba, uv, texture, finish=finish))
    cloud = np.load(io.BytesIO(blobs[_CLOUD]), allow_pickle=False)
    check_numbers({"cloud": cloud}, {"cloud": Numbers("f4", (CLOUD_SIZE, 3))})
    return ObjectAsset(
        name=stored.name,
        label=stored.label,
        pieces=tuple(pieces),
        parts=Mesh.convex_parts(stored.parts),
        mass=stored.mass,
        center_of_mass=np.array(stored.center_of_mass, np.float64),
        inertia=np.array(stored.inertia, np.float64).reshape(3, 3),
        cloud=cloud,
        resting=tuple(stored.resting),
        provenance=stored.provenance,
        tier=stored.tier,
        quality=stored.quality,
        flags=stored.flags,
        notes=stored.notes,
        friction=stored.friction,
        scale=stored.scale,
        synset=stored.synset,
    )


def read_bytes(path: Path, hint: str = _REWRITE) -> bytes:
    """What a file holds; PoolError if it cannot be read."""
    try:
        return read_regular(path)
    except OSError as error:
        raise _unreadable(path, error, hint) from error


def _unreadable(path: Path, error: OSError, hint: str = _REWRITE) -> PoolError:
    return PoolError(f"{path} cannot be read ({error.strerror})", hint=hint)


def _read_record(path: Path) -> dict[str, Any]:
    try:
        record = parse_json(read_bytes(path))
        refuse_control_characters(record)
    except SchemaError as error:
        raise PoolError(f"{path} is {error}", hint=_REWRITE) from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise PoolError(f"{path} is not an object of format {FORMAT}", hint=_REWRITE)
    digest = record.pop("hash", None)
    if digest != digest_of(_canonical(record)):
        raise PoolError(f"{path} does not match its own digest", hint=_REWRITE)
    return record


def _npy_bytes(cloud: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(cloud, np.float32), allow_pickle=False)
    return buffer.getvalue()
