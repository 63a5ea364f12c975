"""One support on disk: `support.json`, and one OBJ per coloured piece and per convex part.

`find_support` looks among the embedded supports first, then among the user's own, then takes its argument for
a folder.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import msgspec

from cluttergen_jax.assets.finish import StoredFinish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.obj import mesh_text, parse_surface, part_name, surface_text
from cluttergen_jax.assets.object_files import NAME_PATTERN, read_bytes
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.pool import embedded_root, folders_with, user_root
from cluttergen_jax.assets.shape import Joint, Piece, Provenance, Texture, texture_name
from cluttergen_jax.assets.support import (
    Box,
    Rectangle,
    SupportAsset,
    Surface,
    cuboid_table,
    parse_surfaces,
)
from cluttergen_jax.errors import ConfigError, PoolError, closest
from cluttergen_jax.files import folder_whole, inside, read_regular
from cluttergen_jax.schema import (
    SchemaError,
    checked_record,
    convert,
    digest_of,
    parse_json,
    record_bytes,
    refuse,
)

FORMAT = 1
WITH_SURFACES = 2
"""Of supports that have convex parts or several surfaces, which readers of format 1 would lose."""
WITH_JOINTS = 3
WITH_DOORS = 4
"""Of supports whose doors stand open and are to be closed, which readers of format 3 would leave open."""
_RECORD = "support.json"
_DIGITS = 7
_SIZED = re.compile(r"(table|bin|tote|tray)-(\d*\.?\d+(?:x\d*\.?\d+){1,2})")
_REWRITE = "writing the support again"


def write_support(folder: str | Path, support: SupportAsset, *, overwrite: bool = False) -> Path:
    """Writes a support's folder as a whole: it is built beside its place and then renamed into it.

    Raises:
      PoolError: a bad name, or something is there already that is not a support or may not be replaced.
    """
    folder = Path(folder)
    if not NAME_PATTERN.fullmatch(support.name):
        raise PoolError(f"a support called {support.name!r}", "names of a-z, 0-9, '_' and '-'")
    if folder.exists() and not (overwrite and (folder / _RECORD).is_file()):
        raise PoolError(f"{folder} exists", "a support's folder" if overwrite else "a new folder")
    with folder_whole(folder) as fresh:
        fresh.mkdir()
        files = {}
        for index, piece in enumerate(support.pieces):
            files[f"visual-{index}.obj"] = surface_text(piece, _DIGITS).encode("ascii")
            files |= {image.file_name: image.data for image in piece.images}
        for index, part in enumerate(support.parts):
            files[part_name(index)] = mesh_text(part.hull()).encode("ascii")
        for name, data in files.items():
            (fresh / name).write_bytes(data)
        record = _record(support) | {
            "files": {name: digest_of(data) for name, data in files.items()}
        }
        (fresh / _RECORD).write_bytes(record_bytes(record))
    return folder


def read_support(folder: str | Path) -> SupportAsset:
    """Reads what `write_support` wrote.

    Raises:
      PoolError: a file is missing, damaged or of another format, or the support's name is none; the message
        names it.
      UnsafePathError: it names a file outside of its folder.
    """
    path = inside(folder, _RECORD)
    data = read_bytes(path, _REWRITE)
    try:
        record = parse_json(data)
    except SchemaError as error:
        raise PoolError(f"{path} is {error}", hint=_REWRITE) from error
    if not isinstance(record, dict) or record.get("format") not in (
        FORMAT,
        WITH_SURFACES,
        WITH_JOINTS,
        WITH_DOORS,
    ):
        raise PoolError(
            f"{path} is not a support of format {FORMAT} to {WITH_DOORS}", hint=_REWRITE
        )
    if not (isinstance(record.get("name"), str) and NAME_PATTERN.fullmatch(record["name"])):
        raise PoolError(
            f"{path}: a support called {record.get('name')!r}", "names of a-z, 0-9, '_' and '-'"
        )
    try:
        # A path that leads out of the folder is reported first, before any checksum.
        support = _support(convert(record, _Stored), Path(folder))
        checked_record(data)
        for name, digest in convert(record.get("files", {}), dict[str, str]).items():
            if digest_of(read_regular(inside(folder, name))) != digest:
                raise SchemaError(f"{name} is not what it was")
        return support
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise PoolError(f"{path} cannot be understood: {error!r}", hint=_REWRITE) from error
    except OSError as error:
        raise PoolError(
            f"{error.filename} cannot be read ({error.strerror})", hint=_REWRITE
        ) from error


def support_hash(support: SupportAsset) -> str:
    """Hex digest of everything that `write_support` would store: the same before and after disk."""
    texts = [
        json.dumps(_record(support), sort_keys=True),
        *(surface_text(p, _DIGITS) for p in support.pieces),
    ]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def is_support_name(text: str) -> bool:
    """Whether a support may be called so: in the letters of names, and not as those of any size are."""
    return bool(NAME_PATTERN.fullmatch(text)) and not _SIZED.fullmatch(text)


def user_supports() -> Path:
    """The folder of the user's own supports, beside that of the user's pools."""
    return user_root().parent / "supports"


def embedded_supports() -> dict[str, Path]:
    """Every support that comes with the package, with its folder."""
    return folders_with(_RECORD, embedded_root() / "supports")


def list_supports() -> dict[str, Path]:
    """Every support that can be named, with its folder: embedded ones first, then the user's."""
    embedded = embedded_supports()
    own = folders_with(_RECORD, user_supports())
    return embedded | {name: folder for name, folder in own.items() if name not in embedded}


