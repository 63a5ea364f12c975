"""USD with UsdPhysics: one file per object and one for the support, referenced by one stage per scene.

Metres, kilograms, z up. An object is a rigid body with a mass; its parts are undrawn meshes whose collider is
their convex hull, bound to a physics material; and it is a SimReady prop: folder, metadata, labels, picture.
This needs the optional extra `usd`.
"""

from __future__ import annotations

import datetime
import io
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import finish_name
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import write_images
from cluttergen_jax.assets.shading import linear, shade
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.assets.support import PART_RGBA, SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.scene import FixedCamera, Scene
from cluttergen_jax.scene.export.shapes import (
    SUPPORT_FOLDER,
    category,
    friction_of,
    identifiers,
    principal_of,
    shows_solids,
    usd_folder,
)
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import FARTHEST, RaySensor, sensed_model

_QCODE = "Q223557"
"""Wikidata's item for a physical object: true of everything, and no more is known."""
_MATERIAL = "unknown"
_SIZE = 256
_LIGHT = np.array([-0.4, -0.5, 0.77])
_FILL = 0.35
_VIEW = np.array([-0.6, -1.0, 0.7])


def metadata(asset: ObjectAsset) -> dict[str, object]:
    """The fields of its rules SR.001 and SR.004; metres, kilograms."""
    vertices = np.concatenate([piece.mesh.vertices for piece in asset.drawn_pieces])
    origin = asset.provenance
    return {
        "author": origin.attribution or origin.source or "unknown",
        "asset_name": asset.name,
        "asset_type": "prop",
        "asset_license": origin.licence or "not stated",
        "category": category(asset),
        "source_file": origin.source or "unknown",
        "usd_date_generated": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "qcode": _QCODE,
        "rigid_body_count": 1,
        "asset_extents": np.ptp(vertices, axis=0).tolist(),
        "mass": float(asset.mass),
    }


def thumbnail(asset: ObjectAsset) -> bytes:
    """A PNG of the object, cast by rays, so that it takes no display."""
    sensor = RaySensor(sensed_model([asset], None), surfaces=bool(asset.pieces))
    data = sensor.make_data()
    sensor.pose(data, np.array([[0, 0, 0, 1, 0, 0, 0]]))
    radius = float(
        np.linalg.norm(np.concatenate([p.mesh.vertices for p in asset.drawn_pieces]), axis=1).max()
    )
    eye = 4 * radius * _VIEW / np.linalg.norm(_VIEW)
    camera = Camera.looking(eye, np.zeros(3), _SIZE, _SIZE, 3.6 * _SIZE / 2)
    image = sensor.sense(data, camera)
    is_seen = image.geom >= 0
    points = camera.directions * np.where(is_seen, image.depth, FARTHEST)[..., None]
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    shade = np.abs(normals @ _LIGHT) / np.linalg.norm(normals, axis=-1)
    colours = sensor.model.geom_rgba.copy()
    if asset.pieces:
        colours[sensor.model.geom_contype == 0] = [piece.mean_rgba for piece in asset.pieces]
    rgba = colours[image.geom]
    rgba[..., :3] *= (_FILL + (1 - _FILL) * shade)[..., None]
    rgba[..., 3] = is_seen
    buffer = io.BytesIO()
    Image.fromarray((255 * rgba).clip(0, 255).astype(np.uint8), "RGBA").save(buffer, "PNG")
    return buffer.getvalue()


try:
    from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade, Vt
except ImportError:  # pragma: no cover - depends on what is installed
    Usd = None

_FOCAL_LENGTH = 24.0
_UV = "st"
"""USD's usual name of texture coordinates."""


def require_usd() -> None:
    """Raises MissingExtraError if usd-core is not installed."""
    if Usd is None:
        raise MissingExtraError("usd", "the format usd")


def write_object_usd(folder: Path, asset: ObjectAsset, contact: ContactConfig) -> None:
    """Writes `NAME.usda`: a rigid body in the object frame."""
    stage, root = _asset_stage(folder / f"{asset.name}.usda", asset.name)
    prim = root.GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    principal = principal_of(asset)
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(asset.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*principal.center.tolist()))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*principal.moments.tolist()))
    mass.CreatePrincipalAxesAttr(Gf.Quatf(*principal.turn.tolist()))
    _note(prim, asset.label, asset.provenance)
    _add_metadata(stage, metadata(asset))
    _add_label(prim, "class", category(asset))
    _add_label(prim, "wikidata_qcode", _QCODE)
    _add_visuals(stage, folder, asset.drawn_pieces, "./textures/")
    picture = folder / ".thumbs" / f"{_SIZE}x{_SIZE}" / f"{asset.name}.usda.png"
    picture.parent.mkdir(parents=True)
    picture.write_bytes(thumbnail(asset))
    material = _add_contact(stage, friction_of(asset, contact)[0], contact)
    for index, part in enumerate(asset.parts):
        _add_part(stage, f"{_collisions(stage)}/part_{index:02d}", part, material, contact)
    stage.GetRootLayer().Save()


