"""Noise of a depth camera: what a real sensor makes of an exact depth image.

Axial noise after Nguyen et al., "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking"
(2012); the other terms are of the kind and size that structured light and stereo cameras show. None has been
fitted to a particular camera here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial.transform import Rotation

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing import REALSENSE_FOCAL, Camera

_PATCH_SIDES = (0.1, 0.3)
"""Of a missing patch, as a share of the picture's."""


@dataclass(frozen=True)
class NoiseConfig:
    """How much of which noise; 0 leaves a term out.

    Attributes:
      axial: standard deviation of the depth at `axial_reference`, metres.
      axial_growth: its growth with the square of the distance from there, 1/metre.
      axial_reference: metres.
      lateral: standard deviation of where a pixel really looks, in pixels of a camera with a focal length of
        615; with a shorter one it is as many fewer.
      quantum: depths are whole multiples of it, metres.
      grazing: incidence from which on pixels are lost, degrees from the surface's normal; the share of lost
        ones grows from none there to all at 90. 90: none.
      edge_dropout: share of pixels at jumps in depth that are lost.
      bleeding: share of pixels beside a jump that show what is in front, one pixel too far.
      jump: so far a depth has to be from a straight line through its neighbours to count as a jump, metres.
      position: standard deviation of the camera's stated position along each axis, metres.
      orientation: of its stated orientation about each axis, degrees.
      patch: share of pictures in which a rectangle is missing.
    """

    axial: float = 0.0012
    axial_growth: float = 0.0019
    axial_reference: float = 0.4
    lateral: float = 0.8
    quantum: float = 0.001
    grazing: float = 70.0
    edge_dropout: float = 0.3
    bleeding: float = 0.5
    jump: float = 0.02
    position: float = 0.002
    orientation: float = 0.3
    patch: float = 0.02

    def __post_init__(self) -> None:
        numbers = vars(self)
        if not all(math.isfinite(value) and value >= 0 for value in numbers.values()):
            raise ConfigError(f"noise {numbers}", "finite numbers, none below 0")
        if (
            max(self.edge_dropout, self.bleeding, self.patch) > 1
            or self.grazing > 90
            or self.jump == 0
        ):
            raise ConfigError(
                f"noise {numbers}", "shares up to 1, `grazing` up to 90 degrees, `jump` above 0"
            )

    def scale(self, factor: float) -> NoiseConfig:
        """The same noise, every error and every share `factor` times as large; shares end at 1.

        `axial_reference`, `jump` and `quantum` stay as they are; by a factor of 0 no depth is rounded either.
        """
        names = ("axial", "axial_growth", "lateral", "position", "orientation")
        shares = ("edge_dropout", "bleeding", "patch")
        larger = {name: factor * getattr(self, name) for name in names}
        larger |= {name: min(1.0, factor * getattr(self, name)) for name in shares}
        grazing = 90 - min(90.0, factor * (90 - self.grazing))
        return replace(self, **larger, grazing=grazing, quantum=self.quantum if factor else 0.0)


REALSENSE = NoiseConfig()
"""Of the size that a depth camera of the RealSense kind has at arm's length."""
NOISE_OFF = REALSENSE.scale(0.0)
"""No noise at all."""


def noisy(
    depth: np.ndarray, camera: Camera, config: NoiseConfig, rng: np.random.Generator
) -> tuple[np.ndarray, Camera]:
    """A depth image as a real camera would give it, and the camera as it is believed to stand.

    Equal generators give equal noise, and every term draws its own numbers, so that leaving one out leaves
    the others as they were.

    Args:
      depth: f32[H, W], metres along the optical axis; inf where nothing is.

    Returns:
      f32[H, W], nan where the camera measured nothing (inf stays: nothing is there to be measured); the
      camera, moved by the error of its pose.

    Raises:
      ConfigError: the image is not the camera's.
    """
    if depth.shape != (camera.height, camera.width):
        raise ConfigError(
            f"a depth image of {depth.shape}", f"{(camera.height, camera.width)}, the camera's"
        )
    streams = rng.spawn(5)
    exact = np.asarray(depth, np.float64)
    is_missing = _lost_mask(exact, camera, config, streams[0])
    measured = _bleed_edges(_jitter(exact, camera, config, streams[1]), config, streams[2])
    is_there = np.isfinite(measured)
    metres = np.where(is_there, measured, 0.0)
    sigma = config.axial + config.axial_growth * (metres - config.axial_reference) ** 2
    error = sigma * streams[3].standard_normal(depth.shape)
    measured = np.where(is_there, measured + error, measured)
    if config.quantum:
        measured = np.where(
            is_there, np.round(measured / config.quantum) * config.quantum, measured
        )
    measured = np.where(is_missing | (measured <= 0), np.nan, measured)
    return measured.astype(np.float32), _perturb_pose(camera, config, streams[4])