def find_support(name_or_path: str | Path) -> SupportAsset:
    """The support of that name, or the one in that folder; `table-WxD[xH]` is a cuboid, and `bin-WxD[xH]`,
    `tote-WxD[xH]` and `tray-WxD[xH]` are containers of that size inside (metres).

    Raises:
      PoolError: nothing is called so (the message lists what exists), or its files are damaged.
      ConfigError: an absurd size.
    """
    if sized := _SIZED.fullmatch(str(name_or_path)):
        size = tuple(float(side) for side in sized[2].split("x"))
        if sized[1] == "table":
            return cuboid_table(*size)
        # The modeller's library takes half a second to import, and only who asks for such a size pays.
        from cluttergen_jax.assets.modeller.bins import open_container

        return open_container(sized[1], size)
    supports = list_supports()
    if str(name_or_path) in supports:
        return read_support(supports[str(name_or_path)])
    if (Path(name_or_path) / _RECORD).is_file():
        return read_support(name_or_path)
    raise PoolError(
        f"no support is called {str(name_or_path)!r}, and there is none at that path",
        ", ".join(supports) or "none is installed",
        "table-0.40x0.50 or bin-0.50x0.30x0.20, of any size, or cluttergen import --support FILE, which "
        "makes one of a mesh",
        closest(name_or_path, supports),
    )


def is_support(name_or_path: str | Path) -> bool:
    """Whether `find_support` would look at something called so, damaged or not."""
    name = str(name_or_path)
    return (
        bool(_SIZED.fullmatch(name)) or name in list_supports() or (Path(name) / _RECORD).is_file()
    )


def _round(value: Any) -> Any:
    """Numbers to a tenth of a micrometre, through lists, tuples and dicts; -0.0 becomes 0.0."""
    if isinstance(value, float):
        return round(value, 7) + 0.0
    if isinstance(value, list | tuple):
        return [_round(each) for each in value]
    if isinstance(value, dict):
        return {key: _round(each) for key, each in value.items()}
    return value


def _record(support: SupportAsset) -> dict[str, Any]:
    more: dict[str, Any] = {}
    if support.parts or support.named:
        more = {
            "parts": [_round(part.vertices.tolist()) for part in support.parts],
            "surfaces": [_surface_record(surface) for surface in support.named],
            "surface": support.surface,
        }
    if support.joints:
        more["joints"] = [_round(_joint_record(joint)) for joint in support.joints]
    form = WITH_JOINTS if support.joints else WITH_SURFACES if more else FORMAT
    known = [joint for joint in support.joints if joint.closed is not None]
    if any(_round(joint.closed) != _round(joint.value) for joint in known):
        form = WITH_DOORS
    return {
        "format": form,
        "name": support.name,
        "label": support.label,
        "top": _round(support.top),
        "region": _round(asdict(support.region)),
        "boxes": [_round(asdict(box)) for box in support.boxes],
        "pieces": [
            {
                "file": f"visual-{index}.obj",
                "rgba": _round(piece.rgba),
                # A digest, so that the record tells one image from another.
                **({} if piece.texture is None else {"texture": piece.texture.digest}),
                **(
                    {}
                    if piece.finish is None
                    else {"finish": _round(msgspec.to_builtins(piece.finish.to_record()))}
                ),
            }
            for index, piece in enumerate(support.pieces)
        ],
        "provenance": support.provenance.record(),
        **more,
    }


def _joint_record(joint: Joint) -> dict[str, Any]:
    """Its fields; those on masses and dynamics only where they are known."""
    return {
        name: value for name, value in asdict(joint).items() if value is not None or name == "range"
    }


def _surface_record(surface: Surface) -> dict[str, Any]:
    record = _round(asdict(surface))
    # JSON has no infinity.
    return {name: value for name, value in record.items() if value != math.inf}


_Rgba = tuple[float, float, float, float]
_Point = tuple[float, float, float]
_STEEPEST = math.radians(11)
"""Of surfaces; they are found up to 10 degrees."""
_HAIR = 1e-5
_FAR = 1000.0
"""Metres beyond which nothing of a support is."""


class _StoredPiece(msgspec.Struct):
    """What `support.json` says of a coloured piece."""

    file: str
    rgba: _Rgba
    texture: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")] | None = None
    finish: StoredFinish | None = None


