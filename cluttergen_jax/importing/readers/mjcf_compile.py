"""MJCF files compiled by MuJoCo within limits, mended where what stops it does not matter.

For import, render and judge. MuJoCo itself has no limits: how much a file asks of it is seen by its text.

A file that MuJoCo compiles is left as it is. Of others, each thing that it stops at is changed and noted:

- Attributes that older versions of MuJoCo knew get their names of today, or are left out.
- Pictures that are missing or damaged are left out: the surface has its material's colour.
- Meshes without a volume that are only seen, such as labels, are shells without mass.
- Masses and inertias that no body has are replaced where the body does not move, or where nothing is
  simulated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from PIL import Image

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers.opening import MOST_MESH, MOST_PIXELS, check_openable
from cluttergen_jax.importing.readers.xml_tree import (
    BROKEN,
    Element,
    attribute_text,
    parse_numbers,
    read_xml,
)

MOST_ELEMENTS = 200_000
"""Elements of a model, copies by <replicate>, <composite> and <attach> included."""
_MOST_COPIES = 2000
"""By <replicate>, for which MuJoCo's time grows with the third power: 19 s for 2000 bodies."""
_MOST_CELLS = 1 << 24
"""Of a height field or a grid."""
_MOST_BYTES = 4 << 30
_MOST_SUBDIVISION = 7
"""Of a sphere that MuJoCo makes: each step has four times as many triangles."""
_MOST_PARAMS = 1000
"""Of other forms that MuJoCo makes: sides and rings."""
_MOST_NESTED = 16
"""Files that attach or include each other in a row."""
_FOLDERS = ("meshdir", "assetdir", "texturedir")
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tga")
_UNITS = {"k": 10, "m": 20, "g": 30, "t": 40, "p": 50, "e": 60}
_COUNTED = (
    *("count", "grid", "nrow", "ncol", "nkey", "nuserdata", "njmax", "nconmax"),
    *(
        f"nuser_{kind}"
        for kind in ["body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor"]
    ),
)


def check_mjcf_extent(path: Path) -> None:
    """Refuses a model that goes beyond limits; what MuJoCo refuses itself is left to it.

    Raises:
      AssetError: it attaches or includes itself, names what is no regular file, or asks for more copies,
        cells, pixels or bytes than a model of an object has.
    """
    _Model(path).check()


