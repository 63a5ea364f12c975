"""Files of scenes as MuJoCo models with one start or more: MJCF, URDF, SDF, USD, and arrays of states."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh

from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers.links import Link, SurfaceLook, Surfaces
from cluttergen_jax.importing.readers.mjcf_compile import compile_with_notes
from cluttergen_jax.importing.readers.model import convex_parts
from cluttergen_jax.importing.readers.opening import check_openable
from cluttergen_jax.importing.readers.sdf import axis_of, placed_links, read_sdf_tree
from cluttergen_jax.importing.readers.xml_tree import (
    Element,
    length,
    number,
    numbers,
    parse_xml,
    plain_tag,
)

_GEOM = mujoco.mjtGeom
_JOINT = mujoco.mjtJoint
_KINDS = {
    "revolute": _JOINT.mjJNT_HINGE,
    "continuous": _JOINT.mjJNT_HINGE,
    "prismatic": _JOINT.mjJNT_SLIDE,
    "ball": _JOINT.mjJNT_BALL,
}
_ROUND = {"cylinder": _GEOM.mjGEOM_CYLINDER, "capsule": _GEOM.mjGEOM_CAPSULE}
_FORMS = ("box", "sphere", "cylinder", "capsule", "ellipsoid", "plane", "mesh")
_OWN = {
    "ground_plane": '<link name="link"><collision name="c"><geometry><plane/></geometry></collision></link>',
    "sun": "",
}
"""Links of models of Gazebo's own, which worlds include and which lie in its program's folder."""
_LEFT_OUT = ("actor", "population", "road", "joint")
_NO_LIMIT = 1e15
_YES = ("true", "1")


def read_sdf_world(path: Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The models of a world, or of a file without one, in metres, z up.

    Gravity and the largest time step are the file's, else SDF's defaults (9.8 m/s^2, 1 ms), and so are mass
    and inertia where a link states none (1 kg, 1 kg m^2). Links that fixed joints join are one body.

    Returns:
      The model, and what of the world is left out.

    Raises:
      AssetError: it cannot be read, an included model is not there, or a collider or a joint is of a kind
        that MuJoCo does not have.
      ValueError: MuJoCo refuses it.
    """
    root = read_sdf_tree(path).root
    worlds = root.findall("world")
    if len(worlds) > 1:
        raise AssetError(f"{path} holds {len(worlds)} worlds", "one")
    world = worlds[0] if worlds else root
    for place, element in enumerate(list(world)):
        if element.tag == "include":
            world[place] = _own_model(path, element)
    spec = mujoco.MjSpec()
    spec.option.gravity = numbers(path, world, "gravity", 3, "0 0 -9.8")
    if (physics := world.find("physics")) is not None:
        spec.option.timestep = number(path, physics, "max_step_size", "0.001")
    else:
        spec.option.timestep = 0.001
    for model in world.findall("model"):
        _Model(path, spec, world, model).add()
    others = dict.fromkeys(each.tag for each in world if each.tag in _LEFT_OUT)
    notes = (
        (f"of the world, left out: {', '.join(f'<{each}>' for each in others)}",) if others else ()
    )
    return spec.compile(), notes


def _own_model(path: Path, include: Element) -> Element:
    """Gazebo's own model that a world includes; what else it includes is not there (AssetError)."""
    uri = include.findtext("uri", "").strip()
    name = uri.rstrip("/").rpartition("/")[2].lower().replace(" ", "_")
    if name not in _OWN:
        allowed = "models that lie beside the world, or near it"
        raise AssetError(
            f"{path} includes {uri!r}, which cannot be read", allowed, "its folder beside the world"
        )
    model = ElementTree.fromstring(
        f'<model name="{name}"><static>true</static>{_OWN[name]}</model>'
    )
    if (pose := include.find("pose")) is not None:
        model.append(pose)
    return model


