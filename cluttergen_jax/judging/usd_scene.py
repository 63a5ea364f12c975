"""A USD stage with UsdPhysics as a MuJoCo model: free rigid bodies, and static colliders."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.errors import AssetError, ClutterGenError, MissingExtraError

try:
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade
except ImportError:  # pragma: no cover - depends on what is installed
    Usd = None

_GEOM = mujoco.mjtGeom
_TURNS = {"X": ((0, 1, 0), 90), "Y": ((1, 0, 0), -90), "Z": ((0, 0, 1), 0)}
_ROUND = {"Capsule": _GEOM.mjGEOM_CAPSULE, "Cylinder": _GEOM.mjGEOM_CYLINDER}
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
            _put(body, place)
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


def _put(thing: Any, matrix: Any) -> None:
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
    _put(geom, rigid)
    if kind == "Cube":
        geom.type = _GEOM.mjGEOM_BOX
        geom.size = scale * UsdGeom.Cube(prim).GetSizeAttr().Get() / 2
    elif kind == "Plane":
        geom.type = _GEOM.mjGEOM_PLANE
        geom.size = (0, 0, 1)
    elif kind == "Mesh":
        mesh = spec.add_mesh(name=geom.name)
        mesh.uservert = (_hull_points(prim) * scale).astype(np.float32).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom.type = _GEOM.mjGEOM_MESH
        geom.meshname = mesh.name
    elif kind == "Sphere" and np.ptp(scale) < 1e-6:
        radius = UsdGeom.Sphere(prim).GetRadiusAttr().Get()
        geom.type = _GEOM.mjGEOM_SPHERE
        geom.size = (radius * scale[0], 0, 0)
    elif kind in _ROUND and np.ptp(scale) < 1e-6:
        shape = getattr(UsdGeom, kind)(prim)
        axis, angle = _TURNS[shape.GetAxisAttr().Get()]
        _put(geom, Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(axis), angle)) * rigid)
        radius = shape.GetRadiusAttr().Get()
        height = shape.GetHeightAttr().Get()
        geom.type = _ROUND[kind]
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