@dataclass
class _Model:
    """What a model asks for.

    Attributes:
      sizes: elements of each file, copies included.
      copies: of all that is replicated.
    """

    path: Path
    sizes: dict[Path, float] = field(default_factory=dict)
    copies: float = 0.0

    def check(self) -> None:
        count = self._size(self.path, (), self.path.parent)
        if self.copies > _MOST_COPIES:
            raise self._error(
                f"<replicate> of {self.copies:.7g} copies", f"up to {_MOST_COPIES:,} in all"
            )
        if count > MOST_ELEMENTS:
            raise self._error(
                f"a model of {count:.3g} elements, copies included", f"up to {MOST_ELEMENTS:,}"
            )

    def _error(self, given: str, allowed: str, hint: str = "a smaller model") -> AssetError:
        return AssetError(f"{self.path}: {given}", allowed, hint)

    def _size(self, file: Path, above: tuple[Path, ...], main: Path) -> float:
        """Elements of a file with all that it includes and attaches.

        Args:
          above: the files that do so with this one; main: the folder that names are relative to.
        """
        real = file.resolve()
        if real in above:
            way = " -> ".join(each.name for each in (*above[above.index(real) :], real))
            raise self._error(
                f"a model that attaches or includes itself ({way})", "files that do not", ""
            )
        if len(above) >= _MOST_NESTED:
            raise self._error(
                f"more than {_MOST_NESTED} files within each other", f"up to {_MOST_NESTED}"
            )
        if real in self.sizes:
            return self.sizes[real]
        try:
            root = read_xml(file)
        except BROKEN as error:
            if "within each other" in str(error):
                raise self._error(
                    str(error), "elements within each other that are fewer"
                ) from error
            # MuJoCo says why.
            return 0.0
        folders = [main, file.parent, *asset_folders(root, main)]
        parts: dict[str, float] = {}
        included = 0.0
        for element in root.iter():
            self._check_element(element)
            for name in named_files(element):
                for there in places_of(name, folders):
                    self._check_file(there, element.tag)
                    if element.tag == "model":
                        parts[element.get("name", "")] = self._size(
                            there, (*above, real), there.parent
                        )
                    elif element.tag == "include":
                        included += self._size(there, (*above, real), main)
                    break
        own, copies = _copies(root, parts)
        self.sizes[real] = own + included
        self.copies += copies
        return self.sizes[real]

    def _check_file(self, file: Path, tag: str) -> None:
        check_openable(file, MOST_MESH)
        if file.suffix.lower() in _PICTURES:
            check_pixels(file)
        if tag == "hfield" and file.suffix.lower() not in _PICTURES:
            with file.open("rb") as content:
                rows, columns = (
                    int.from_bytes(content.read(4), "little", signed=True) for _ in range(2)
                )
            self._check_grid("hfield", rows, columns)

    def _check_grid(self, tag: str, rows: float, columns: float) -> None:
        if rows > 0 and columns > 0 and rows * columns > _MOST_CELLS:
            raise self._error(
                f"a <{tag}> of {rows:g} x {columns:g} cells", f"up to {_MOST_CELLS:,} cells"
            )

    def _check_element(self, element: Element) -> None:
        tag = str(element.tag)
        number = {name: _first(element, name) for name in (*_COUNTED, "width", "height")}
        if tag == "hfield":
            self._check_grid(tag, number["nrow"], number["ncol"])
        if tag == "texture" and number["width"] > 0:
            # A cube has six faces, one below the other.
            height = max(number["height"], number["width"])
            if 6 * number["width"] * height > MOST_PIXELS:
                raise self._error(
                    f"a <texture> of {number['width']:g} x {height:g} pixels",
                    f"up to {MOST_PIXELS:,} pixels",
                )
        if tag == "mesh" and element.get("builtin"):
            most = _MOST_SUBDIVISION if element.get("builtin") == "sphere" else _MOST_PARAMS
            if max(map(abs, _all(element, "params")), default=0) > most:
                raise self._error(f"a <mesh> of params {element.get('params')!r}", f"up to {most}")
        if tag == "size":
            for name in _COUNTED:
                if number[name] > _MOST_CELLS:
                    raise self._error(
                        f"<size {name}={element.get(name)!r}>", f"up to {_MOST_CELLS:,}"
                    )
            for name in ("memory", "nstack", "njmax_memory"):
                if _bytes(element.get(name, "")) > _MOST_BYTES:
                    raise self._error(f"<size {name}={element.get(name)!r}>", "up to 4G")
        if tag in ("flexcomp", "composite"):
            self._check_grid(tag, *_product(element))


def _product(element: Element) -> tuple[float, float]:
    counts = [max(each, 1.0) for each in _all(element, "count")]
    return math.prod(counts[:1]), math.prod(counts[1:])


def _copies(root: Element, parts: dict[str, float]) -> tuple[float, float]:
    """Elements of a tree, those within <replicate> as often as it says, with the models that it attaches.

    Returns:
      Their number, and that of the copies which <replicate> makes.
    """
    total = 0.0
    copies = 0.0
    todo = [(root, 1.0)]
    while todo:
        element, times = todo.pop()
        own = 1.0
        if element.tag == "replicate":
            times *= max(_first(element, "count"), 1.0)
            copies += times
        elif element.tag in ("composite", "flexcomp"):
            own += math.prod(_product(element))
        elif element.tag == "attach":
            own += parts.get(element.get("model", ""), 0.0)
        total += times * own
        if math.isnan(total) or max(total, copies) > 1e30:
            return math.inf, copies
        todo += [(child, times) for child in element]
    return total, copies


def asset_folders(root: Element, main: Path) -> list[Path]:
    """The folders that an MJCF tree's <compiler> names, from that of the main file on."""
    compilers = list(root.iter("compiler"))
    return [main / each.get(name, "").replace("\\", "/") for each in compilers for name in _FOLDERS]


def named_files(element: Element) -> Iterator[str]:
    """What the attributes of an MJCF element call files."""
    for name, value in element.items():
        if name.startswith("file") and value:
            yield value.replace("\\", "/")


def places_of(name: str, folders: Iterable[Path]) -> Iterator[Path]:
    """Where MuJoCo may look for a file and something is, with its path stripped or not."""
    for folder in dict.fromkeys(folders):
        for place in (folder / name, folder / Path(name).name):
            try:
                if place.exists() and not place.is_dir():
                    yield place
            except (OSError, ValueError):
                continue


def _all(element: Element, name: str) -> list[float]:
    found = parse_numbers(attribute_text(element, name) or "") or []
    return [0.0 if math.isnan(each) else each for each in found]


def _first(element: Element, name: str) -> float:
    return next(iter(_all(element, name)), 0.0)