class _Model:
    """One model of a world, as bodies of a spec."""

    def __init__(self, path: Path, spec: mujoco.MjSpec, world: Element, model: Element) -> None:
        self._path = path
        self._spec = spec
        self._model = model
        self._name = model.get("name", "")
        self._links = placed_links(path, model, world)
        self._is_static = (model.findtext("static") or "").strip() in _YES

    def add(self) -> None:
        """Adds its bodies (AssetError where MuJoCo has nothing like it)."""
        if self._is_static:
            for link in self._links:
                self._add_colliders(self._spec.worldbody, np.eye(4), link)
            return
        for inner in self._model.iter("model"):
            moving = [each for each in inner.findall("joint") if each.get("type") != "fixed"]
            if inner is not self._model and moving:
                raise AssetError(
                    f"{self._path}: model {inner.get('name')!r} within a model has joints"
                )
        groups = self._groups()
        joints = [each for each in self._model.findall("joint") if each.get("type") != "fixed"]
        above = {self._group(groups, each, "child"): each for each in joints}
        if len(above) < len(joints):
            raise AssetError(f"{self._path}: model {self._name!r} has a link that two joints move")
        made: dict[int, tuple[mujoco.MjsBody, np.ndarray]] = {-1: (self._spec.worldbody, np.eye(4))}
        for link in self._links:
            if groups[link.name] < 0:
                self._add_colliders(*made[-1], link)
        for group in sorted(set(groups.values())):
            self._add_group(group, groups, above, made, ())

    def _groups(self) -> dict[str, int]:
        """A number for each link: one for those that fixed joints join, -1 for what is fixed to the world."""
        names = [link.name for link in self._links]
        if twice := next((name for name in names if names.count(name) > 1), None):
            given = f"{self._path}: {self._name!r} moves, and has two links called {twice!r} within models"
            raise AssetError(given, "a name for each")
        groups = {link.name: index for index, link in enumerate(self._links)} | {"world": -1}
        for joint in self._model.iter("joint"):
            if joint.get("type") == "fixed":
                one, other = (self._group(groups, joint, tag) for tag in ("parent", "child"))
                low = min(one, other)
                groups = {
                    name: low if group in (one, other) else group for name, group in groups.items()
                }
        return {name: group for name, group in groups.items() if name != "world"}

    def _group(self, groups: dict[str, int], joint: Element, tag: str) -> int:
        name = joint.findtext(tag, "").strip().rpartition("::")[2]
        if name == "world":
            return -1
        if name not in groups:
            given = f"{self._path}: joint {joint.get('name')!r} of {self._name!r} has the {tag} {name!r}"
            raise AssetError(given, ", ".join(map(repr, groups)))
        return groups[name]

    def _add_group(
        self,
        group: int,
        groups: dict[str, int],
        above: dict[int, Element],
        made: dict[int, tuple[mujoco.MjsBody, np.ndarray]],
        below: tuple[int, ...],
    ) -> tuple[mujoco.MjsBody, np.ndarray]:
        """The body of links that are one, and its pose; those that it hangs on are made first."""
        if group in below:
            raise AssetError(
                f"{self._path}: joints of {self._name!r} hang on each other in a circle"
            )
        if group in made:
            return made[group]
        links = [each for each in self._links if groups[each.name] == group]
        pose = _frame_of(links[0])
        joint = above.get(group)
        parent, place = made[-1]
        if joint is not None:
            upper = self._group(groups, joint, "parent")
            parent, place = self._add_group(upper, groups, above, made, (*below, group))
        body = parent.add_body(name=self._body_name(links[0]))
        _put(body, np.linalg.inv(place) @ pose)
        if joint is None:
            body.add_freejoint()
        else:
            self._add_joint(body, pose, joint, links)
        self._weigh(body, pose, links)
        body.gravcomp = float((links[0].element.findtext("gravity") or "true").strip() not in _YES)
        made[group] = body, pose
        for link in links:
            self._add_colliders(body, pose, link)
        return body, pose

    def _body_name(self, link: Link) -> str:
        name = self._name if link is self._links[0] and self._name else f"{self._name}::{link.name}"
        names = {each.name for each in self._spec.bodies}
        return (
            name
            if name not in names
            else next(f"{name}-{i}" for i in range(len(names) + 1) if f"{name}-{i}" not in names)
        )

    def _add_joint(
        self, body: mujoco.MjsBody, pose: np.ndarray, joint: Element, links: list[Link]
    ) -> None:
        kind = joint.get("type", "")
        if kind not in _KINDS:
            given = (
                f"{self._path}: joint {joint.get('name')!r} of {self._name!r} is of type {kind!r}"
            )
            raise AssetError(given, ", ".join(("fixed", *_KINDS)))
        made = body.add_joint(type=_KINDS[kind])
        child = joint.findtext("child", "").strip().rpartition("::")[2]
        link = next(each for each in links if each.name == child)
        anchor, axis = axis_of(self._path, self._model, joint, link)
        back = np.linalg.inv(pose)
        made.pos = (back @ np.append(anchor, 1.0))[:3]
        if axis is None:
            return
        made.axis = back[:3, :3] @ axis
        element = joint.find("axis")
        limit = None if element is None else element.find("limit")
        if limit is not None and kind != "continuous":
            lower, upper = (
                number(self._path, limit, each, default, is_finite=False)
                for each, default in (("lower", "-1e16"), ("upper", "1e16"))
            )
            if max(abs(lower), abs(upper)) < _NO_LIMIT:
                made.range = (lower, upper)
                made.limited = mujoco.mjtLimited.mjLIMITED_TRUE
                if made.type == _JOINT.mjJNT_HINGE:
                    made.range = np.degrees((lower, upper))
        dynamics = None if element is None else element.find("dynamics")
        if dynamics is not None:
            made.damping = number(self._path, dynamics, "damping", "0")
            made.frictionloss = number(self._path, dynamics, "friction", "0")

    def _weigh(self, body: mujoco.MjsBody, pose: np.ndarray, links: list[Link]) -> None:
        """Mass, centre and inertia of links that are one; with auto="true" MuJoCo's own of the colliders."""
        inertials = [(link, link.element.find("inertial")) for link in links]
        if any(each is not None and each.get("auto", "") in _YES for _, each in inertials):
            return
        masses = []
        centers = []
        moments = []
        for link, inertial in inertials:
            mass = 1.0
            inertia = np.eye(3)
            if inertial is not None:
                mass = number(self._path, inertial, "mass", "1")
                inertia = self._inertia(inertial)
            turned = np.linalg.inv(pose) @ link.place(
                Element("none") if inertial is None else inertial
            )
            masses.append(mass)
            centers.append(turned[:3, 3])
            moments.append(turned[:3, :3] @ inertia @ turned[:3, :3].T)
        total = sum(masses)
        if not (math.isfinite(total) and min(masses) >= 0 and total > 0):
            raise AssetError(
                f"{self._path}: a link of {self._name!r} has a mass of {min(masses):g} kg",
                "above 0",
            )
        center = np.average(centers, axis=0, weights=masses)
        inertia = np.zeros((3, 3))
        for mass, each, moment in zip(masses, centers, moments, strict=True):
            offset = each - center
            inertia += moment + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        body.mass = total
        body.ipos = center
        body.explicitinertial = True
        body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    def _inertia(self, inertial: Element) -> np.ndarray:
        given = inertial.find("inertia")
        if given is None:
            return np.eye(3)
        values = {
            a + b: number(self._path, given, f"i{a}{b}", "1" if a == b else "0")
            for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
        }
        return np.array([[values["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])

    def _add_colliders(self, body: mujoco.MjsBody, pose: np.ndarray, link: Link) -> None:
        path = self._path
        for number_, element in enumerate(link.element.findall("collision")):
            place = np.linalg.inv(pose) @ link.place(element)
            for geom in self._geoms(body, element, place, f"{self._name}::{link.name}::{number_}"):
                friction = element.find("surface/friction/ode")
                if friction is not None and friction.find("mu") is not None:
                    geom.friction = (number(path, friction, "mu"), *geom.friction[1:])
                if element.find("density") is not None:
                    geom.density = number(path, element, "density")

    def _geoms(
        self, body: mujoco.MjsBody, element: Element, place: np.ndarray, name: str
    ) -> Iterator[mujoco.MjsGeom]:
        path = self._path
        geometry = element.find("geometry")
        form = None if geometry is None or not len(geometry) else geometry[0]
        if form is None or form.tag not in (*_FORMS, "empty"):
            what = "nothing" if form is None else f"<{form.tag}>"
            raise AssetError(f"{path}: a collider of {self._name!r} is {what}", ", ".join(_FORMS))
        if form.tag == "empty":
            return
        if form.tag == "mesh":
            pieces = Surfaces(path, 16, "uri", _FORMS).pieces(element, place, 1.0, SurfaceLook())
            for index, piece in enumerate(pieces):
                if convex_parts([piece.mesh]) is None:
                    allowed = "meshes that are convex, and other shapes"
                    raise AssetError(
                        f"{path}: a collider of {self._name!r} is a mesh that is not convex",
                        allowed,
                    )
                geom = body.add_geom()
                own = f"{name}-{index}-{len(self._spec.meshes)}"
                _make_hull(self._spec, geom, own, piece.mesh.vertices)
                yield geom
            return
        geom = body.add_geom()
        if form.tag == "plane":
            normal = numbers(path, form, "normal", 3, "0 0 1")
            if not normal.any():
                raise AssetError(f"{path}: a plane of {self._name!r} without a normal")
            place = place @ trimesh.geometry.align_vectors(
                [0, 0, 1], normal / np.linalg.norm(normal)
            )
            geom.type = _GEOM.mjGEOM_PLANE
            geom.size = (0, 0, 1)
        elif form.tag == "box":
            geom.type = _GEOM.mjGEOM_BOX
            geom.size = numbers(path, form, "size", 3) / 2
        elif form.tag == "ellipsoid":
            geom.type = _GEOM.mjGEOM_ELLIPSOID
            geom.size = numbers(path, form, "radii", 3)
        elif form.tag == "sphere":
            geom.type = _GEOM.mjGEOM_SPHERE
            geom.size = (length(path, form, "radius"), 0, 0)
        else:
            radius, height = (length(path, form, each) for each in ("radius", "length"))
            geom.type = _ROUND[form.tag]
            geom.size = (radius, height / 2, 0)
        _put(geom, place)
        yield geom


def _make_hull(spec: mujoco.MjSpec, geom: mujoco.MjsGeom, name: str, vertices: np.ndarray) -> None:
    """Makes a geom the convex hull of points, a mesh of that name."""
    mesh = spec.add_mesh(name=name)
    mesh.uservert = vertices.astype(np.float32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom.type = _GEOM.mjGEOM_MESH
    geom.meshname = name


def _frame_of(link: Link) -> np.ndarray:
    """f64[4, 4]: a link's own frame in the world."""
    return link.place(Element("none"))


def _put(thing: mujoco.MjsBody | mujoco.MjsGeom, pose: np.ndarray) -> None:
    """Gives a body or a geom a pose f64[4, 4]."""
    thing.pos = pose[:3, 3]
    thing.quat = trimesh.transformations.quaternion_from_matrix(pose)


try:
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade
except ImportError:  # pragma: no cover - depends on what is installed
    Usd = None

_TURNS = {"X": ((0, 1, 0), 90), "Y": ((1, 0, 0), -90), "Z": ((0, 0, 1), 0)}
_ROUND_PRIMS = {"Capsule": _GEOM.mjGEOM_CAPSULE, "Cylinder": _GEOM.mjGEOM_CYLINDER}
_SAID = re.compile(
    r"Error in '[^']*' at line \d+ in file .*? : '(.*?)'(?=\s*Error in '|\s*$)", re.DOTALL
)
_FILLED = 0.99
"""Share of its hull that a mesh fills which counts as convex."""


def read_usd(path: Path) -> mujoco.MjModel:
    """The bodies and colliders of a stage, in metres, z up, with MuJoCo's default time step and contacts.

    Meshes collide as their convex hulls, where that is what the stage asks for or what they are. What states
    neither mass nor density has 1,000 kg/m^3, which is UsdPhysics' own default.

    Raises:
      AssetError: it cannot be opened, has joints, or a collider that is not convex or of another kind; USD's
        own words are kept.
      MissingExtraError: usd-core is not installed.
      ValueError: MuJoCo refuses it.
    """
    if Usd is None:
        raise MissingExtraError("usd", "reading USD")
    try:
        return _read_stage(Usd.Stage.Open(str(path)))
    except (ClutterGenError, ValueError, MemoryError):
        raise
    except Exception as error:  # pxr's own kind has no public name, and has no other base.
        raise AssetError(f"it cannot be read as USD: {_own_words(error)}", "a stage") from error


def _own_words(error: Exception) -> str:
    """What USD says of an error, without the places in its source."""
    said = [" ".join(each.split()) for each in _SAID.findall(str(error))]
    cause = [each for each in said if not each.startswith("Failed to open layer")] or said
    return "; ".join(dict.fromkeys(cause)) or " ".join(str(error).split()) or type(error).__name__


def _read_stage(stage: Any) -> mujoco.MjModel:
    """The model of an open stage; see `read_usd`."""
    # Older versions of usd-core cannot be asked.
    lost: Any = getattr(stage, "GetCompositionErrors", tuple)()
    if lost:
        raise AssetError(
            f"parts of it are not there: {' '.join(str(lost[0]).split())}", "a stage that is whole"
        )
    spec = mujoco.MjSpec()
    cache = UsdGeom.XformCache()
    units = _Units(UsdGeom.GetStageMetersPerUnit(stage), UsdPhysics.GetStageKilogramsPerUnit(stage))
    to_world = Gf.Matrix4d(1.0).SetScale(units.metre)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        to_world *= Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), 90))
    bodies: dict[Any, tuple[mujoco.MjsBody, Any]] = {}
    weights: dict[str, tuple[float, np.ndarray | None]] = {}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdPhysics.Joint):
            raise AssetError(f"{prim.GetPath()} is a joint", "scenes of bodies without joints")
        place = cache.GetLocalToWorldTransform(prim) * to_world
        if prim.HasAPI(UsdPhysics.RigidBodyAPI) and _is_moved(UsdPhysics.RigidBodyAPI(prim)):
            body = spec.worldbody.add_body(name=str(prim.GetPath()))
            body.add_freejoint()
            _put_frame(body, place)
            bodies[prim.GetPath()] = body, place.RemoveScaleShear()
            weights[body.name] = _weigh(body, UsdPhysics.MassAPI(prim), units)
        if (
            prim.HasAPI(UsdPhysics.CollisionAPI)
            and UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get()
        ):
            above = [each for each in prim.GetPath().GetAncestorsRange() if each in bodies]
            body, frame = bodies[above[-1]] if above else (spec.worldbody, Gf.Matrix4d(1.0))
            geom = _add_collider(spec, body, prim, place * frame.GetInverse())
            _fill(geom, prim, stage.GetPrimAtPath(above[-1]) if above else None, units)
    model = spec.compile()
    for name, (mass, center) in weights.items():
        if mass or center is not None:
            body = spec.body(name)
            made = model.body(name)
            factor = mass / made.mass[0] if mass else 1.0
            body.mass = factor * made.mass[0]
            body.inertia = factor * made.inertia
            body.explicitinertial = True
            body.ipos = made.ipos if center is None else center
            body.iquat = made.iquat
    return spec.compile()


def _is_moved(body: Any) -> bool:
    return bool(body.GetRigidBodyEnabledAttr().Get()) and not body.GetKinematicEnabledAttr().Get()


def _put_frame(thing: Any, matrix: Any) -> None:
    """Gives a body or a geom the position and the orientation of a frame."""
    turn = matrix.RemoveScaleShear().ExtractRotationQuat()
    thing.pos = matrix.ExtractTranslation()
    thing.quat = (turn.GetReal(), *turn.GetImaginary())


class _Units(NamedTuple):
    """Of a stage, in metres and kilograms."""

    metre: float
    kilogram: float


def _weigh(body: mujoco.MjsBody, api: Any, units: _Units) -> tuple[float, np.ndarray | None]:
    """Gives a body its inertia where that is stated.

    Returns:
      Else the mass to which its colliders' is to be scaled, 0 where none is stated, and the centre of mass,
      metres, None likewise.
    """
    mass = (api.GetMassAttr().Get() or 0.0) * units.kilogram
    moments = api.GetDiagonalInertiaAttr().Get()
    stated = api.GetCenterOfMassAttr().Get()
    is_centred = stated is not None and bool(np.isfinite(stated).all())
    center = np.array(stated) * units.metre if is_centred else None
    if not (mass and moments and min(moments) > 0):
        return mass, center
    axes = api.GetPrincipalAxesAttr().Get()
    body.mass = mass
    body.explicitinertial = True
    body.inertia = np.array(moments) * units.kilogram * units.metre**2
    body.ipos = np.zeros(3) if center is None else center
    body.iquat = (axes.GetReal(), *axes.GetImaginary()) if axes.GetLength() else (1, 0, 0, 0)
    return 0.0, None


def _fill(geom: mujoco.MjsGeom, prim: Any, body: Any, units: _Units) -> None:
    """Gives a collider the mass or the density that it states, its body, or its material, in this order."""
    own = UsdPhysics.MassAPI(prim)
    if prim != body and prim.HasAPI(UsdPhysics.MassAPI) and (mass := own.GetMassAttr().Get()):
        geom.mass = mass * units.kilogram
        return
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    stated = [own.GetDensityAttr().Get()]
    stated += [UsdPhysics.MassAPI(body).GetDensityAttr().Get()] if body else []
    stated += [UsdPhysics.MaterialAPI(material).GetDensityAttr().Get()] if material else []
    density = next((each for each in stated if each), None)
    if density is not None:
        geom.density = density * units.kilogram / units.metre**3


def _add_collider(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, prim: Any, place: Any
) -> mujoco.MjsGeom:
    """A collider as a geom of a body, at `place` in its frame."""
    geom = body.add_geom(name=str(prim.GetPath()))
    kind = str(prim.GetTypeName())
    rigid = place.RemoveScaleShear()
    scale = np.abs(np.array(place * rigid.GetInverse())[:3, :3].diagonal())
    _put_frame(geom, rigid)
    if kind == "Cube":
        geom.type = _GEOM.mjGEOM_BOX
        geom.size = scale * UsdGeom.Cube(prim).GetSizeAttr().Get() / 2
    elif kind == "Plane":
        geom.type = _GEOM.mjGEOM_PLANE
        geom.size = (0, 0, 1)
    elif kind == "Mesh":
        _make_hull(spec, geom, geom.name, _hull_points(prim) * scale)
    elif kind == "Sphere" and np.ptp(scale) < 1e-6:
        radius = UsdGeom.Sphere(prim).GetRadiusAttr().Get()
        geom.type = _GEOM.mjGEOM_SPHERE
        geom.size = (radius * scale[0], 0, 0)
    elif kind in _ROUND_PRIMS and np.ptp(scale) < 1e-6:
        shape = getattr(UsdGeom, kind)(prim)
        axis, angle = _TURNS[shape.GetAxisAttr().Get()]
        _put_frame(geom, Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(axis), angle)) * rigid)
        radius = shape.GetRadiusAttr().Get()
        height = shape.GetHeightAttr().Get()
        geom.type = _ROUND_PRIMS[kind]
        geom.size = (radius * scale[0], height / 2 * scale[0], 0)
    else:
        allowed = (
            "cubes, planes, meshes, and spheres, capsules and cylinders that are not stretched"
        )
        raise AssetError(
            f"the collider {prim.GetPath()} is a {kind or 'prim without a type'}", allowed
        )
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    if (
        material
        and (friction := UsdPhysics.MaterialAPI(material).GetDynamicFrictionAttr().Get())
        is not None
    ):
        geom.friction = (friction, *geom.friction[1:])
    return geom