def write_support_usd(folder: Path, support: SupportAsset, contact: ContactConfig) -> None:
    """Writes `support.usda`: static colliders in the world frame, and surfaces where there are any."""
    stage, root = _asset_stage(folder / "support.usda", "support")
    _note(root.GetPrim(), support.label, support.provenance)
    _add_visuals(stage, folder, support.pieces)
    material = _add_contact(stage, contact.friction[0], contact)
    is_drawn = shows_solids(support)
    parent = f"{_root(stage)}/boxes" if is_drawn else _collisions(stage)
    for index, box in enumerate(support.boxes):
        cube = UsdGeom.Cube.Define(stage, f"{parent}/box_{index:02d}")
        cube.CreateSizeAttr(2.0)
        cube.CreateExtentAttr([(-1, -1, -1), (1, 1, 1)])
        _place(cube, np.array(box.center), np.array(yaw_quaternion(box.yaw)))
        cube.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*box.half_extents))
        cube.CreateDisplayColorAttr([Gf.Vec3f(*linear(box.rgba)[:3])])
        if is_drawn:
            _bind(cube.GetPrim(), _material(stage, Piece(box.mesh, box.rgba)))
        _make_collider(cube.GetPrim(), material, contact)
    for index, part in enumerate(support.parts):
        prim = _add_part(stage, f"{parent}/part_{index:02d}", part, material, contact)
        if is_drawn:
            _bind(prim, _material(stage, Piece(part, PART_RGBA)))
    stage.GetRootLayer().Save()


def write_scene_usd(path: Path, scene: Scene) -> None:
    """Writes the stage of a scene into `scenes/`; it refers to the files of its objects."""
    stage = _new_stage(path)
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    physics = UsdPhysics.Scene.Define(stage, "/World/physics")
    physics.CreateGravityDirectionAttr(Gf.Vec3f(0, 0, -1))
    physics.CreateGravityMagnitudeAttr(scene.contact.gravity)
    UsdLux.DomeLight.Define(stage, "/World/lights/dome").CreateIntensityAttr(400.0)
    sun = UsdLux.DistantLight.Define(stage, "/World/lights/sun")
    sun.CreateIntensityAttr(1500.0)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(35, 15, 0))
    support = UsdGeom.Xform.Define(stage, "/World/support").GetPrim()
    support.GetReferences().AddReference(f"../{SUPPORT_FOLDER}/support.usda")
    UsdGeom.Xform.Define(stage, "/World/objects")
    names = identifiers(scene.names)
    for name, own, asset, pose in zip(scene.names, names, scene.objects, scene.poses, strict=True):
        body = UsdGeom.Xform.Define(stage, f"/World/objects/{own}")
        body.GetPrim().SetDisplayName(name)
        body.GetPrim().GetReferences().AddReference(f"../{usd_folder(asset)}/{asset.name}.usda")
        _place(body, pose[:3], pose[3:])
    for each in scene.cameras:
        _add_camera(stage, each)
    stage.GetRootLayer().Save()


def _add_camera(stage: Any, camera: FixedCamera) -> None:
    """USD's own cameras look along -z too; apertures and focal length are of the same unit."""
    prim = UsdGeom.Camera.Define(stage, f"/World/cameras/{camera.name}")
    _place(prim, camera.position, camera.quaternion)
    prim.CreateFocalLengthAttr(_FOCAL_LENGTH)
    prim.CreateHorizontalApertureAttr(2 * _FOCAL_LENGTH * np.tan(np.radians(camera.fovx) / 2))
    prim.CreateVerticalApertureAttr(2 * _FOCAL_LENGTH * np.tan(np.radians(camera.fovy) / 2))
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01, 100.0))


def _new_stage(path: Path) -> Any:
    path.parent.mkdir(parents=True, exist_ok=True)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    return stage


