"""MJCF files compiled by MuJoCo, mended where what stops it does not matter: for import, render and judge.

A file that MuJoCo compiles is left as it is. Of others, each thing that it stops at is changed and noted:

- Attributes that older versions of MuJoCo knew get their names of today, or are left out.
- Pictures that are missing or damaged are left out: the surface has its material's colour.
- Meshes without a volume that are only seen, such as labels, are shells without mass.
- Masses and inertias that no body has are replaced where the body does not move, or where nothing is
  simulated.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.xml_tree import BROKEN, read_xml

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


def compile_mjcf(path: Path, is_simulated: bool) -> tuple[mujoco.MjModel, tuple[str, ...]]:
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
        is_colliding = any(map(self._collides, geoms))
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
        if mesh is None or (self._is_simulated and any(map(self._collides, geoms))):
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

    def _collides(self, geom: mujoco.MjsGeom) -> bool:
        paired = {name for pair in self.spec.pairs for name in (pair.geomname1, pair.geomname2)} - {
            ""
        }
        return bool(geom.contype or geom.conaffinity) or geom.name in paired

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