class _Stored(msgspec.Struct):
    """What `support.json` holds."""

    name: str
    label: str
    boxes: list[Box]
    top: Annotated[float, msgspec.Meta(ge=-_FAR, le=_FAR)]
    region: Rectangle
    pieces: list[_StoredPiece]
    provenance: Provenance
    parts: list[list[_Point]] = []
    surfaces: list[Surface] = []
    surface: str = ""
    joints: list[Joint] = []


def _support(record: _Stored, folder: Path) -> SupportAsset:
    flat = [number for number, box in enumerate(record.boxes) if min(box.half_extents) <= 0]
    faults = [f"box {number} has a side of 0 or less" for number in flat]
    numbers = [each for box in record.boxes for each in (*box.center, *box.half_extents)]
    numbers += [each for part in record.parts for point in part for each in point]
    for surface in record.surfaces:
        numbers += [*surface.position, *surface.region.center, *surface.region.half_extents]
        numbers += [
            each for ring in (surface.outline, *surface.holes) for point in ring for each in point
        ]
    if max(map(abs, (*numbers, *record.region.center, *record.region.half_extents))) > _FAR:
        faults.append(f"something is farther away than {_FAR:g} m")
    parts = Mesh.convex_parts(record.parts)
    faults += [
        f"part {number} has no volume" for number, part in enumerate(parts) if _is_flat(part)
    ]
    if not record.boxes and not parts:
        faults.append("it has neither boxes nor parts")
    faults += _faults_of_surfaces(record.surfaces, record.surface)
    faults += _faults_of_joints(record)
    refuse(faults)
    return SupportAsset(
        name=record.name,
        label=record.label,
        boxes=tuple(record.boxes),
        top=float(record.top),
        region=record.region,
        provenance=record.provenance,
        pieces=tuple(_piece(piece, folder) for piece in record.pieces),
        parts=parts,
        named=tuple(record.surfaces),
        surface=record.surface,
        joints=tuple(record.joints),
    )


def _faults_of_joints(record: _Stored) -> list[str]:
    faults = []
    for joint in record.joints:
        numbers = (*joint.anchor, joint.value, *(joint.range or ()))
        is_sound = max(map(abs, numbers)) <= _FAR and abs(math.hypot(*joint.axis) - 1) < 1e-5
        groups = (
            (joint.pieces, record.pieces),
            (joint.boxes, record.boxes),
            (joint.parts, record.parts),
        )
        is_sound &= all(0 <= each < len(known) for own, known in groups for each in own)
        is_sound &= -1 <= joint.parent < len(record.joints)
        above = joint.parent
        steps = 0
        while is_sound and 0 <= above < len(record.joints) and steps <= len(record.joints):
            above = record.joints[above].parent
            steps = steps + 1
        is_sound &= steps <= len(record.joints)
        amounts = [
            each for each in (joint.damping, joint.friction, joint.armature) if each is not None
        ]
        is_sound &= min(amounts, default=0.0) >= 0 and (joint.mass is None or joint.mass > 0)
        low, high = joint.range or (-math.inf, math.inf)
        places = [each for each in (joint.value, joint.closed) if each is not None]
        if not (is_sound and all(low - _HAIR <= each <= high + _HAIR for each in places)):
            faults.append(f"joint {joint.name!r} is not sound")
    return faults


def _is_flat(part: Mesh) -> bool:
    return len(part.vertices) < 4 or hull_of(part.vertices) is None


def _faults_of_surfaces(surfaces: list[Surface], chosen: str) -> list[str]:
    names = [surface.name for surface in surfaces]
    faults = [f"surface {name!r} comes twice" for name in names if names.count(name) > 1]
    try:
        if chosen:
            parse_surfaces(chosen, surfaces)
    except ConfigError:
        faults.append(f"its surface {chosen!r} is none of {names}")
    for surface in surfaces:
        if not NAME_PATTERN.fullmatch(surface.name):
            faults.append(f"a surface is called {surface.name!r}")
        if abs(math.hypot(*surface.quaternion) - 1) > 1e-5 or surface.tilt > _STEEPEST:
            faults.append(
                f"surface {surface.name!r} is not within {math.degrees(_STEEPEST):.0f} degrees of level"
            )
        if surface.is_level and surface.position[:2] != (0.0, 0.0):
            faults.append(f"level surface {surface.name!r} has a frame of its own")
        if min(map(len, (surface.outline, *surface.holes))) < 3 or not surface.free_height > 0:
            faults.append(
                f"surface {surface.name!r} has an outline of too few corners, or no room above it"
            )
    return faults


def _piece(record: _StoredPiece, folder: Path) -> Piece:
    mesh, uv = parse_surface(read_regular(inside(folder, record.file)).decode("ascii"))

    def image_of(digest: str) -> Texture:
        name = texture_name(digest)
        image = Texture(read_regular(inside(folder, name)))
        if image.digest != digest:
            raise SchemaError(f"{name} is not the image that it was")
        return image

    texture = image_of(record.texture) if record.texture else None
    finish = None if record.finish is None else record.finish.finish(image_of)
    return Piece(mesh, record.rgba, uv, texture, finish=finish)
