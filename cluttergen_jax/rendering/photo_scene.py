"""A compiled model as scenes of Mitsuba: its surfaces with their materials, a look's walls and light.

Surfaces come three times: as they reflect light, and as what guides the removal of noise, which shine by
themselves in their colour or in the colour of their direction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh

from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.shading import Shaded, linear, shade
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.rendering.config import PhotoConfig
from cluttergen_jax.rendering.furnish import covering_texture
from cluttergen_jax.rendering.lighting import lamp_direction
from cluttergen_jax.rendering.look import Covering, Look, Sky
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.sensing.camera import Camera

_MAX_DEPTH = 14
"""Bounces of a path: glass before glass takes two for each side."""
_ROULETTE_DEPTH = 3
"""Bounces from which on dim paths may end, so that the mean stays what it is."""
_OPAQUE = 0.99
_SMOOTHEST = 0.05
"""Of rough surfaces: smoother ones are as bright as their lamps in single pixels."""
_ROUGHNESS = 0.45
"""Of surfaces whose file says nothing: painted things, wood, cardboard."""
_MATTE = 0.6
_FROSTED = 0.2
"""Roughness from which glass blurs what is behind it."""
# Metres: from the camera to the wall behind it; the height of walls; half a side of what has no end.
_BEHIND = 0.4
_WALL = 2.7
_ENDLESS = 30.0
_SPOT = 1e-4
"""Sides of triangles on an image, along which maps of normals are turned."""
_FULL_FRAME = 0.036
"""Metres: the width of a film that f-numbers are meant for."""
_ROLES = {
    "rgb": mujoco.mjtTextureRole.mjTEXROLE_RGB,
    "normal": mujoco.mjtTextureRole.mjTEXROLE_NORMAL,
    "orm": mujoco.mjtTextureRole.mjTEXROLE_ORM,
}
_PRIMITIVES = {
    mujoco.mjtGeom.mjGEOM_BOX: lambda size: trimesh.creation.box(2 * size),
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda size: trimesh.creation.icosphere(4, size[0]),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: lambda size: trimesh.creation.icosphere(4).apply_scale(size),
    mujoco.mjtGeom.mjGEOM_CYLINDER: lambda size: trimesh.creation.cylinder(
        size[0], 2 * size[1], 64
    ),
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda size: trimesh.creation.capsule(2 * size[1], size[0]),
}
_PLAIN = Look(
    about="no look: a grey floor without end",
    top=Covering("paint"),
    frame=Covering("paint"),
    floor=Covering("paint"),
)


class _Material(NamedTuple):
    """What Mitsuba is told of a surface: how it reflects, and its colour alone."""

    surface: dict[str, Any]
    albedo: Any


class _Surface(NamedTuple):
    """A surface in the world.

    Attributes:
      make: makes a shape of Mitsuba that has a `bsdf` or an `emitter`.
      material: what it is of. direction: of its normals, as colours in [0, 1].
    """

    make: Callable[..., Any]
    material: _Material
    direction: dict[str, Any]


class LoadedScene(NamedTuple):
    """Scenes of Mitsuba that a photo is made of.

    Attributes:
      lit: surfaces as they reflect light; lamps and sky are not seen directly.
      albedo, direction: the same surfaces as they guide the removal of noise.
      sky: what is seen where there is no surface.
    """

    lit: Any
    albedo: Any
    direction: Any
    sky: Any


class PhotoScene:
    """Makes Mitsuba's scenes of a model as it stands; images are loaded once.

    Args:
      look: whose walls and light there are; None has a grey floor without end.
      photo: what is left out, and the lens.
    """

    def __init__(self, model: mujoco.MjModel, look: Look | None, photo: PhotoConfig) -> None:
        self._model = model
        self._look = look or _PLAIN
        self._photo = photo
        self._shaded: dict[int, Shaded] = {}
        self._images: dict[tuple[Any, ...], Any] = {}

    def load(
        self,
        data: mujoco.MjData,
        camera: Camera,
        rows: int,
        alpha: np.ndarray | None,
        trails: Sequence[Trail],
        light_yaw: float,
    ) -> LoadedScene:
        """Mitsuba's scenes of all that is seen now.

        Args:
          rows: of the picture.
          alpha: f[nbody], the opacity of each body; None draws all.
          trails: lines to draw as well.
          light_yaw: radians by which light is turned about the vertical.
        """
        import mitsuba as mi

        surfaces = list(self._surfaces(data, camera, alpha, trails))
        sensor = _sensor(camera, rows, self._photo, self._model.stat.center)
        path = {
            "type": "path",
            "max_depth": _MAX_DEPTH,
            "rr_depth": _ROULETTE_DEPTH,
            "hide_emitters": True,
        }
        guide = {"type": "path", "max_depth": 1}
        lit = {
            f"surface-{number}": each.make(bsdf=each.material.surface)
            for number, each in enumerate(surfaces)
        }
        light = self._light(camera, light_yaw)
        albedo: dict[str, Any] = {}
        direction: dict[str, Any] = {}
        for number, each in enumerate(surfaces):
            for shown, colour in ((albedo, each.material.albedo), (direction, each.direction)):
                shown[f"surface-{number}"] = each.make(emitter={"type": "area", "radiance": colour})
        first, *others = (
            mi.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor} | shapes)
            for integrator, shapes in (
                (path, lit | light),
                (guide, albedo),
                (guide, direction),
                (guide, {"sky": light["sky"]}),
            )
        )
        return LoadedScene(first, *others)

    def _surfaces(
        self,
        data: mujoco.MjData,
        camera: Camera,
        alpha: np.ndarray | None,
        trails: Sequence[Trail],
    ) -> Iterator[_Surface]:
        model = self._model
        is_drawn = model.geom_group == VISUAL_GROUP
        if self._photo.is_cut_out:
            is_drawn &= model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        for geom in np.flatnonzero(is_drawn).tolist():
            opacity = 1.0 if alpha is None else float(alpha[model.geom_bodyid[geom]])
            if opacity > 0:
                yield self._geom(data, geom, opacity)
        for trail in trails:
            colour = _colour(trail.rgb)
            surface = {"type": "diffuse", "reflectance": colour}
            yield _body(_tube(trail), _Material(_with_opacity(surface, trail.alpha), colour))
        if self._look.wall is not None and not self._photo.is_cut_out:
            yield from self._walls(self._look.wall, self._room(camera))

    def _geom(self, data: mujoco.MjData, geom: int, opacity: float) -> _Surface:
        model = self._model
        turn = data.geom_xmat[geom].reshape(3, 3)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            size = np.where(model.geom_size[geom, :2] > 0, model.geom_size[geom, :2], _ENDLESS)
            material = self._material(geom, opacity, size)
            return _rectangle(data.geom_xpos[geom], turn, size, material)
        if geom not in self._shaded:
            self._shaded[geom] = shade_geom(model, geom)
        shaded = self._shaded[geom]
        placed = shaded._replace(
            vertices=shaded.vertices @ turn.T + data.geom_xpos[geom],
            normals=shaded.normals @ turn.T,
        )
        return _body(placed, self._material(geom, opacity))

    def _material(self, geom: int, opacity: float, size: np.ndarray | None = None) -> _Material:
        """What a geom is of; of a plane with its half sides f[2], metres."""
        model = self._model
        number = model.geom_matid[geom]
        rgba = model.geom_rgba[geom].astype(float)
        roughness = metallic = -1.0
        images = dict.fromkeys(_ROLES, -1)
        tiling = _Tiling()
        if number >= 0:
            if np.allclose(rgba, (0.5, 0.5, 0.5, 1.0), atol=1e-6):
                rgba = model.mat_rgba[number].astype(float)
            images = {name: int(model.mat_texid[number, role]) for name, role in _ROLES.items()}
            roughness = float(model.mat_roughness[number])
            metallic = float(model.mat_metallic[number])
            u, v = model.mat_texrepeat[number].tolist()
            tiling = _Tiling(u, v)
            if size is not None:
                # MuJoCo lays the image's middle on the plane's, and counts by two metres.
                tiling = _rectangle_tiling(2 * size, 2 / u, foot=0.5 + size[1] * v / 2)
        is_clear = rgba[3] < _OPAQUE
        if is_clear and images["rgb"] < 0:
            return _Material(_with_opacity(_glass(rgba, roughness), opacity), _colour(np.ones(3)))
        colour = _colour(rgba[:3])
        if images["rgb"] >= 0:
            colour = self._image(images["rgb"], tiling, rgba[:3])
        surface = _opaque_surface(colour, _ROUGHNESS if roughness < 0 else roughness, metallic)
        if images["orm"] >= 0:
            # A map multiplies both, which are 1 where nothing else is said.
            numbers = {"roughness": abs(roughness), "metallic": abs(metallic)}
            surface = _opaque_surface(colour, 0.0, 1.0)
            for channel, (name, value) in enumerate(numbers.items(), 1):
                factor = value * np.eye(3)[channel]
                surface[name] = self._image(images["orm"], tiling, factor, is_raw=True)
        if images["normal"] >= 0:
            normal = self._image(images["normal"], tiling, np.ones(3), is_raw=True)
            surface = {"type": "normalmap", "normalmap": normal, "nested": surface}
        opacity *= rgba[3] if is_clear else 1.0
        return _Material(_with_opacity({"type": "twosided", "nested": surface}, opacity), colour)

    def _image(self, number: int, tiling: _Tiling, factor: np.ndarray, is_raw: bool = False) -> Any:
        """Mitsuba's texture of one of the model's, times f[3].

        Args:
          is_raw: its values are no colours; of a factor with one channel above 0 that channel alone.
        """
        import mitsuba as mi

        key = (number, tiling, *np.round(factor, 4).tolist(), is_raw)
        if key not in self._images:
            pixels = texture_pixels(self._model, number) * factor
            if is_raw and np.count_nonzero(factor) == 1:
                pixels = pixels[..., factor > 0]
            bitmap = mi.Bitmap(np.round(pixels).astype(np.uint8))
            place = tiling.transform
            texture = {"type": "bitmap", "bitmap": bitmap, "raw": is_raw, "to_uv": place}
            self._images[key] = mi.load_dict(texture)
        return self._images[key]

    def _room(self, camera: Camera) -> float:
        """Metres from the middle to each wall: the camera stands in the room."""
        away = float(np.linalg.norm(camera.eye[:2] - self._model.stat.center[:2]))
        return max(self._look.room, away + _BEHIND)

    def _walls(self, wall: Covering, room: float) -> Iterator[_Surface]:
        """Four walls around the middle, which look inwards."""
        import mitsuba as mi

        pixels = np.asarray(covering_texture(wall).image).copy()
        tiling = _rectangle_tiling(np.array([2 * room, _WALL]), wall.tile, foot=1.0)
        image = mi.load_dict(
            {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "to_uv": tiling.transform}
        )
        surface = _opaque_surface(image, wall.roughness, wall.metallic)
        center = self._model.stat.center
        for number in range(4):
            turn = yaw_matrix(number * math.pi / 2)
            place = np.array([*center[:2], _WALL / 2]) + turn @ [0.0, room, 0.0]
            # Its x runs along the wall, its y upwards, its z into the room.
            upright = turn @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
            size = np.array([room, _WALL / 2])
            yield _rectangle(place, upright, size, _Material(surface, image))

    def _light(self, camera: Camera, yaw: float) -> dict[str, Any]:
        """Lamps and the sky, by name.

        Args:
          yaw: radians by which they are turned about the vertical.
        """
        import mitsuba as mi

        look = self._look
        center = self._model.stat.center
        found: dict[str, Any] = {}
        room = self._room(camera)
        for number, lamp in enumerate(look.lamps):
            direction = yaw_matrix(yaw) @ lamp_direction(lamp)
            across = float(np.linalg.norm(direction[:2]))
            inside = (
                (room - _BEHIND / 2) / across if look.wall is not None and across > 0 else np.inf
            )
            distance = min(lamp.distance, inside)
            place = center + distance * direction
            transform = mi.ScalarTransform4f().look_at(
                origin=place.tolist(), target=center.tolist(), up=[0.0, 0.01, 1.0]
            )
            radiance = look.exposure * lamp.strength * math.pi * (distance / lamp.size) ** 2
            found[f"lamp-{number}"] = {
                "type": "rectangle",
                "to_world": transform @ mi.ScalarTransform4f().scale([lamp.size / 2] * 2 + [1]),
                "emitter": {"type": "area", "radiance": _radiance(lamp.colour, radiance)},
            }
        sky = look.sky
        strength = look.exposure * sky.strength
        if sky.image:
            turned = mi.ScalarTransform4f().rotate([0, 0, 1], sky.turn + math.degrees(yaw))
            upright = turned @ mi.ScalarTransform4f().rotate([1, 0, 0], 90)
            found["sky"] = {
                "type": "envmap",
                "bitmap": _panorama(sky),
                "scale": strength,
                "to_world": upright,
            }
        else:
            found["sky"] = {"type": "constant", "radiance": _radiance(sky.colour, strength)}
        return found


def shade_geom(model: mujoco.MjModel, geom: int) -> Shaded:
    """A geom's surface with normals, in the geom's frame; no plane.

    Raises:
      ConfigError: it is of a kind that has no surface here, such as a height field.
    """
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        kind = mujoco.mjtGeom(model.geom_type[geom])
        if kind not in _PRIMITIVES:
            raise ConfigError(
                f"a photo of {model.geom(geom).name!r}, of type {kind.name}",
                "meshes, planes, boxes, spheres, ellipsoids, cylinders and capsules",
                "quality 'fine'",
            )
        body = _PRIMITIVES[kind](model.geom_size[geom].copy())
        return shade(Mesh(np.array(body.vertices), np.array(body.faces)))
    number = model.geom_dataid[geom]
    start = model.mesh_vertadr[number]
    points = model.mesh_vert[start : start + model.mesh_vertnum[number]]
    rows = slice(
        model.mesh_faceadr[number], model.mesh_faceadr[number] + model.mesh_facenum[number]
    )
    faces = model.mesh_face[rows]
    place = model.mesh_texcoordadr[number]
    if place < 0:
        return shade(Mesh(points, faces))
    # A corner's place in the image; v runs down it, as Mitsuba's does.
    corner = model.mesh_facetexcoord[rows].ravel()
    uv = model.mesh_texcoord[place + corner].astype(np.float64)
    uv += _uv_offsets(uv.reshape(-1, 3, 2)).reshape(-1, 2)
    return shade(Mesh(points[faces.ravel()], np.arange(3 * len(faces)).reshape(-1, 3)), uv)


def _uv_offsets(uv: np.ndarray) -> np.ndarray:
    """f64[F, 3, 2]: what keeps triangles of one spot of an image from having no direction along it."""
    sides = uv[:, 1:] - uv[:, :1]
    is_spot = np.abs(np.linalg.det(sides)) < _SPOT**2 / 100
    corners = _SPOT * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    return np.where(is_spot[:, None, None], corners, 0.0)


def texture_pixels(model: mujoco.MjModel, number: int) -> np.ndarray:
    """u8[height, width, 3] of one of a model's textures."""
    height = model.tex_height[number]
    width = model.tex_width[number]
    channels = model.tex_nchannel[number]
    start = model.tex_adr[number]
    pixels = model.tex_data[start : start + height * width * channels]
    return np.asarray(pixels.reshape(height, width, channels)[..., :3])