def _jitter(
    depth: np.ndarray, camera: Camera, config: NoiseConfig, rng: np.random.Generator
) -> np.ndarray:
    """Every pixel shows the depth of where it really looks."""
    focal = np.array([camera.K[1, 1], camera.K[0, 0]])
    offset = (
        rng.standard_normal((2, *depth.shape))
        * (config.lateral * focal / REALSENSE_FOCAL)[:, None, None]
    )
    rows, columns = np.indices(depth.shape)
    rows = np.clip(np.rint(rows + offset[0]).astype(int), 0, depth.shape[0] - 1)
    columns = np.clip(np.rint(columns + offset[1]).astype(int), 0, depth.shape[1] - 1)
    return depth[rows, columns]


def _bleed_edges(depth: np.ndarray, config: NoiseConfig, rng: np.random.Generator) -> np.ndarray:
    """What is in front grows by a pixel, at a share of the pixels beside it."""
    nearest = minimum_filter(depth, 3, mode="nearest")
    bleeds = (rng.uniform(size=depth.shape) < config.bleeding) & _is_jump(depth, config)
    bleeds &= depth > nearest + config.jump
    return np.where(bleeds, nearest, depth)


def _lost_mask(
    depth: np.ndarray, camera: Camera, config: NoiseConfig, rng: np.random.Generator
) -> np.ndarray:
    """bool[H, W]: pixels without a measurement."""
    draw, edge_draw = rng.uniform(size=(2, *depth.shape))
    is_lost = np.zeros(depth.shape, bool)
    is_edge = _is_jump(depth, config)
    smooth = ~is_edge & np.isfinite(depth)
    if config.grazing < 90:
        angle = np.degrees(np.arccos(_facing(_finite(depth), camera)))
        is_lost |= smooth & (draw < (angle - config.grazing) / (90 - config.grazing))
    is_lost |= is_edge & np.isfinite(depth) & (edge_draw < config.edge_dropout)
    sides = rng.uniform(*_PATCH_SIDES, 2) * depth.shape
    corner = rng.uniform(size=2) * (depth.shape - sides)
    if rng.uniform() < config.patch:
        (top, left) = corner.astype(int)
        (bottom, right) = (corner + sides).astype(int)
        is_lost[top:bottom, left:right] = True
    return is_lost


def _finite(depth: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(depth), depth, 1e3)


def _is_jump(depth: np.ndarray, config: NoiseConfig) -> np.ndarray:
    """bool[H, W]: pixels on either side of a jump along a row or a column; a slope is none, however steep."""
    finite = _finite(depth)
    is_jump = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        bend = np.abs(np.diff(finite, 2, axis=axis)) > config.jump
        is_jump |= np.pad(bend, [(1, 1) if each == axis else (0, 0) for each in (0, 1)])
    return is_jump


def _facing(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """f64[H, W]: the cosine between the line of sight and the surface's normal, from neighbouring pixels."""
    points = camera.directions * depth[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(camera.directions, axis=-1)
    along = np.abs((normal * camera.directions).sum(-1))
    return np.clip(along / np.maximum(length, 1e-12), 0.0, 1.0)


def _perturb_pose(camera: Camera, config: NoiseConfig, rng: np.random.Generator) -> Camera:
    """The camera where it is stated to stand."""
    T = camera.T_world_camera.copy()
    turn = Rotation.from_rotvec(np.radians(config.orientation) * rng.standard_normal(3))
    T[:3, 3] += config.position * rng.standard_normal(3)
    T[:3, :3] = turn.as_matrix() @ T[:3, :3]
    return replace(camera, T_world_camera=T)
