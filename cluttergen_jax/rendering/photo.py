"""Pictures like photographs: path tracing by Mitsuba 3, without noise by Intel's Open Image Denoise.

It takes the place of `renderer.Renderer`: surfaces, poses, colours, materials and images are those of the
model as it stands, and light is the look's. The extra `photo` installs both libraries.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from PIL import Image, ImageColor, ImageOps

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.assets.shading import Shaded, linear, shade
from cluttergen_jax.errors import AssetError, ConfigError, MissingExtraError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.config import PhotoConfig
from cluttergen_jax.rendering.furnish import covering_texture
from cluttergen_jax.rendering.lighting import lamp_direction
from cluttergen_jax.rendering.look import Covering, Look, Sky
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.sensing.camera import Camera

PER_PASS = 2
"""Paths of a pixel between two lines of progress, and between two places where Ctrl-C stops it."""
_MAX_DEPTH = 14
"""Bounces of a path: glass before glass takes two for each side."""
_OPAQUE = 0.99
_SMOOTHEST = 0.05
"""Of rough surfaces: smoother ones are as bright as their lamps in single pixels."""
# Metres: from the camera to the wall behind it; the height of walls.
_BEHIND = 0.4
_WALL = 2.7
_ENDLESS = 30.0
_ROUGHNESS = 0.45
"""Of surfaces whose file says nothing: painted things, wood, cardboard."""
_EXPOSED = 0.8
"""Brightness up to which a picture follows the light; what is brighter fades into white."""
_FROSTED = 0.2
"""Roughness from which glass blurs what is behind it."""
_ROLES = {
    "rgb": mujoco.mjtTextureRole.mjTEXROLE_RGB,
    "normal": mujoco.mjtTextureRole.mjTEXROLE_NORMAL,
    "orm": mujoco.mjtTextureRole.mjTEXROLE_ORM,
}
_FULL_FRAME = 0.036
"""Metres: the width of a film that f-numbers are meant for."""
_PRIMITIVES = {
    mujoco.mjtGeom.mjGEOM_BOX: lambda size: trimesh.creation.box(2 * size),
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda size: trimesh.creation.icosphere(4, size[0]),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: lambda size: trimesh.creation.icosphere(4).apply_scale(size),
    mujoco.mjtGeom.mjGEOM_CYLINDER: lambda size: trimesh.creation.cylinder(
        size[0], 2 * size[1], 64
    ),
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda size: trimesh.creation.capsule(2 * size[1], size[0]),
}


class PhotoRenderer:
    """See `open_photo_renderer`. The model's groups and colours may be changed between pictures."""

    def __init__(self, model: mujoco.MjModel, look: Look | None, photo: PhotoConfig) -> None:
        self.model = model
        self._look = look or _PLAIN
        self._photo = photo
        self._shaded: dict[int, Shaded] = {}
        self._images: dict[tuple[Any, ...], Any] = {}

    def set_size(self, width: int, height: int) -> None:
        """The size of the next pictures, which their camera has as well."""

    def average(
        self,
        data: mujoco.MjData,
        camera: Camera,
        samples: int,
        reach: float,
        alpha: np.ndarray | None = None,
        trails: Sequence[Trail] = (),
        light_yaw: float = 0.0,
    ) -> np.ndarray:
        """One picture, u8[height, width, 3], or [height, width, 4] where what is behind is transparent.

        Arguments are those of `Renderer.average`; `samples` are paths of each pixel.
        """
        import mitsuba as mi

        # Pixels are square here: a camera whose are not has more or fewer rows, until the end.
        rows = max(1, round(camera.height * camera.K[0, 0] / camera.K[1, 1]))
        scene = mi.load_dict(self._scene(data, camera, rows, alpha, trails, light_yaw))
        light = np.zeros((rows, camera.width, 4))
        passes = -(-samples // PER_PASS)
        with Progress("path tracing", passes + 1, "pass") as progress:
            for number in range(passes):
                light += np.asarray(mi.render(scene, spp=PER_PASS, seed=number))
                progress.update()
            guides = mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
            seen = np.asarray(mi.render(scene, integrator=guides, spp=PER_PASS, seed=passes))
            light /= passes
            clean = _denoised(light[..., :3], seen[..., -6:-3], seen[..., -3:])
            progress.update()
        pixels = self._developed(clean, np.clip(light[..., 3:], 0, 1))
        if rows == camera.height:
            return pixels
        image = Image.fromarray(pixels)
        return np.asarray(image.resize((camera.width, camera.height), Image.Resampling.LANCZOS))

    def _developed(self, light: np.ndarray, cover: np.ndarray) -> np.ndarray:
        """u8[H, W, 3 or 4], sRGB, of linear light f[H, W, 3], of which a share f[H, W, 1] is in front."""
        if not self._photo.is_cut_out:
            return np.round(255 * _shown(light)).astype(np.uint8)
        shown = _shown(light / np.maximum(cover, 1e-3))
        if self._photo.is_transparent:
            return np.round(255 * np.concatenate([shown, cover], -1)).astype(np.uint8)
        behind = read_backdrop(self._photo.background, light.shape[1], light.shape[0])
        return np.round(255 * (cover * shown + (1 - cover) * behind)).astype(np.uint8)

    def _scene(
        self,
        data: mujoco.MjData,
        camera: Camera,
        rows: int,
        alpha: np.ndarray | None,
        trails: Sequence[Trail],
        light_yaw: float,
    ) -> dict[str, Any]:
        model = self.model
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {
                "type": "path",
                "max_depth": _MAX_DEPTH,
                "hide_emitters": self._photo.is_cut_out,
            },
            "sensor": _sensor(camera, rows, self._photo, model.stat.center),
        }
        drawn = model.geom_group == VISUAL_GROUP
        if self._photo.is_cut_out:
            drawn &= model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        for geom in np.flatnonzero(drawn):
            opacity = 1.0 if alpha is None else float(alpha[model.geom_bodyid[geom]])
            if opacity > 0:
                scene[f"geom-{geom}"] = self._geom(data, geom, opacity)
        for number, trail in enumerate(trails):
            scene[f"trail-{number}"] = _tube(trail)
        return scene | self._room_and_light(camera, light_yaw)

    def _geom(self, data: mujoco.MjData, geom: int, opacity: float) -> Any:
        import mitsuba as mi

        model = self.model
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            size = np.where(model.geom_size[geom, :2] > 0, model.geom_size[geom, :2], _ENDLESS)
            material = self._material(geom, opacity, size)
            place = np.eye(4)
            place[:3, :3] = data.geom_xmat[geom].reshape(3, 3)
            place[:3, 3] = data.geom_xpos[geom]
            transform = mi.ScalarTransform4f(place) @ mi.ScalarTransform4f().scale([*size, 1])
            return {"type": "rectangle", "to_world": transform, "bsdf": material}
        material = self._material(geom, opacity)
        if geom not in self._shaded:
            self._shaded[geom] = shade_geom(model, geom)
        shaded = self._shaded[geom]
        turn = data.geom_xmat[geom].reshape(3, 3)
        return _mesh(
            shaded._replace(
                vertices=shaded.vertices @ turn.T + data.geom_xpos[geom],
                normals=shaded.normals @ turn.T,
            ),
            material,
        )

    def _material(
        self, geom: int, opacity: float, size: np.ndarray | None = None
    ) -> dict[str, Any]:
        """Mitsuba's description of a geom's surface; of a plane with its half sides f[2], metres."""
        model = self.model
        number = model.geom_matid[geom]
        rgba = model.geom_rgba[geom].astype(float)
        roughness = metallic = -1.0
        images = dict.fromkeys(_ROLES, -1)
        repeats = (1.0, 1.0)
        if number >= 0:
            if np.allclose(rgba, (0.5, 0.5, 0.5, 1.0), atol=1e-6):
                rgba = model.mat_rgba[number].astype(float)
            images = {name: int(model.mat_texid[number, role]) for name, role in _ROLES.items()}
            roughness = float(model.mat_roughness[number])
            metallic = float(model.mat_metallic[number])
            repeats = _repeats(model, number, size)
        is_clear = rgba[3] < _OPAQUE
        if is_clear and images["rgb"] < 0:
            surface = _glass(rgba, roughness)
        else:
            surface = {
                "type": "principled",
                "base_color": _colour(rgba[:3]),
                "roughness": max(_ROUGHNESS if roughness < 0 else roughness, _SMOOTHEST),
                "metallic": max(metallic, 0.0),
                "specular": 0.5,
            }
            if images["rgb"] >= 0:
                surface["base_color"] = self._image(images["rgb"], repeats, rgba[:3])
            if images["orm"] >= 0:
                for channel, name in ((1, "roughness"), (2, "metallic")):
                    factor = surface[name] * np.eye(3)[channel]
                    surface[name] = self._image(images["orm"], repeats, factor, is_raw=True)
            if images["normal"] >= 0:
                normal = self._image(images["normal"], repeats, np.ones(3), is_raw=True)
                surface = {"type": "normalmap", "normalmap": normal, "nested": surface}
            surface = {"type": "twosided", "nested": surface}
            opacity *= rgba[3] if is_clear else 1.0
        if opacity < _OPAQUE:
            surface = {"type": "mask", "opacity": opacity, "nested": surface}
        return surface

    def _image(
        self, number: int, repeats: tuple[float, float], factor: np.ndarray, is_raw: bool = False
    ) -> Any:
        """Mitsuba's texture of one of the model's, so many times along u and v, times f[3].

        Args:
          is_raw: its values are no colours; of a factor with one channel above 0 that channel alone.
        """
        import mitsuba as mi

        key = (number, *repeats, *np.round(factor, 4).tolist(), is_raw)
        if key not in self._images:
            pixels = texture_pixels(self.model, number) * factor
            if is_raw and np.count_nonzero(factor) == 1:
                pixels = pixels[..., factor > 0]
            bitmap = mi.Bitmap(np.round(pixels).astype(np.uint8))
            scale = mi.ScalarTransform4f().scale([*repeats, 1])
            texture = {"type": "bitmap", "bitmap": bitmap, "raw": is_raw, "to_uv": scale}
            self._images[key] = mi.load_dict(texture)
        return self._images[key]

    def _room_and_light(self, camera: Camera, yaw: float) -> dict[str, Any]:
        """Walls, lamps and the sky.

        Args:
          yaw: radians by which lamps and sky are turned.
        """
        import mitsuba as mi

        look = self._look
        center = self.model.stat.center
        found: dict[str, Any] = {}
        room = max(look.room, float(np.linalg.norm(camera.eye[:2] - center[:2])) + _BEHIND)
        if look.wall is not None and not self._photo.is_cut_out:
            found |= _walls(look.wall, room, center)
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
                "emitter": {"type": "area", "radiance": _light(lamp.colour, radiance)},
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
            found["sky"] = {"type": "constant", "radiance": _light(sky.colour, strength)}
        return found