class _Tiling(NamedTuple):
    """How an image lies on a surface: its coordinates there, times and plus these."""

    u_scale: float = 1.0
    v_scale: float = 1.0
    u_offset: float = 0.0
    v_offset: float = 0.0

    @property
    def transform(self) -> Any:
        """As Mitsuba takes it."""
        import mitsuba as mi

        place = mi.ScalarTransform4f().translate([self.u_offset, self.v_offset, 0])
        return place @ mi.ScalarTransform4f().scale([self.u_scale, self.v_scale, 1])


def _rectangle_tiling(sides: np.ndarray, tile: float, foot: float) -> _Tiling:
    """An image that comes again every `tile` metres on a rectangle of sides f[2], upright from its front.

    Args:
      foot: the height in the image, from 0 above to 1 below, that lies on the rectangle's lower edge.
    """
    u, v = sides / tile
    return _Tiling(u, -v, 0.5 - u / 2, foot)


def _rectangle(
    place: np.ndarray, turn: np.ndarray, size: np.ndarray, material: _Material
) -> _Surface:
    """A rectangle whose middle is at f[3], turned by f[3, 3], with half sides f[2], metres, facing z."""
    import mitsuba as mi

    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = place
    transform = mi.ScalarTransform4f(pose) @ mi.ScalarTransform4f().scale([*size, 1])
    direction = {"type": "rgb", "value": (0.5 + 0.5 * turn[:, 2]).tolist()}
    return _Surface(
        lambda **looks: {"type": "rectangle", "to_world": transform} | looks, material, direction
    )