def _asset_stage(path: Path, name: str) -> tuple[Any, Any]:
    stage = _new_stage(path)
    root = UsdGeom.Xform.Define(stage, f"/{Tf.MakeValidIdentifier(name)}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind("component")
    return stage, root


def _root(stage: Any) -> str:
    return str(stage.GetDefaultPrim().GetPath())


def _collisions(stage: Any) -> str:
    """The path below which colliders stand that are not drawn."""
    path = f"{_root(stage)}/collisions"
    if not stage.GetPrimAtPath(path):
        UsdGeom.Xform.Define(stage, path).CreatePurposeAttr(UsdGeom.Tokens.guide)
    return path


def _note(prim: Any, label: str, provenance: Any) -> None:
    prim.SetDisplayName(label)
    prim.SetCustomDataByKey("licence", provenance.licence)
    prim.SetCustomDataByKey("source", provenance.source)
    prim.SetCustomDataByKey("attribution", provenance.attribution)


def _place(xformable: Any, position: np.ndarray, quaternion: np.ndarray) -> None:
    double = UsdGeom.XformOp.PrecisionDouble
    xformable.AddTranslateOp(double).Set(Gf.Vec3d(*position.tolist()))
    xformable.AddOrientOp(double).Set(Gf.Quatd(*quaternion.tolist()))


def _add_metadata(stage: Any, fields: dict[str, Any]) -> None:
    """In the layer, and once more in a dictionary, since rules of different versions look in either."""
    fields = fields | {"asset_extents": Gf.Vec3f(*fields["asset_extents"])}
    stage.GetRootLayer().customLayerData = fields | {"SimReady_Metadata": fields}


def _add_label(prim: Any, taxonomy: str, label: str) -> None:
    """Labels need no schema to be read, and older USD has none for them."""
    prim.AddAppliedSchema(f"SemanticsLabelsAPI:{taxonomy}")
    kind = Sdf.ValueTypeNames.TokenArray
    prim.CreateAttribute(f"semantics:labels:{taxonomy}", kind, custom=False).Set([label])


def _add_visuals(stage: Any, folder: Path, pieces: Sequence[Piece], place: str = "") -> None:
    """Adds surfaces, and writes their images to a place within the folder."""
    write_images(folder / place, [image for each in pieces for image in each.images])
    for index, piece in enumerate(pieces):
        mesh = _add_mesh(stage, f"{_root(stage)}/visuals/piece_{index:02d}", piece.mesh, piece.uv)
        mesh.CreateDisplayColorAttr([Gf.Vec3f(*linear(piece.mean_rgba)[:3])])
        mesh.CreateDisplayOpacityAttr([piece.rgba[3]])
        _bind(mesh.GetPrim(), _material(stage, piece, place))


def _add_mesh(stage: Any, path: str, mesh: Mesh, uv: np.ndarray | None = None) -> Any:
    vertices, normals, faces, places = shade(mesh, uv)
    result = UsdGeom.Mesh.Define(stage, path)
    result.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
    result.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    result.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel().astype(np.int32)))
    result.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
    result.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    if places is not None:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        primvar = UsdGeom.PrimvarsAPI(result).CreatePrimvar(_UV, kind, UsdGeom.Tokens.vertex)
        primvar.Set(Vt.Vec2fArray.FromNumpy(places))
    result.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    result.CreateDoubleSidedAttr(True)
    result.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([vertices.min(0), vertices.max(0)])))
    return result


def _add_part(stage: Any, path: str, part: Mesh, material: Any, contact: ContactConfig) -> Any:
    """A collider that is the convex hull of a part."""
    prim = _add_mesh(stage, path, part.hull()).GetPrim()
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr("convexHull")
    prim.AddAppliedSchema("NewtonMeshCollisionAPI")
    _make_collider(prim, material, contact)
    return prim