def _bytes(text: str) -> float:
    """What "1G" or "1024" says; 0 where it is no number."""
    text = text.strip().lower()
    exponent = _UNITS.get(text[-1:], 0)
    found = parse_numbers(text[:-1] if exponent else text) or [0.0]
    return found[0] * 2.0**exponent


def check_pixels(file: Path) -> None:
    """Refuses an image of too many pixels, by its head (AssetError); what is none is left to its reader."""
    try:
        with Image.open(file) as image:
            width, height = image.size
    except Image.DecompressionBombError as error:
        raise AssetError(f"{file}: {error}", f"up to {MOST_PIXELS:,} pixels") from error
    except Exception:  # Pillow's decoders raise whatever they do.
        return
    if width * height > MOST_PIXELS:
        raise AssetError(
            f"{file} has {width:,} x {height:,} pixels", f"up to {MOST_PIXELS:,} pixels"
        )


_SPELLINGS: dict[tuple[str, str], Callable[[str], dict[str, str]]] = {
    ("camera", "orthographic"): lambda said: (
        {"projection": "orthographic"} if said == "true" else {}
    ),
    ("compiler", "convexhull"): lambda said: {},
    ("compiler", "exactmeshinertia"): lambda said: {},
    ("flag", "passive"): lambda said: {"spring": said, "damper": said},
    ("flag", "sensornoise"): lambda said: {},
    ("option", "apirate"): lambda said: {},
    ("option", "mpr_iterations"): lambda said: {"ccd_iterations": said},
    ("option", "mpr_tolerance"): lambda said: {"ccd_tolerance": said},
}
"""Attributes that MuJoCo knew once, and what says the same today; nothing, where it is now always so."""
_NO_VOLUME = re.compile(r"mesh volume is too small|inconsistent orientation|coplanar vertices")
_NO_AREA = re.compile(r"surface area is too small|collinear vertices|at least (3|4) vertices")
_NO_MASS = re.compile(r"mass and inertia of moving bodies must be larger")
_NO_INERTIA = re.compile(
    r"inertia must satisfy|inertia must have positive|full inertia|negative inertia"
)
_SHELL_OF_MESH = re.compile(r"for mesh geoms, inertia should be specified")
_ELEMENT = re.compile(r"Element name '(.*)', id (\d+)")
NO_MASS = 1e-9
"""Kilograms that stand for nothing: MuJoCo wants more than 1e-15."""
_NO_MOMENT = 1e-12
"""kg m^2, likewise."""
_MOST_EDITS = 200
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
_BY_VOLUME = mujoco.mjtGeomInertia.mjINERTIA_VOLUME


_COMPILING = 60
"""Seconds of a processor that MuJoCo may take to compile a file."""


def compile_with_notes(
    path: Path, is_simulated: bool = False
) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of an MJCF file, whose names are text, and what had to be changed in it (see the module).

    MuJoCo compiles in the process that calls it, where a crash, or all memory, would end the whole program:
    so the file is tried in a process with limits first.

    Raises:
      AssetError: MuJoCo cannot compile it (its own message is kept), a name is not UTF-8, or it goes beyond
        limits: by its text, or because compiling it crashes, takes too long or too much.
    """
    check_mjcf_extent(path)
    call_limited(path, _try_to_compile, path, seconds=_COMPILING)
    try:
        model, notes = _compile(path, is_simulated)
        # MuJoCo takes any bytes for a name; they would come to light wherever one is first read.
        model.names.decode()
    except (ValueError, OSError, mujoco.FatalError) as error:
        message = " ".join(str(error).split())
        is_missing = "opening file" in message
        allowed = "" if is_missing else "an MJCF file"
        hint = "restoring the file that it names" if is_missing else ""
        raise AssetError(f"{path} cannot be compiled as MJCF: {message}", allowed, hint) from error
    return model, notes


def _try_to_compile(path: Path) -> None:
    """Compiles a file for whether that comes to an end; what it says is said by who compiles it next."""
    with suppress(ValueError, OSError, mujoco.FatalError):
        mujoco.MjModel.from_xml_path(str(path))


def _compile(path: Path, is_simulated: bool) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of an MJCF file, and what was changed so that MuJoCo compiles it, in words.

    Args:
      is_simulated: masses of what moves matter, and what collides collides: these are left as they are.

    Raises:
      ValueError: the file cannot be compiled for another reason; MuJoCo's own message.
    """
    try:
        return mujoco.MjModel.from_xml_path(str(path)), ()
    except ValueError as error:
        first = error
    try:
        edits = _Edits(path, is_simulated)
    except ValueError:
        raise first from None
    for _ in range(_MOST_EDITS):
        try:
            return edits.spec.compile(), edits.notes()
        except ValueError as error:
            if not edits.mend(str(error)):
                raise
    raise first