@contextmanager
def open_photo_renderer(
    model: mujoco.MjModel, look: Look | None, photo: PhotoConfig
) -> Iterator[PhotoRenderer]:
    """As `open_renderer`, by path tracing.

    Raises:
      MissingExtraError, ConfigError: as `check_photo`.
    """
    check_photo(photo)
    import mitsuba as mi

    mi.set_variant(find_variant())
    yield PhotoRenderer(model, look, photo)


def check_photo(photo: PhotoConfig) -> None:
    """Makes sure that such photos can be made here.

    Raises:
      MissingExtraError: the extra `photo` is not installed.
      ConfigError: the background is neither a colour nor an image.
    """
    if photo.background:
        read_backdrop(photo.background, 16, 16)
    if find_spec("mitsuba") is None or find_spec("pyoidn") is None:
        raise MissingExtraError("photo", "quality 'photo'")


def read_backdrop(background: str, width: int, height: int) -> np.ndarray:
    """f64[height, width, 3] in [0, 1]: a colour, or an image that fills the picture.

    Raises:
      ConfigError: it is neither.
    """
    try:
        image = Image.new("RGB", (width, height), ImageColor.getrgb(background)[:3])
    except ValueError:
        if not Path(background).is_file():
            raise ConfigError(
                f"background {background!r}",
                "a colour such as white or #f2efe8, or the file of an image",
            ) from None
        try:
            with Image.open(background) as file:
                image = ImageOps.fit(file.convert("RGB"), (width, height))
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ConfigError(
                f"background {background!r}, which holds no image ({error})", "a PNG or JPEG file"
            ) from error
    return np.asarray(image) / 255.0