def _hull_points(prim: Any) -> np.ndarray:
    """f64[V, 3]: the points of a mesh that collides as its hull."""
    mesh = UsdGeom.Mesh(prim)
    approximation = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr()
    points = np.array(mesh.GetPointsAttr().Get() or (), np.float64).reshape(-1, 3)
    if len(points) < 4 or not np.isfinite(points).all():
        given = f"the collider {prim.GetPath()} is a mesh of {len(points)} points"
        raise AssetError(given, "meshes of 4 finite points or more")
    if approximation and approximation.Get() == "convexHull":
        return points
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or (), int)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get() or (), int)
    is_sound = len(counts) and counts.min() > 2 and counts.sum() == len(indices)
    if not is_sound or indices.min() < 0 or indices.max() >= len(points):
        given = f"the collider {prim.GetPath()} is a mesh whose faces do not fit its {len(points)} points"
        raise AssetError(given, "faces of 3 points or more, which are there")
    faces = np.split(indices, np.cumsum(counts)[:-1])
    fans = [(face[0], face[i], face[i + 1]) for face in faces for i in range(1, len(face) - 1)]
    a, b, c = points[np.array(fans)].transpose(1, 0, 2)
    hull = hull_of(points)
    if hull is None or abs((a * np.cross(b, c)).sum()) / 6 < _FILLED * hull.volume:
        allowed = "meshes that are convex or collide as their hull"
        raise AssetError(f"the collider {prim.GetPath()} is a mesh that is not convex", allowed)
    return points


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
    except (
        Exception
    ) as error:  # Damaged archives make NumPy, zipfile and zlib raise whatever they like.
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
