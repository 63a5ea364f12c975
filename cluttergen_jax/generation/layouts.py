"""Layouts in files, as people and language models write them: what shall stand where, and where things stand.

In YAML a layout is a request (`read_layout`); in JSON it has poses (`read_layout_json`), and every key is
read or refused by its name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.pool import embedded_root
from cluttergen_jax.errors import ConfigError, closest, printable
from cluttergen_jax.files import is_regular_file
from cluttergen_jax.generation.layout_check import (
    LayoutError,
    LayoutFields,
    meaning_faults,
    parse_content,
    place_of,
    read_fields,
    spec_of_layout,
)
from cluttergen_jax.geometry import product, rotation_matrix, turn_between
from cluttergen_jax.schema import Record, SchemaError, read_json, read_written
from cluttergen_jax.spec import SceneSpec

_HINT = "a file such as those of `cluttergen list`"


def list_layouts() -> dict[str, Path]:
    """The layouts that come with the package: names and files."""
    return {path.stem: path for path in sorted((embedded_root() / "layouts").glob("*.yaml"))}


def read_layout(layout: str | Path, pool: str | Path | None = None) -> SceneSpec:
    """The request that a layout is: a file, or the name of one that comes with the package.

        cluttergen_jax.generate("out", cluttergen_jax.layout.read("breakfast_for_two"))

    A file has `objects`, names of your own and which objects of the pool each may stand for; `relations`
    between them and other objects of the pool; and, if wanted, `title`, `pool`, `support`, `region`, `poses`,
    `arrangements`, `clutter`, `crowd`, `natural`, `others`, the number of further objects of the pool, and
    `theme`, the occasion to which those belong.
    Where the pool has too few objects for the names, they come more than once. `layout_schema` describes
    each field.

    Args:
      pool: in place of the one that it names.

    Raises:
      ConfigError: there is no such layout, it is no YAML, or something in it is not understood; a
        `LayoutError` has all that is wrong.
    """
    return spec_of_layout(read_fields_of(layout, pool))


def asked_of(layout: str | Path) -> Record | None:
    """The sentence, the model and the number of its answers, of a layout that a model has written."""
    asked = read_fields_of(layout).asked
    if asked is None:
        return None
    # A record holds no characters that a terminal obeys.
    words = {
        name: printable(" ".join(getattr(asked, name).split())) for name in ("request", "model")
    }
    return {**words, "tries": asked.tries}


def read_fields_of(layout: str | Path, pool: str | Path | None = None) -> LayoutFields:
    """The fields of a layout; see `read_layout`."""
    path = layout_path(layout)
    try:
        content = parse_content(read_written(path))
    except (SchemaError, OSError) as error:
        raise ConfigError(f"layout {path}: {error}", "YAML", _HINT) from error
    found, faults = read_fields(content)
    if pool is not None:
        found.pool = str(pool)
    faults += meaning_faults(found)
    if faults:
        raise LayoutError(str(layout), sorted(faults, key=place_of))
    return found


def layout_path(layout: str | Path) -> Path:
    """The file of a layout (ConfigError: there is none)."""
    known = list_layouts()
    path = known.get(str(layout), Path(layout))
    if not is_regular_file(path):
        meant = closest(str(layout), tuple(known))
        raise ConfigError(
            f"layout {str(layout)!r}", f"a YAML file, or {', '.join(known)}", _HINT, meant
        )
    return path


FORM = '{"pool": "dining", "support": "table", "objects": [{"name": "mug", "position": [0.1, 0, 0.75]}]}'
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_UNIT_NAMES = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
}
_REMARKS = ("comment", "comments", "description", "note", "notes", "reason", "reasoning", "title")
"""Keys of words that change nothing."""
_EXPORTED = (
    "format",
    "conventions",
    "timestep",
    "gravity",
    "friction",
    "bounds",
    "assets",
    "cameras",
)
"""Keys of exported scenes besides: what they say of the world is the support's and the pool's own."""
_ALIKE_TURN = 1e-3
_ALIKE_PLACE = 1e-6
_FULL_TURN = 2 * math.pi
_LYING = math.cos(math.radians(30.0))
_UNIT_LENGTH = 0.05


@dataclass(frozen=True, eq=False)
class LayoutEntry:
    """One object of a layout.

    Attributes:
      name: as the file has it; asset: the pool's name for it, "" if the file gives none.
      pose: f64[7], T_world_object, metres, wxyz, of unit length.
    """

    name: str
    asset: str
    pose: np.ndarray


@dataclass(frozen=True, eq=False)
class LayoutFile:
    """A layout as its file has it.

    Attributes:
      pool, support: "" where it names none.
      half_extents: of the support's region as an exported scene tells it, metres.
      notes: what is odd in it.
      is_in_metres: whether lengths are metres because no unit is stated.
    """

    entries: tuple[LayoutEntry, ...]
    pool: str
    support: str
    half_extents: tuple[float, float] | None
    notes: tuple[str, ...]
    is_in_metres: bool


def read_layout_json(path: Path) -> LayoutFile:
    """The layout in a JSON file.

    A position is `position` in the file's or the object's `unit` (m, cm, mm), or `position_m`, `position_cm`,
    `position_mm`. An orientation is one of `quaternion_wxyz`, `quaternion_xyzw`, `rpy` or `euler_rad`,
    `rpy_deg` or `euler_deg` (turns about the fixed axes x, y, z in this order), `yaw` or `yaw_rad`, `yaw_deg`
    (about z), or `euler` with `euler_unit` (deg, rad) and `euler_order`: small letters are turns about fixed
    axes, one after another, as xyz and zyx; capital ones are about axes that turn along, as ZYX. None is
    upright.

    Raises:
      ConfigError: it is no layout, has a key that is not known, or says two things of one object.
    """
    try:
        record = read_json(path)
    except (SchemaError, OSError) as error:
        raise ConfigError(f"{path} is no layout ({error})", f"JSON such as {FORM}") from error
    if not isinstance(record, dict):
        raise ConfigError(
            f"{path} is no layout but {type(record).__name__}", f"JSON such as {FORM}"
        )
    exported = _EXPORTED if "format" in record else ()
    _check_keys(record, (*_OF_FILE, *_REMARKS, *exported), f"{path}")
    if not isinstance(record.get("objects"), list):
        given = (
            f"objects = {_short(record['objects'])}"
            if "objects" in record
            else "there is no key 'objects'"
        )
        raise ConfigError(f"{path} is no layout: {given}", f"a list, in JSON such as {FORM}")
    if not record["objects"]:
        raise ConfigError(f"{path} holds no objects", "one or more")
    unit = _unit_of(record, f"{path}")
    notes: list[str] = []
    entries = tuple(
        _entry(each, f"{path}: objects[{place}]", unit, notes)
        for place, each in enumerate(record["objects"])
    )
    support, half_extents = _support_of(record, path)
    pool = record.get("pool", "")
    if not isinstance(pool, str):
        raise ConfigError(f"{path}: pool = {pool!r}", "a pool's name")
    is_plain = not unit and not any("unit" in each or "units" in each for each in record["objects"])
    is_plain &= all("position" in each for each in record["objects"])
    return LayoutFile(entries, pool, support, half_extents, tuple(notes), is_plain)


def _check_keys(record: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    """Refuses a key that nothing is known of (ConfigError)."""
    for key in record:
        if key not in known:
            shown = [
                each
                for each in known
                if each not in (*_REMARKS, *_EXPORTED, *_RESULTS, "is_stable")
            ]
            meant = _MEANT.get(key.lower(), "")
            if meant == _ANY_TURN:
                meant = _turn_of(record[key])
            elif meant not in known or meant in record:
                meant = closest(key, shown)
            raise ConfigError(
                f"{where}: the key {key!r} is not known", ", ".join(shown), meant=meant
            )


def _turn_of(value: Any) -> str:
    """The key of an orientation that takes a value of this form; "" where none does."""
    if isinstance(value, list):
        return {3: "rpy_deg", 4: "quaternion_wxyz"}.get(len(value), "")
    return "yaw_deg" if isinstance(value, int | float) else ""


def _unit_of(record: Mapping[str, Any], where: str) -> str:
    """The unit of length that a file or an object states; "" where it states none."""
    stated = [record[key] for key in ("unit", "units") if key in record]
    found = [
        _UNIT_NAMES.get(each.strip().lower(), "") if isinstance(each, str) else ""
        for each in stated
    ]
    if not all(found) or len(set(found)) > 1:
        raise ConfigError(f"{where}: unit = {', '.join(map(repr, stated))}", "one of m, cm, mm")
    return found[0] if found else ""


def _support_of(record: Mapping[str, Any], path: Path) -> tuple[str, tuple[float, float] | None]:
    """The support's name, and its region's half extents where an exported scene tells them."""
    support = record.get("support", "")
    if isinstance(support, str):
        return support, None
    if not isinstance(support, dict) or not isinstance(support.get("name"), str):
        raise ConfigError(f"{path}: support = {_short(support)}", "a support's name")
    if "format" not in record:
        _check_keys(support, ("name", "top", "region"), f"{path}: support")
    region = support.get("region", {})
    if "half_extents" not in region:
        return support["name"], None
    x, y = _numbers(region["half_extents"], 2, f"{path}: support: region: half_extents")
    return support["name"], (x, y)


def _entry(entry: Any, where: str, unit: str, notes: list[str]) -> LayoutEntry:
    if not isinstance(entry, dict):
        allowed = '{"name": ..., "position": [...]}'
        raise ConfigError(f"{where} = {_short(entry)}, so it is no layout", allowed)
    # Angles without their unit could be either.
    stated = (_EULER, *_OF_EULER) if "euler_unit" in entry else _OF_EULER
    _check_keys(entry, (*_PLAIN, *_PLACES, *_TURNS, *stated, *_REMARKS, *_RESULTS), where)
    name = entry.get("name")
    asset = entry.get("asset", "")
    if not isinstance(name, str) or not name or not isinstance(asset, str):
        raise ConfigError(f"{where}: name = {_short(name)}, asset = {_short(asset)}", "texts")
    where = f"{where} ({name})"
    own = _unit_of(entry, where)
    if own and unit and own != unit:
        raise ConfigError(f"{where}: unit = {own!r} in a file of {unit!r}", "one unit")
    position = _position(entry, where, own or unit)
    return LayoutEntry(name, asset, np.array([*position, *_quaternion(entry, where, notes)]))


def _position(entry: Mapping[str, Any], where: str, unit: str) -> np.ndarray:
    """f64[3], metres."""
    given = {key: entry[key] for key in _PLACES if key in entry}
    if not given:
        raise ConfigError(f"{where} has no position", '"position": [x, y, z], metres')
    found = {}
    for key, value in given.items():
        stated = key.rpartition("_")[2] if "_" in key else ""
        if stated and unit and stated != unit:
            raise ConfigError(f"{where}: {key!r} with unit = {unit!r}", "one unit")
        if isinstance(value, dict) and set(value) == {"x", "y", "z"}:
            value = [value[axis] for axis in "xyz"]
        found[key] = UNITS[stated or unit or "m"] * _numbers(value, 3, f"{where}: {key}")
    first, *others = found.values()
    if any(np.abs(first - other).max() > _ALIKE_PLACE for other in others):
        raise ConfigError(f"{where}: {' and '.join(found)} say different things", "one of them")
    return first


def _quaternion(entry: Mapping[str, Any], where: str, notes: list[str]) -> np.ndarray:
    """f64[4], wxyz, of unit length."""
    readers = _TURNS | _readers_of_euler(entry, where)
    found = {key: readers[key](entry[key], f"{where}: {key}") for key in readers if key in entry}
    for key, value in found.items():
        length = float(np.linalg.norm(value))
        if length < 1e-3:
            raise ConfigError(
                f"{where}: {key} = {entry[key]}, which has no direction", "a unit quaternion"
            )
        if abs(length - 1) > _UNIT_LENGTH:
            notes.append(f"{where}: {key} is of length {length:.3g}, and taken for its direction")
        found[key] = value / length
    if not found:
        return np.array([1.0, 0.0, 0.0, 0.0])
    first, *others = found.values()
    if any(turn_between(np, first, other) > _ALIKE_TURN for other in others):
        raise ConfigError(f"{where}: {' and '.join(found)} say different things", "one of them")
    for key, (read, other) in _OTHER_ORDER.items():
        if key in found:
            swapped = read(entry[key], where)
            is_upright = rotation_matrix(swapped / np.linalg.norm(swapped))[2, 2] >= _LYING
            if rotation_matrix(found[key])[2, 2] < _LYING and is_upright:
                notes.append(
                    f"{where}: by {key} it is tilted or lies; in the order of {other} it is upright"
                )
    return first


def _readers_of_euler(
    entry: Mapping[str, Any], where: str
) -> dict[str, Callable[[Any, str], np.ndarray]]:
    """What reads the angles of an object whose unit or order has a key of its own."""
    if not any(key in entry for key in _OF_EULER):
        return {}
    angles = [key for key in (_EULER, "euler_deg", "euler_rad") if key in entry]
    if not angles:
        stated = " and ".join(key for key in _OF_EULER if key in entry)
        raise ConfigError(f"{where}: {stated} without angles", "euler with three angles")
    order = entry.get("euler_order", "")
    if not isinstance(order, str) or (order and not _ORDER.fullmatch(order)):
        raise ConfigError(
            f"{where}: euler_order = {_short(order)}",
            "three axes, xyz for turns about fixed axes, XYZ for turns about axes that turn along",
        )
    unit = entry.get("euler_unit", "deg")
    if unit not in _ANGLE_UNITS:
        raise ConfigError(f"{where}: euler_unit = {_short(unit)}", ", ".join(_ANGLE_UNITS))
    if not order and sum(each != 0 for each in _numbers(entry[angles[0]], 3, where)) > 1:
        raise ConfigError(
            f"{where}: {angles[0]} of several turns without its order",
            "euler_order, such as xyz (fixed axes) or ZYX (axes that turn along)",
        )
    factors = {_EULER: _ANGLE_UNITS[unit], "euler_deg": _DEGREE, "euler_rad": 1.0}
    return {key: _turns_in_order(order or "xyz", factors[key]) for key in angles}


def _turns_in_order(order: str, factor: float) -> Callable[[Any, str], np.ndarray]:
    from scipy.spatial.transform import Rotation

    def read(value: Any, where: str) -> np.ndarray:
        angles = factor * _numbers(value, 3, where)
        if factor == 1.0 and np.abs(angles).max() > _FULL_TURN:
            raise ConfigError(
                f"{where} = {value!r}, which is more than a full turn", "radians", "degrees"
            )
        return Rotation.from_euler(order, angles).as_quat(scalar_first=True)

    return read


def _short(value: Any) -> str:
    return f"{value!r:.80}"


def _numbers(value: Any, count: int, where: str) -> np.ndarray:
    """f64[count] of a list of finite numbers (ConfigError)."""
    is_list = isinstance(value, list) and len(value) == count
    if not is_list or any(not _is_number(each) for each in value):
        raise ConfigError(
            f"{where} = {_short(value)}, so it is no layout", f"a list of {count} numbers"
        )
    try:
        numbers = np.array(value, np.float64)
    except OverflowError:
        numbers = np.full(count, np.inf)
    if not np.isfinite(numbers).all():
        raise ConfigError(
            f"{where} = {_short(value)}, which is not finite", f"{count} finite numbers"
        )
    return numbers


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _wxyz(value: Any, where: str) -> np.ndarray:
    return _numbers(value, 4, where)


def _xyzw(value: Any, where: str) -> np.ndarray:
    return np.roll(_numbers(value, 4, where), 1)


def _angles(count: int, factor: float) -> Callable[[Any, str], np.ndarray]:
    """Reads a yaw, or roll, pitch and yaw, in radians or degrees."""

    def read(value: Any, where: str) -> np.ndarray:
        if count == 1 and not _is_number(value):
            raise ConfigError(f"{where} = {_short(value)}, so it is no layout", "one number")
        angles = _numbers(value if count == 3 else [value], count, where)
        if factor == 1.0 and np.abs(angles).max() > _FULL_TURN:
            key = where.rpartition(": ")[2]
            meant = f"{key.removesuffix('_rad')}_deg"
            raise ConfigError(
                f"{where} = {value!r}, which is more than a full turn", "radians", meant=meant
            )
        roll, pitch, yaw = factor * (angles if count == 3 else np.array([0.0, 0.0, angles[0]]))
        turn = _about(2, yaw)
        return product(turn, product(_about(1, pitch), _about(0, roll)))

    return read


def _about(axis: int, angle: float) -> np.ndarray:
    turn = np.zeros(4)
    turn[0] = math.cos(angle / 2)
    turn[1 + axis] = math.sin(angle / 2)
    return turn


_DEGREE = math.pi / 180
_EULER = "euler"
_OF_EULER = ("euler_unit", "euler_order")
_ORDER = re.compile(r"(?!.?([xyzXYZ])\1)(?:[xyz]{3}|[XYZ]{3})")
_ANGLE_UNITS = {"deg": _DEGREE, "degrees": _DEGREE, "rad": 1.0, "radians": 1.0}
_OF_FILE = ("pool", "support", "objects", "unit", "units", "is_stable")
_PLAIN = ("name", "asset", "unit", "units")
_PLACES = ("position", "position_m", "position_cm", "position_mm")
_TURNS: dict[str, Callable[[Any, str], np.ndarray]] = {
    "quaternion_wxyz": _wxyz,
    "quaternion_xyzw": _xyzw,
    "quat_wxyz": _wxyz,
    "quat_xyzw": _xyzw,
    "rpy": _angles(3, 1.0),
    "rpy_rad": _angles(3, 1.0),
    "rpy_deg": _angles(3, _DEGREE),
    "euler_rad": _angles(3, 1.0),
    "euler_deg": _angles(3, _DEGREE),
    "yaw": _angles(1, 1.0),
    "yaw_rad": _angles(1, 1.0),
    "yaw_deg": _angles(1, _DEGREE),
}
_OTHER_ORDER = {
    "quaternion_wxyz": (_xyzw, "quaternion_xyzw"),
    "quaternion_xyzw": (_wxyz, "quaternion_wxyz"),
    "quat_wxyz": (_xyzw, "quat_xyzw"),
    "quat_xyzw": (_wxyz, "quat_wxyz"),
}
_RESULTS = ("is_placed", "shift", "turn")
"""Keys of what `repair` has written: of the layout that was."""
_ANY_TURN = "an orientation"
_MEANT = {
    **dict.fromkeys(("quaternion", "quat"), "quaternion_wxyz"),
    **dict.fromkeys(("euler", "euler_angles"), "euler_deg"),
    **dict.fromkeys(
        (
            "orientation",
            "rotation",
            "rot",
            "rotation_deg",
            "angle",
            "angles",
            "heading",
            "heading_deg",
            "theta",
        ),
        _ANY_TURN,
    ),
    **dict.fromkeys(("roll", "pitch", "roll_deg", "pitch_deg"), "rpy_deg"),
    **dict.fromkeys(
        ("pos", "xyz", "x", "y", "z", "location", "coordinates", "translation"), "position"
    ),
    **dict.fromkeys(("object", "object_name", "label", "id", "type"), "name"),
    **dict.fromkeys(("category", "model", "class"), "asset"),
    **dict.fromkeys(("table", "surface", "furniture"), "support"),
    **dict.fromkeys(("items",), "objects"),
}