_FAST = "llvm_ad_rgb"
_SAFE = "scalar_rgb"
_TRIAL = """
import mitsuba as mi
mi.set_variant({variant!r})
scene = mi.cornell_box()
scene["sensor"]["film"].update(width=16, height=16)
mi.render(mi.load_dict(scene), spp=2)
"""
_LONGEST_TRIAL = 60.0
_WITHOUT_LLVM = "note: path tracing is 2 to 3 times faster with LLVM, which is missing or too old for this processor"


@cache
def find_variant() -> str:
    """Mitsuba's variant: the fast one, which needs LLVM, if it draws here; else the plain one.

    It is tried in a process of its own, as it ends the process on processors that LLVM does not fit.
    """
    command = [sys.executable, "-c", _TRIAL.format(variant=_FAST)]
    try:
        trial = subprocess.run(command, capture_output=True, check=False, timeout=_LONGEST_TRIAL)
        if trial.returncode == 0:
            return _FAST
    except subprocess.TimeoutExpired:
        pass
    print(_WITHOUT_LLVM, file=sys.stderr, flush=True)
    return _SAFE


def shade_geom(model: mujoco.MjModel, geom: int) -> Shaded:
    """A geom's surface with normals, in the geom's frame; no plane."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        kind = mujoco.mjtGeom(model.geom_type[geom])
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
    # A corner's place in the image: MuJoCo's v runs down it, as Mitsuba's does not.
    corner = model.mesh_facetexcoord[rows].ravel()
    uv = model.mesh_texcoord[place + corner] * [1, -1] + [0, 1]
    return shade(Mesh(points[faces.ravel()], np.arange(3 * len(faces)).reshape(-1, 3)), uv)


def texture_pixels(model: mujoco.MjModel, number: int) -> np.ndarray:
    """u8[height, width, 3] of one of a model's textures."""
    height = model.tex_height[number]
    width = model.tex_width[number]
    channels = model.tex_nchannel[number]
    start = model.tex_adr[number]
    pixels = model.tex_data[start : start + height * width * channels]
    return np.asarray(pixels.reshape(height, width, channels)[..., :3])