def parse_mjcf(path: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """An MJCF file parsed, and which attributes of older versions of MuJoCo were renamed or left out.

    Raises:
      ValueError: MuJoCo cannot parse it.
    """
    try:
        return mujoco.MjSpec.from_file(str(path)), ()
    except ValueError as error:
        if "unrecognized attribute" not in str(error):
            raise
        files, notes = _read_old_spellings(path)
        if not notes:
            raise
    return mujoco.MjSpec.from_file(str(path), include=files), notes


def _read_old_spellings(path: Path) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """The file and those that it includes with today's attributes, by name; and what was changed."""
    waiting = [(str(path), path)]
    files = dict[str, bytes]()
    notes = dict[str, None]()
    while waiting:
        name, file = waiting.pop()
        try:
            root = read_xml(file)
        except (*BROKEN, AssetError):
            return {}, ()
        for element in root.iter():
            for attribute in [each for each in element.attrib if (element.tag, each) in _SPELLINGS]:
                said = element.attrib.pop(attribute)
                fresh = _SPELLINGS[element.tag, attribute](said)
                element.attrib.update(fresh)
                written = " ".join(f'{key}="{value}"' for key, value in fresh.items())
                old = f'{element.tag} {attribute}="{said}"'
                notes[
                    f"an older MuJoCo's {old} is {f'read as {written}' if fresh else 'left out'}"
                ] = None
            if (
                element.tag == "include"
                and (other := element.get("file", ""))
                and other not in files
            ):
                waiting.append((other, path.parent / other))
        files[name] = ElementTree.tostring(root)
    return files, tuple(notes)


def collides(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Whether a geom can touch another, by its bits or because a pair names it."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)} - {""}
    return bool(geom.contype or geom.conaffinity) or geom.name in paired


class _Edits:
    """Changes a spec where MuJoCo stops at it, and keeps what was changed.

    Attributes:
      spec: as it is now.
    """

    def __init__(self, path: Path, is_simulated: bool) -> None:
        self._path = path
        self._is_simulated = is_simulated
        self.spec, notes = parse_mjcf(path)
        self._notes: dict[str, dict[str, None]] = {each: {} for each in notes}
        self._done: list[Callable[[], bool]] = []
        self._lost: dict[str, str] | None = None

    def notes(self) -> tuple[str, ...]:
        """What was changed, in words: one note for each kind."""
        return tuple(
            ": ".join([what, ", ".join(names)]) if names else what
            for what, names in self._notes.items()
        )

    def mend(self, message: str) -> bool:
        """Whether something was changed of what a message of MuJoCo complains about."""
        found = _ELEMENT.search(message)
        name, number = (found[1], int(found[2])) if found else ("", -1)
        if _SHELL_OF_MESH.search(message):
            edit = self._move_shells
        elif _NO_VOLUME.search(message):
            edit = partial(self._without_volume, name)
        elif _NO_AREA.search(message):
            edit = partial(self._without_area, name)
        elif _NO_MASS.search(message) or _NO_INERTIA.search(message):
            edit = partial(self._without_mass, number, bool(_NO_MASS.search(message)))
        else:
            edit = self._without_pictures
        # A mesh that was to collide once is asked for its hull ever after: what is edited is parsed anew.
        self.spec = parse_mjcf(self._path)[0]
        for each in self._done:
            each()
        self._done.append(edit)
        return edit()

    def _note(self, what: str, name: str) -> bool:
        self._notes.setdefault(what, {})[name] = None
        return True

    def _move_shells(self) -> bool:
        """Older files say of a geom that its mesh is a shell: today the mesh says so."""
        geoms = [
            each for each in self.spec.geoms if each.meshname and each.typeinertia != _BY_VOLUME
        ]
        for geom in geoms:
            geom.typeinertia = _BY_VOLUME
            self.spec.mesh(geom.meshname).inertia = _SHELL
            self._note("meshes that are shells, as their geoms say", repr(geom.meshname))
        return bool(geoms)

    def _without_volume(self, name: str) -> bool:
        mesh, geoms = self._users(name)
        is_colliding = any(collides(self.spec, each) for each in geoms)
        if mesh is None or (mesh.inertia == _SHELL and not is_colliding):
            return False
        if is_colliding and self._is_simulated:
            return False
        if is_colliding:
            self._stop_colliding(geoms)
        mesh.inertia = _SHELL
        for geom in geoms:
            geom.typeinertia = _BY_VOLUME
            # What has no volume weighs nothing, if no mass is stated; a shell weighs by its area.
            geom.mass = geom.mass if np.isfinite(geom.mass) else 0.0
        if is_colliding:
            return self._note(
                "meshes that are flat: they are seen, and collide with nothing", repr(name)
            )
        return self._note("meshes without a volume, which are shells without mass", repr(name))

    def _without_area(self, name: str) -> bool:
        mesh, geoms = self._users(name)
        if mesh is None or (
            self._is_simulated and any(collides(self.spec, each) for each in geoms)
        ):
            return False
        for thing in [*geoms, mesh]:
            self.spec.delete(thing)
        return self._note("left out, as they have no surface: meshes", repr(name))

    def _without_mass(self, number: int, is_mass: bool) -> bool:
        bodies = self.spec.bodies
        if not 0 < number < len(bodies) or (self._is_simulated and _moves(bodies[number])):
            return False
        body = bodies[number]
        if is_mass:
            body.mass = max(body.mass if body.explicitinertial else 0.0, NO_MASS)
        body.explicitinertial = True
        body.fullinertia = np.full(6, np.nan)
        body.inertia = np.full(3, _NO_MOMENT)
        self.spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        what = "no mass" if is_mass else "an impossible inertia"
        why = "nothing is simulated" if not self._is_simulated else "they do not move"
        return self._note(
            f"bodies with {what}, which does not matter as {why}", repr(body.name or f"#{number}")
        )

    def _without_pictures(self) -> bool:
        if self._lost is None:
            self._lost = _unreadable_pictures(self._path)
        worn = {each for material in self.spec.materials for each in material.textures}
        is_there = any(each.name in self._lost for each in self.spec.textures)
        _drop(self.spec, self._lost)
        for file in dict.fromkeys(file for name, file in self._lost.items() if name in worn):
            self._notes[
                f"the image {file!r} cannot be read: its surface has its material's colour"
            ] = {}
        return is_there

    def _users(self, name: str) -> tuple[mujoco.MjsMesh | None, list[mujoco.MjsGeom]]:
        """A mesh and the geoms that show it."""
        return self.spec.mesh(name), [each for each in self.spec.geoms if each.meshname == name]

    def _stop_colliding(self, geoms: Iterable[mujoco.MjsGeom]) -> None:
        names = {each.name for each in geoms} - {""}
        for pair in list(self.spec.pairs):
            if names & {pair.geomname1, pair.geomname2}:
                self.spec.delete(pair)
        for geom in geoms:
            geom.contype = geom.conaffinity = 0


def _moves(body: mujoco.MjsBody) -> bool:
    """Whether a body, or one that it hangs on, has a joint."""
    while body is not None and body.name != "world":
        if body.joints:
            return True
        body = body.parent
    return False


def _unreadable_pictures(path: Path) -> dict[str, str]:
    """The files of the textures that MuJoCo cannot read, by the textures' names."""
    spec = parse_mjcf(path)[0]
    return {
        name: _file_of(spec.texture(name)) for name in _pictures(spec) if not _is_read(path, name)
    }


def _pictures(spec: mujoco.MjSpec) -> list[str]:
    """The names of the textures that come from files."""
    return [each.name for each in spec.textures if _file_of(each)]


def _file_of(texture: mujoco.MjsTexture) -> str:
    return next((each for each in (texture.file, *texture.cubefiles) if each), "")


def _is_read(path: Path, name: str) -> bool:
    """Whether MuJoCo can read a picture of the file, asked where all else is left out."""
    spec = parse_mjcf(path)[0]
    for body in list(spec.worldbody.bodies):
        spec.delete(body)
    for thing in [*spec.worldbody.geoms, *spec.meshes, *spec.hfields]:
        spec.delete(thing)
    _drop(spec, [each for each in _pictures(spec) if each != name])
    try:
        spec.compile()
    except ValueError:
        return False
    return True


def _drop(spec: mujoco.MjSpec, names: Iterable[str]) -> None:
    """Takes pictures off all materials, and away."""
    names = set(names)
    for material in spec.materials:
        for role, name in enumerate(material.textures):
            if name in names:
                material.textures[role] = ""
    for texture in [each for each in spec.textures if each.name in names]:
        spec.delete(texture)