def _material(stage: Any, piece: Piece, place: str = "") -> Any:
    """The material of a piece: its colour, times its image if there is one, and its finish; made once.

    Args:
      place: where the images are.
    """
    finish = piece.finish or Finish()
    name = "colour_" + "_".join(f"{round(255 * value):03d}" for value in piece.rgba)
    if piece.finish is not None:
        name += "_" + Tf.MakeValidIdentifier(finish_name(piece))
    elif piece.texture is not None:
        name += "_" + Tf.MakeValidIdentifier(PurePosixPath(piece.texture.file_name).stem)
    path = f"{_root(stage)}/materials/{name}"
    if existing := UsdShade.Material.Get(stage, path):
        return existing
    UsdGeom.Scope.Define(stage, f"{_root(stage)}/materials")
    material = UsdShade.Material.Define(stage, path)
    _add_label(material.GetPrim(), "material", _MATERIAL)
    shader = UsdShade.Shader.Define(stage, f"{path}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    red, green, blue, alpha = linear(piece.rgba)
    diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if piece.texture is None:
        diffuse.Set(Gf.Vec3f(red, green, blue))
    else:
        file = place + piece.texture.file_name
        image = _image(stage, f"{path}/image", file, (red, green, blue), is_colour=True)
        diffuse.ConnectToSource(image.ConnectableAPI(), "rgb")
    shader.CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(alpha)
    roughness = shader.CreateInput("roughness", Sdf.ValueTypeNames.Float)
    metallic = shader.CreateInput("metallic", Sdf.ValueTypeNames.Float)
    if finish.orm is None:
        roughness.Set(finish.roughness)
        metallic.Set(finish.metallic)
    else:
        factors = (1.0, finish.roughness, finish.metallic)
        image = _image(stage, f"{path}/orm", place + finish.orm.file_name, factors)
        for share, channel in ((roughness, "g"), (metallic, "b")):
            image.CreateOutput(channel, Sdf.ValueTypeNames.Float)
            share.ConnectToSource(image.ConnectableAPI(), channel)
    if finish.normal is not None:
        image = _image(stage, f"{path}/normal", place + finish.normal.file_name, (2.0, 2.0, 2.0))
        image.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        bumps = shader.CreateInput("normal", Sdf.ValueTypeNames.Normal3f)
        bumps.ConnectToSource(image.ConnectableAPI(), "rgb")
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def _image(
    stage: Any, path: str, image: str, factor: tuple[float, float, float], is_colour: bool = False
) -> Any:
    """The shader at `path` that reads an image, multiplied by three numbers; the reader of uv is beside it.

    Args:
      is_colour: whether it is a picture in sRGB, else its values are taken as they are.
    """
    reader = UsdShade.Shader.Define(stage, f"{path.rpartition('/')[0]}/uv")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set(_UV)
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture = UsdShade.Shader.Define(stage, path)
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(image))
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set(
        "sRGB" if is_colour else "raw"
    )
    for side in ("wrapS", "wrapT"):
        texture.CreateInput(side, Sdf.ValueTypeNames.Token).Set("repeat")
    texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*factor, 1.0))
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
        reader.ConnectableAPI(), "result"
    )
    texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    return texture


def _bind(prim: Any, material: Any) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _add_contact(stage: Any, sliding: float, contact: ContactConfig) -> Any:
    UsdGeom.Scope.Define(stage, f"{_root(stage)}/materials")
    material = UsdShade.Material.Define(stage, f"{_root(stage)}/materials/contact")
    _add_label(material.GetPrim(), "material", _MATERIAL)
    physics = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    physics.CreateStaticFrictionAttr(sliding)
    physics.CreateDynamicFrictionAttr(sliding)
    physics.CreateRestitutionAttr(0.0)
    if sliding != contact.friction[0]:
        # PhysX takes the mean of two coefficients unless one asks for more. Its schema is not part of USD.
        material.GetPrim().AddAppliedSchema("PhysxMaterialAPI")
        mode = material.GetPrim().CreateAttribute(
            "physxMaterial:frictionCombineMode", Sdf.ValueTypeNames.Token, custom=False
        )
        mode.Set("min" if sliding < contact.friction[0] else "max")
    return material


def _make_collider(prim: Any, material: Any, contact: ContactConfig) -> None:
    """A collider with the words of MuJoCo's and Newton's own schemas, which are no part of USD."""
    UsdPhysics.CollisionAPI.Apply(prim)
    for schema in ("MjcCollisionAPI", "NewtonCollisionAPI"):
        prim.AddAppliedSchema(schema)
    numbers = Sdf.ValueTypeNames.DoubleArray
    for name, kind, value in (
        ("condim", Sdf.ValueTypeNames.Int, contact.condim),
        ("solref", numbers, Vt.DoubleArray(contact.solref)),
        ("solimp", numbers, Vt.DoubleArray(contact.solimp)),
    ):
        uniform = Sdf.VariabilityUniform
        prim.CreateAttribute(f"mjc:{name}", kind, False, uniform).Set(value)
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