_DIRECTION = "vertex_direction"


def _body(shaded: Shaded, material: _Material) -> _Surface:
    return _Surface(
        partial(_mesh, shaded), material, {"type": "mesh_attribute", "name": _DIRECTION}
    )


def _mesh(shaded: Shaded, **looks: dict[str, Any]) -> Any:
    """Mitsuba's mesh with a `bsdf` or an `emitter`."""
    import mitsuba as mi

    properties = mi.Properties()
    for name, value in looks.items():
        properties[f"mesh_{name}"] = mi.load_dict(value)
    mesh = mi.Mesh(
        "surface",
        len(shaded.vertices),
        len(shaded.faces),
        properties,
        has_vertex_normals=True,
        has_vertex_texcoords=shaded.uv is not None,
    )
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = np.ravel(shaded.vertices).astype(np.float32)
    fields["vertex_normals"] = np.ravel(shaded.normals).astype(np.float32)
    fields["faces"] = np.ravel(shaded.faces).astype(np.uint32)
    if shaded.uv is not None:
        fields["vertex_texcoords"] = np.ravel(shaded.uv).astype(np.float32)
    fields.update()
    mesh.add_attribute(_DIRECTION, 3, np.ravel(0.5 + 0.5 * shaded.normals).astype(np.float32))
    return mesh


