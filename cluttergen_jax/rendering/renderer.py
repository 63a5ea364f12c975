"""A model in front of a camera, its GL context held open: many pictures of it at little cost each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.rendering.camera import orbit_camera, set_view
from cluttergen_jax.rendering.config import CameraView
from cluttergen_jax.rendering.gl import gl_context
from cluttergen_jax.rendering.lighting import KEY_LIGHT, SKY_LIGHT
from cluttergen_jax.sensing.camera import Camera

HIDDEN_GROUP = 5
MAX_SIDE = 8192
MAX_SAMPLES = 4096
_MAX_EXTRA = 4000
_GOLDEN = 0.6180339887498949
_EVERYTHING = mujoco.mjtCatBit.mjCAT_ALL.value


@dataclass(frozen=True, eq=False)
class Trail:
    """A line through space, drawn as a thin tube.

    Attributes:
      points: f[N, 3], metres, world frame.
      rgb: each in [0, 1].
      alpha: 1 is opaque.
      radius: metres.
    """

    points: np.ndarray
    rgb: tuple[float, float, float]
    alpha: float = 1.0
    radius: float = 0.0018


def check_size(width: int, height: int, samples: int) -> None:
    """Refuses a picture that cannot be (ConfigError: a side or the number of samples is out of range)."""
    if not (16 <= width <= MAX_SIDE and 16 <= height <= MAX_SIDE and 1 <= samples <= MAX_SAMPLES):
        raise ConfigError(
            f"a picture of {width} x {height}, {samples} samples",
            f"16 to {MAX_SIDE} pixels, 1 to {MAX_SAMPLES} samples",
        )


def thresholds(samples: int) -> np.ndarray:
    """f64[samples]: something of opacity a is drawn in the pictures whose threshold is below a.

    So a share a of the pictures shows it, spread evenly over the sequence of lights; their mean is what
    transparency looks like, without any order of drawing and without seeing into the object.
    """
    ranks = np.argsort(np.argsort((np.arange(samples) * _GOLDEN) % 1.0))
    return (ranks + 0.5) / samples


class Renderer:
    """See `open_renderer`. The model's groups and colours may be changed between pictures."""

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, context: mujoco.MjrContext
    ) -> None:
        self.model = model
        self.width = width
        self.height = height
        self._context = context
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + _MAX_EXTRA)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[VISUAL_GROUP] = 1
        self._rect = mujoco.MjrRect(0, 0, width, height)

    def set_size(self, width: int, height: int) -> None:
        """The next pictures are of this size, no larger than the first one's."""
        self.width = width
        self.height = height
        self._rect = mujoco.MjrRect(0, 0, width, height)

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
        """The mean of `samples` pictures with the lights and the pixel grid moved a little between them.

        Args:
          camera: of the size of the pictures.
          reach: the content's radius, metres.
          alpha: f[nbody], the opacity of each body; None draws all.
          trails: lines to draw as well.
          light_yaw: radians by which the lights are turned about the vertical.

        Returns:
          uint8[height, width, 3].
        """
        groups = self.model.geom_group.copy()
        limits = thresholds(samples)
        pixels = np.empty((self.height, self.width, 3), np.uint8)
        total = np.zeros((self.height, self.width, 3), np.uint32)
        try:
            for index in range(samples):
                if alpha is not None:
                    is_seen = alpha[self.model.geom_bodyid] > limits[index]
                    self.model.geom_group[:] = np.where(is_seen, groups, HIDDEN_GROUP)
                self._update(data, camera)
                for trail in trails:
                    if trail.alpha > limits[index]:
                        self._add(trail)
                u = low_discrepancy(index)
                shift_lights(self._scene, self.model, u, reach, light_yaw)
                if samples > 1:
                    shift_pixel(self._scene, u[4], u[5], self.width, self.height)
                mujoco.mjr_render(self._rect, self._scene, self._context)
                mujoco.mjr_readPixels(pixels, None, self._rect, self._context)
                total += pixels
        finally:
            self.model.geom_group[:] = groups
        return np.flipud((total + samples // 2) // samples).astype(np.uint8)

    def measure(self, data: mujoco.MjData, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """What each pixel's middle sees: metres along the line of sight's axis, and which geom.

        Returns:
          f32[height, width], inf where there is nothing; i32[height, width], -1 where there is nothing.
        """
        self._update(data, camera)
        flags = self._scene.flags
        kept = flags.copy()
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        colours = np.empty((self.height, self.width, 3), np.uint8)
        raw = np.empty((self.height, self.width), np.float32)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(colours, raw, self._rect, self._context)
        flags[:] = kept
        number = (colours.astype(np.int32) * [1, 256, 65536]).sum(-1)
        geom_of = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                geom_of[geom.segid + 1] = geom.objid
        # MuJoCo's depth runs from 0 at the far plane to 1 at the near one, even in the inverse of distance.
        extent = self.model.stat.extent
        planes = self.model.vis.map
        near = planes.znear * extent
        far = planes.zfar * extent
        inverse = raw.astype(np.float64) * (1 / near - 1 / far) + 1 / far
        depth = np.where(raw > 0, 1 / inverse, np.inf).astype(np.float32)
        return np.flipud(depth).copy(), np.flipud(geom_of[number]).copy()

    def _update(self, data: mujoco.MjData, camera: Camera) -> None:
        # Another renderer may have drawn into a buffer of its own since.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        seen = orbit_camera(camera)
        mujoco.mjv_updateScene(self.model, data, self._option, None, seen, _EVERYTHING, self._scene)
        set_view(self._scene, camera)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 1

    def _add(self, trail: Trail) -> None:
        scene = self._scene
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        rgba = np.array([*trail.rgb, 1.0], np.float32)
        points = np.asarray(trail.points, np.float64)
        for start, end in itertools.pairwise(points):
            if scene.ngeom >= scene.maxgeom:
                return
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
            mujoco.mjv_connector(geom, capsule, trail.radius, start, end)
            geom.emission = 0.5
            scene.ngeom += 1


@contextmanager
def open_renderer(model: mujoco.MjModel, width: int, height: int) -> Iterator[Renderer]:
    """A renderer for one model; `set_range` has been called on it before.

    Raises:
      RendererError: nothing here can draw.
    """
    with gl_context(width, height):
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        try:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
            yield Renderer(model, width, height, context)
        finally:
            context.free()


def set_range(
    model: mujoco.MjModel, points: np.ndarray, view: CameraView, width: int, height: int
) -> float:
    """Fits clipping planes, shadow map and buffer to what is drawn; returns the content's radius, metres.

    Args:
      points: f64[P, 3], corners of all that will ever be drawn.
    """
    reach = float(np.linalg.norm(np.ptp(points, axis=0)) / 2) or 1.0
    model.stat.extent = reach
    model.stat.center = (points.min(0) + points.max(0)) / 2
    # A smaller shadow map, or a nearer far plane, leaves speckles on the floor.
    model.vis.map.shadowclip = 4.0
    model.vis.map.znear = 0.05
    model.vis.map.zfar = 500.0
    model.vis.global_.fovy = view.field_of_view
    model.vis.global_.offwidth = width
    model.vis.global_.offheight = height
    return reach


def low_discrepancy(index: int) -> np.ndarray:
    """f64[6] in [0, 1): the index-th point of a sequence that fills the cube evenly (Kronecker's)."""
    base = np.array([0.7548776662, 0.5698402910, 0.8191725134, 0.6710436067, 0.5497004779, 0.4503])
    return (0.5 + index * base) % 1.0


def _around(direction: np.ndarray, u: float, v: float, spread: float) -> np.ndarray:
    """A direction within `spread` radians of the given one, even over the disc."""
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    radius = spread * math.sqrt(u)
    turn = 2 * math.pi * v
    tilted = direction + radius * (math.cos(turn) * side + math.sin(turn) * other)
    return tilted / np.linalg.norm(tilted)


def shift_lights(
    scene: mujoco.MjvScene, model: mujoco.MjModel, u: np.ndarray, reach: float, yaw: float = 0.0
) -> None:
    """Turns the lights of `lighting` a little: averaged over many pictures, small lights become soft ones.

    Args:
      u: f64[6] in [0, 1], where in all directions that it may have each light is.
      reach: the content's radius, metres.
      yaw: radians by which all of them are turned about the vertical besides, to follow a camera.
    """
    height = 0.5 + 0.5 * u[2]
    turn = 2 * math.pi * u[3]
    ring = math.sqrt(1.0 - height**2)
    # Even over the sky down to 30 degrees above the horizon.
    sky = -np.array([ring * math.cos(turn), ring * math.sin(turn), height])
    for light in scene.lights[: scene.nlight]:
        name = "" if light.headlight else model.light(light.id).name
        if name == SKY_LIGHT:
            light.dir = sky
        elif name.startswith(KEY_LIGHT):
            towards = yaw_matrix(yaw) @ model.light_dir[light.id]
            spread = model.light_bulbradius[light.id]
            light.dir = _around(towards / np.linalg.norm(towards), u[0], u[1], spread)
        else:
            continue
        light.pos = model.stat.center - light.dir * 2 * reach


def shift_pixel(scene: mujoco.MjvScene, u: float, v: float, width: int, height: int) -> None:
    """Moves the picture by a part of a pixel: averaged, edges become smooth."""
    for camera in scene.camera:
        span = camera.frustum_top - camera.frustum_bottom
        half_width = camera.frustum_width or 0.5 * span * width / height
        camera.frustum_center += (u - 0.5) * 2 * half_width / width
        camera.frustum_top += (v - 0.5) * span / height
        camera.frustum_bottom += (v - 0.5) * span / height