def _repeats(model: mujoco.MjModel, material: int, size: np.ndarray | None) -> tuple[float, float]:
    """How often an image lies along u and v; of a plane, along its sides, `size` being half of them."""
    u, v = model.mat_texrepeat[material].tolist()
    if size is None or not model.mat_texuniform[material]:
        return u, v
    return 2 * size[0] * u, 2 * size[1] * v


def _mesh(shaded: Shaded, material: dict[str, Any]) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(material)
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
    return mesh


def _tube(trail: Trail) -> Any:
    parts = [
        trimesh.creation.cylinder(trail.radius, segment=pair, sections=12)
        for pair in zip(trail.points[:-1], trail.points[1:], strict=True)
    ]
    body = trimesh.util.concatenate(parts)
    material = {"type": "diffuse", "reflectance": _colour(trail.rgb)}
    if trail.alpha < _OPAQUE:
        material = {"type": "mask", "opacity": trail.alpha, "nested": material}
    return _mesh(shade(Mesh(np.array(body.vertices), np.array(body.faces))), material)


def _colour(rgb: Sequence[float] | np.ndarray) -> dict[str, Any]:
    """A colour as shown (sRGB)."""
    return {"type": "rgb", "value": list(linear([*np.clip(rgb, 0, 1), 1.0])[:3])}


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


_PLAIN = Look(
    about="no look: a grey floor without end",
    top=Covering("paint"),
    frame=Covering("paint"),
    floor=Covering("paint"),
)


def _walls(wall: Covering, room: float, center: np.ndarray) -> dict[str, Any]:
    """Four walls around the middle, which look inwards."""
    import mitsuba as mi

    pixels = np.asarray(covering_texture(wall).image)
    repeat = mi.ScalarTransform4f().scale([2 * room / wall.tile, _WALL / wall.tile, 1])
    image = mi.load_dict({"type": "bitmap", "bitmap": mi.Bitmap(pixels.copy()), "to_uv": repeat})
    surface = {
        "type": "twosided",
        "nested": {
            "type": "principled",
            "base_color": image,
            "roughness": max(wall.roughness, _SMOOTHEST),
            "metallic": wall.metallic,
        },
    }
    middle = [*center[:2].tolist(), _WALL / 2]
    walls = {}
    for number in range(4):
        place = (
            mi.ScalarTransform4f().translate(middle)
            @ mi.ScalarTransform4f().rotate([0, 0, 1], 90 * number)
            @ mi.ScalarTransform4f().translate([0, room, 0])
            @ mi.ScalarTransform4f().rotate([1, 0, 0], 90)
            @ mi.ScalarTransform4f().scale([room, _WALL / 2, 1])
        )
        walls[f"wall-{number}"] = {"type": "rectangle", "to_world": place, "bsdf": surface}
    return walls


def _panorama(sky: Sky) -> Any:
    import mitsuba as mi

    try:
        bitmap = mi.Bitmap(sky.image)
    except RuntimeError as error:
        raise AssetError(f"a sky's image that cannot be decoded: {sky.image}") from error
    linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    pixels = np.asarray(linear) * np.array(_light(sky.colour, 1.0)["value"], np.float32)
    return mi.Bitmap(np.ascontiguousarray(pixels, np.float32))


def _light(colour: Sequence[float], strength: float) -> dict[str, Any]:
    """Radiance of a colour, sRGB, whose strongest channel is made as bright as the strength."""
    value = strength * np.array(linear([*colour, 1.0])[:3]) / max(max(colour), 1e-3)
    return {"type": "rgb", "value": value.tolist()}


def _denoised(light: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """f32[H, W, 3], linear: light without noise, guided by albedo and normals f[H, W, 3]."""
    import pyoidn

    colour, albedo, normal = (
        np.ascontiguousarray(each, np.float32) for each in (light, np.clip(albedo, 0, 1), normal)
    )
    return np.asarray(pyoidn.denoise(colour, albedo=albedo, normal=normal, hdr=True))


def _shown(light: np.ndarray) -> np.ndarray:
    """f[H, W, 3] in [0, 1]: linear light as sRGB, the brightest faded into white."""
    over = np.maximum(light - _EXPOSED, 0)
    room = 1 - _EXPOSED
    soft = np.minimum(light, _EXPOSED) + room * (1 - np.exp(-over / room))
    soft = np.clip(soft, 0, 1)
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)