def _tube(trail: Trail) -> Shaded:
    parts = []
    for pair in itertools.pairwise(trail.points):
        body = trimesh.creation.cylinder(trail.radius, segment=np.array(pair), sections=12)
        parts.append(Mesh(np.array(body.vertices), np.array(body.faces)))
    joined = join_meshes(parts)
    return shade(joined)


def _with_opacity(surface: dict[str, Any], opacity: float) -> dict[str, Any]:
    if opacity >= _OPAQUE:
        return surface
    return {"type": "mask", "opacity": opacity, "nested": surface}


def _colour(rgb: Sequence[float] | np.ndarray) -> dict[str, Any]:
    """A colour as shown (sRGB)."""
    return {"type": "rgb", "value": list(linear([*np.clip(rgb, 0, 1), 1.0])[:3])}


def _opaque_surface(colour: Any, roughness: float, metallic: float) -> dict[str, Any]:
    """What lets no light through; what is matte is traced in less time."""
    if roughness >= _MATTE and metallic <= 0:
        return {"type": "diffuse", "reflectance": colour}
    return {
        "type": "principled",
        "base_color": colour,
        "roughness": max(roughness, _SMOOTHEST),
        "metallic": max(metallic, 0.0),
        "specular": 0.5,
    }


def _glass(rgba: np.ndarray, roughness: float) -> dict[str, Any]:
    """Clear or frosted glass, tinted the more the more opaque it is drawn elsewhere."""
    tint = 1 - (1 - np.clip(rgba[:3], 0, 1)) * rgba[3] * 0.5
    glass = {"type": "dielectric", "int_ior": 1.45, "specular_transmittance": _colour(tint)}
    if roughness > _FROSTED:
        glass |= {"type": "roughdielectric", "alpha": roughness**2}
    return glass


