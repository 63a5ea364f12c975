"""Pictures like photographs: path tracing by Mitsuba 3, without noise by Intel's Open Image Denoise.

It takes the place of `renderer.Renderer`: surfaces, poses, colours, materials and images are those of the
model as it stands, and light is the look's (`photo_scene`). The extra `photo` installs both libraries.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageColor, ImageOps

from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering.config import PhotoConfig
from cluttergen_jax.rendering.look import Look
from cluttergen_jax.rendering.photo_scene import PhotoScene
from cluttergen_jax.rendering.renderer import Trail
from cluttergen_jax.rendering.surfaces import on_white
from cluttergen_jax.sensing.camera import Camera

PER_PASS = 4
"""Paths of a pixel between two lines of progress, and between two places where Ctrl-C stops it."""
_GUIDES = 2
"""Places of a pixel at which colours and directions are looked up, which guide the removal of noise."""
_EXPOSED = 0.8
"""Brightness up to which a picture follows the light; what is brighter fades into white."""


class PhotoRenderer:
    """See `open_photo_renderer`. The model's groups and colours may be changed between pictures."""

    def __init__(self, model: mujoco.MjModel, look: Look | None, photo: PhotoConfig) -> None:
        self.model = model
        self._photo = photo
        self._scene = PhotoScene(model, look, photo)

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
        scenes = self._scene.load(data, camera, rows, alpha, trails, light_yaw)
        light = np.zeros((rows, camera.width, 4))
        passes = -(-samples // PER_PASS)
        with Progress("path tracing", passes + 1, "round") as progress:
            for number in range(passes):
                light += np.asarray(mi.render(scenes.lit, spp=PER_PASS, seed=number))
                progress.update()
            light /= passes
            cover = np.clip(light[..., 3:], 0, 1)
            albedo, direction, sky = (
                np.asarray(mi.render(each, spp=_GUIDES, seed=0))[..., :3]
                for each in (scenes.albedo, scenes.direction, scenes.sky)
            )
            seen = light[..., :3] + (1 - cover) * sky
            if self._photo.is_cut_out:
                seen = _spread_out(light[..., :3], cover)
            clean = _denoise(seen, albedo, 2 * direction - 1)
            progress.update()
        pixels = self._develop(clean, cover)
        if rows == camera.height:
            return pixels
        image = Image.fromarray(pixels)
        return np.asarray(image.resize((camera.width, camera.height), Image.Resampling.LANCZOS))

    def _develop(self, light: np.ndarray, cover: np.ndarray) -> np.ndarray:
        """u8[H, W, 3 or 4], sRGB, of linear light f[H, W, 3], of which a share f[H, W, 1] is in front."""
        if not self._photo.is_cut_out:
            return np.round(255 * _to_srgb(light)).astype(np.uint8)
        shown = _to_srgb(light)
        if self._photo.is_transparent:
            return np.round(255 * np.concatenate([shown, cover], -1)).astype(np.uint8)
        behind = read_backdrop(self._photo.background, light.shape[1], light.shape[0])
        return np.round(255 * (cover * shown + (1 - cover) * behind)).astype(np.uint8)


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

    # Compiling for a scene of many materials takes longer than what compiled variants save (measured.md).
    mi.set_variant("scalar_rgb")
    # Ctrl-C is told by Python alone.
    mi.set_log_level(mi.LogLevel.Error)
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
                image = ImageOps.fit(on_white(file).convert("RGB"), (width, height))
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise ConfigError(
                f"background {background!r}, which holds no image ({error})", "a PNG or JPEG file"
            ) from error
    return np.asarray(image) / 255.0


def _spread_out(light: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """f[H, W, 3]: light f[H, W, 3] of things in front, as if they covered their pixels wholly, and beyond.

    So that no edge takes up the darkness of what was left out.
    """
    from scipy.ndimage import distance_transform_edt

    is_covered = cover[..., 0] > 0
    if not is_covered.any():
        return light
    rows, columns = distance_transform_edt(~is_covered, return_distances=False, return_indices=True)
    whole = light / np.where(cover > 0, cover, 1.0)
    return np.asarray(whole[rows, columns])


def _denoise(light: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """f32[H, W, 3], linear: light without noise, guided by albedo and normals f[H, W, 3]."""
    import pyoidn

    colour, albedo, normal = (
        np.ascontiguousarray(each, np.float32) for each in (light, np.clip(albedo, 0, 1), normal)
    )
    return np.asarray(pyoidn.denoise(colour, albedo=albedo, normal=normal, hdr=True))


def _to_srgb(light: np.ndarray) -> np.ndarray:
    """f[H, W, 3] in [0, 1]: linear light as sRGB, the brightest faded into white."""
    over = np.maximum(light - _EXPOSED, 0)
    room = 1 - _EXPOSED
    soft = np.minimum(light, _EXPOSED) + room * (1 - np.exp(-over / room))
    soft = np.clip(soft, 0, 1)
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)