def _sensor(camera: Camera, rows: int, photo: PhotoConfig, center: np.ndarray) -> dict[str, Any]:
    """Mitsuba's camera, focused on a point f64[3]."""
    import mitsuba as mi

    # Mitsuba's camera looks along +z with +x to the left and +y up.
    place = camera.T_world_camera @ np.diag([-1.0, -1.0, 1.0, 1.0])
    K = camera.K
    # Of the picture's sides: how far the optical axis is from its middle.
    away = np.array([K[0, 2] / camera.width, K[1, 2] / camera.height]) - 0.5
    lens: dict[str, Any] = {
        "type": "perspective",
        "principal_point_offset_x": -float(away[0]),
        "principal_point_offset_y": -float(away[1]),
    }
    if photo.f_number is not None:
        if np.abs(away * [camera.width, camera.height]).max() > 1:
            raise ConfigError(
                "depth_of_field with a camera whose axis is not in the picture's middle",
                "one whose axis is",
                "a photo without depth_of_field",
            )
        focal = _FULL_FRAME * K[0, 0] / camera.width
        lens = {
            "type": "thinlens",
            "aperture_radius": focal / photo.f_number / 2,
            "focus_distance": float(camera.rotation[:, 2] @ (center - camera.eye)),
        }
    return {
        **lens,
        "fov_axis": "x",
        "fov": math.degrees(2 * math.atan(camera.width / 2 / K[0, 0])),
        "near_clip": 0.005,
        "to_world": mi.ScalarTransform4f(place),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": rows,
            "pixel_format": "rgba",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def _panorama(sky: Sky) -> Any:
    import mitsuba as mi

    try:
        bitmap = mi.Bitmap(sky.image)
    except RuntimeError as error:
        raise AssetError(f"a sky's image that cannot be decoded: {sky.image}") from error
    linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    pixels = np.asarray(linear) * np.array(_radiance(sky.colour, 1.0)["value"], np.float32)
    return mi.Bitmap(np.ascontiguousarray(pixels, np.float32))


def _radiance(colour: Sequence[float], strength: float) -> dict[str, Any]:
    """Radiance of a colour, sRGB, whose strongest channel is made as bright as the strength."""
    value = strength * np.array(linear([*colour, 1.0])[:3]) / max(max(colour), 1e-3)
    return {"type": "rgb", "value": value.tolist()}
