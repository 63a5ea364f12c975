"""Grasps found in a volume by its geometry alone, without learning: the proposer `geometry`.

Of a truncated signed distance (`vgn.tsdf_grid`) surface points and normals are taken, then pairs of points
that two fingers can press towards each other, hands about them that come from above, and of these the ones
whose open hand is clear on its whole way. A voxel that was not measured is solid if something solid lies
above it in its column, else free: cameras look from above. Beside the cube the outermost voxels go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.clutter import StillScene
from cluttergen_jax.downstream.robot.grasping.grasp_dataset import (
    CUBE,
    FINGER,
    RESOLUTION,
    task_frame,
)
from cluttergen_jax.downstream.robot.gripper import Gripper, gripper_of
from cluttergen_jax.downstream.robot.model import hand_spec
from cluttergen_jax.downstream.transforms import inverse, rigid
from cluttergen_jax.scene import Scene

VOXEL = CUBE / RESOLUTION
BAND = 4 * VOXEL
"""Metres from a surface within which a volume knows the distance."""
CONE = np.arctan(0.5)
"""Radians that a normal may be off the line between two points: most objects have this friction."""
# Metres that what is held is narrower than the hand opens, and wide at least.
_MARGIN = 0.004
_THINNEST = 0.004

_TURNS = np.radians([0, 25, -25, 50, -50])
"""Of approaches about the closing axis, from the one that points down the most."""
_FLATTEST = 0.5
"""Cosine between an approach and straight down, at least."""
_SHALLOW = (0.0, 0.006)
"""Metres by which a pair's points lie nearer to the tips than the middles of the pads."""
_BACK = (0.0, 0.03, 0.06, 0.1)
"""Metres before the grasp at which the open hand is looked at, as where grasps are labelled."""
_CLEARANCES = (0.006, 0.003, 0.001)
"""Metres between the open hand and what is solid: looked for in this order."""
_LEAST_LEVEL = 0.3
"""Level part of a unit normal from which on a surface may be a low side."""
_FEW = 20
"""One of so many points of the hand is looked at first."""
# Metres above the table that are worth a whole cone of alignment, and what coming straight down is worth.
_HEIGHT = 0.1
_LEVEL = 0.3

_SPACING = 0.007
"""Metres between points of the hand, at most."""


class VolumeGrasps(NamedTuple):
    """C grasps in a volume, the best first.

    Attributes:
      pose: f64[C, 4, 4], T_task_tool: z is the approach, y the direction in which the fingers close.
      width: f64[C], metres between the points that the fingers press on. score: f64[C].
    """

    pose: np.ndarray
    width: np.ndarray
    score: np.ndarray

    def take(self, index: np.ndarray | slice) -> VolumeGrasps:
        """Those at `index`."""
        return VolumeGrasps(*(each[index] for each in self))


class SurfacePairs(NamedTuple):
    """P pairs of surface points, task frame, metres.

    Attributes:
      middle: f64[P, 3], between them; axis: f64[P, 3], unit, from one to the other; width: f64[P].
      alignment: f64[P], the lesser of the cosines between the axis and the two normals.
    """

    middle: np.ndarray
    axis: np.ndarray
    width: np.ndarray
    alignment: np.ndarray


def distance_field(grid: np.ndarray) -> np.ndarray:
    """f64[N, N, N]: metres to the nearest surface, below 0 inside, of a volume f[N, N, N]; at most `BAND`."""
    is_inside = (grid > 0) & (grid < 0.5)
    is_below = np.flip(np.maximum.accumulate(np.flip(is_inside, 2), axis=2), 2)
    unknown = np.where(is_below, -BAND, BAND)
    return np.where(grid > 0, (2 * grid.astype(np.float64) - 1) * BAND, unknown)


def sample_field(field: np.ndarray, points: np.ndarray) -> np.ndarray:
    """f64[...]: a field f[N, N, N] at points f[..., 3] in the task frame, metres, between its voxels."""
    at = np.moveaxis(points * (len(field) / CUBE) - 0.5, -1, 0)
    values: np.ndarray = map_coordinates(field, at, order=1, mode="nearest")
    return values


def free_room(grid: np.ndarray) -> np.ndarray:
    """f64[2 N, 2 N, 2 N]: metres to the nearest solid, 0 inside, at half the spacing of a volume f[N, N, N].

    Measured in all directions: along rays that graze it, as a volume has it, a wall is farther away.
    """
    steps = (np.arange(2 * RESOLUTION) + 0.5) * VOXEL / 2
    points = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    is_free = sample_field(distance_field(grid), points) > 0
    half = VOXEL / 4
    room: np.ndarray = np.maximum(distance_transform_edt(is_free) * VOXEL / 2 - half, 0.0)
    return room


def surface_of(grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[P, 3] each: points at which two measured voxels have unequal signs, and outward normals."""
    field = distance_field(grid)
    is_known = grid > 0
    points = []
    for axis in range(3):
        first = np.moveaxis(field, axis, 0)[:-1], np.moveaxis(is_known, axis, 0)[:-1]
        after = np.moveaxis(field, axis, 0)[1:], np.moveaxis(is_known, axis, 0)[1:]
        cells = np.argwhere(first[1] & after[1] & (first[0] * after[0] < 0))
        a, b = (each[0][tuple(cells.T)] for each in (first, after))
        middle = cells + 0.5
        middle[:, 0] += a / (a - b)
        # `moveaxis` has this axis first and the others in their order.
        order = np.argsort([axis, *(each for each in range(3) if each != axis)])
        points.append(middle[:, order] * VOXEL)
    found = np.concatenate(points)
    slope = np.gradient(gaussian_filter(field, 0.7))
    normal = np.stack([sample_field(each, found) for each in slope], axis=-1)
    length = np.linalg.norm(normal, axis=1)
    is_sound = length > 1e-9
    return found[is_sound], normal[is_sound] / length[is_sound, None]


def find_pairs(
    points: np.ndarray, normals: np.ndarray, trust: np.ndarray, widest: float
) -> SurfacePairs:
    """Pairs of surface points f64[P, 3] whose normals oppose within `CONE`, the best aligned first.

    Of pairs that are nearly the same (voxel of the middle, direction) the best alone is kept.

    Args:
      trust: f64[P], 0 to 1, how much of an alignment better than the cone's counts.
    """
    is_table = (np.abs(points[:, 2] - FINGER) < VOXEL) & (normals[:, 2] > 0.9)
    points = points[~is_table].astype(np.float32)
    normals = normals[~is_table].astype(np.float32)
    trust = trust[~is_table].astype(np.float32)
    least = np.float32(np.cos(CONE))
    parts = []
    for start in range(0, len(points), 256):
        rows = slice(start, start + 256)
        away = points[None] - points[rows, None]
        length = np.linalg.norm(away, axis=-1)
        axis = away / np.maximum(length, 1e-9)[..., None]
        near = -np.einsum("ijk,ik->ij", axis, normals[rows])
        far = np.einsum("ijk,jk->ij", axis, normals)
        alignment = np.minimum(near, far)
        is_good = (alignment >= least) & (length >= _THINNEST) & (length <= widest)
        i, j = np.nonzero(is_good)
        keep = i + start < j
        i = i[keep]
        j = j[keep]
        middle = (points[i + start] + points[j]) / 2
        worth = least + np.minimum(trust[i + start], trust[j]) * (alignment[i, j] - least)
        parts.append((middle, axis[i, j], length[i, j], worth))
    if not parts:
        return SurfacePairs(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    whole = [np.concatenate(each).astype(np.float64) for each in zip(*parts, strict=True)]
    middle, axis, _, alignment = whole
    order = np.argsort(-alignment, kind="stable")
    cell = np.concatenate([np.floor(middle / VOXEL), np.round(2.5 * axis * _side(axis))], axis=1)[
        order
    ]
    _, first = np.unique(cell, axis=0, return_index=True)
    return SurfacePairs(*(each[order[np.sort(first)]] for each in whole))


def _side(axis: np.ndarray) -> np.ndarray:
    """f64[P, 1]: 1 or -1, so that an axis and its opposite become the same."""
    largest = np.take_along_axis(axis, np.abs(axis).argmax(1)[:, None], axis=1)
    return np.sign(largest)


def draw_hands(pairs: SurfacePairs, gripper: Gripper) -> VolumeGrasps:
    """Ways for the hand to get about the pairs from above, the best first; none was looked at."""
    down = np.array([0.0, 0.0, -1.0])
    below = down - pairs.axis * (pairs.axis @ down)[:, None]
    length = np.linalg.norm(below, axis=1)
    below = below / np.maximum(length, 1e-9)[:, None]
    rows = np.flatnonzero(length > 0.3)
    parts = []
    for turn in _TURNS:
        for shallow in _SHALLOW:
            axis = pairs.axis[rows]
            width = pairs.width[rows]
            approach = np.cos(turn) * below[rows] + np.sin(turn) * np.cross(axis, below[rows])
            back = shallow + gripper.depth_of(width)
            frame = np.stack([np.cross(axis, approach), axis, approach], axis=-1)
            pose = rigid(frame, pairs.middle[rows] - back[:, None] * approach)
            aligned = (pairs.alignment[rows] - np.cos(CONE)) / (1 - np.cos(CONE))
            score = aligned + (pairs.middle[rows, 2] - FINGER) / _HEIGHT - _LEVEL * approach[:, 2]
            keep = -approach[:, 2] >= _FLATTEST
            parts.append(VolumeGrasps(pose[keep], width[keep], score[keep]))
    whole = join_grasps(parts)
    return whole.take(np.argsort(-whole.score, kind="stable"))


class OpenHand:
    """The open hand of a robot over a support whose shape is known, as it is without objects.

    Args:
      robot: whose hand it is. support: what the objects stand on: a bin's walls may lie beside the cube.
    """

    def __init__(self, robot: RobotDescription, support: SupportAsset) -> None:
        self.gripper = gripper_of(robot)
        self._empty = StillScene(Scene((), (), np.zeros((0, 7)), support), robot)
        self._T_world_task = task_frame(support)
        self._model = hand_spec(ContactConfig(), robot).compile()
        self._data = mujoco.MjData(self._model)
        is_solid = (self._model.geom_contype != 0) | (self._model.geom_conaffinity != 0)
        self._solids = {
            int(index): _solid_points(self._model, int(index)) for index in np.flatnonzero(is_solid)
        }

    @property
    def widest(self) -> float:
        """Metres of what fits between the fingers."""
        return 2 * self.gripper.max_opening - _MARGIN

    def points(self, width: float) -> np.ndarray:
        """f64[K, 3]: of the hand's solids, tool frame, opened for something of this width."""
        self._data.qpos[:] = self.gripper.joints_of(self.gripper.opening_of(width))
        mujoco.mj_kinematics(self._model, self._data)
        turned = [
            points @ self._data.geom_xmat[index].reshape(3, 3).T + self._data.geom_xpos[index]
            for index, points in self._solids.items()
        ]
        T_tool_hand = inverse(self.gripper.T_hand_tool)
        return np.concatenate(turned) @ T_tool_hand[:3, :3].T + T_tool_hand[:3, 3]

    def is_clear(self, room: np.ndarray, pose: np.ndarray, width: float, clearance: float) -> bool:
        """Whether it has room at T_task_tool f64[4, 4] and on its way there, by `free_room`; metres."""
        points = self.points(width) @ pose[:3, :3].T + pose[:3, 3]
        ways = (points - back * pose[:3, 2] for back in _BACK)
        has_room = all((sample_field(room, each) > clearance).all() for each in ways)
        return has_room and self._misses_support(pose, width)

    def _misses_support(self, pose: np.ndarray, width: float) -> bool:
        """Whether it touches nothing of the empty support at T_task_tool f64[4, 4] and on its way there."""
        return not self._empty.blocker(self._T_world_task @ pose, width)

    def first_clear(self, grid: np.ndarray, grasps: VolumeGrasps) -> int | None:
        """The number of the first of the grasps in a volume f[N, N, N] at which it is clear.

        Those with more room come before those with less (`_CLEARANCES`).
        """
        room = free_room(grid)
        least = self.least_room(room, grasps)
        for clearance in _CLEARANCES:
            for row in np.flatnonzero(least > clearance).tolist():
                if self.is_clear(room, grasps.pose[row], float(grasps.width[row]), clearance):
                    return row
        return None

    def least_room(self, room: np.ndarray, grasps: VolumeGrasps) -> np.ndarray:
        """f64[C]: metres that some of the hand's points have at grasps, which rules out most at once."""
        least = np.zeros(len(grasps.width))
        millimetres = np.ceil(1e3 * grasps.width).astype(int)
        for each in np.unique(millimetres):
            rows = np.flatnonzero(millimetres == each)
            few = self.points(1e-3 * float(each))[::_FEW]
            points = (
                np.einsum("cij,kj->cki", grasps.pose[rows, :3, :3], few)
                + grasps.pose[rows, None, :3, 3]
            )
            cell = np.clip(points * (len(room) / CUBE), 0, len(room) - 1).astype(np.int32)
            least[rows] = room[cell[..., 0], cell[..., 1], cell[..., 2]].min(1)
        return least


def _solid_points(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """f64[K, 3]: points in and on a solid, its frame; of what is no mesh, those of the box about it."""
    centre = model.geom_aabb[geom][:3]
    half = model.geom_aabb[geom][3:]
    corners = centre + half * np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), -1).reshape(
        -1, 3
    )
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start = int(model.mesh_vertadr[mesh])
        number = int(model.mesh_vertnum[mesh])
        corners = model.mesh_vert[start : start + number].astype(np.float64)
    hull = ConvexHull(corners)
    steps = [np.arange(-each, each, _SPACING) for each in half]
    inner = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3) + centre
    is_in = (inner @ hull.equations[:, :3].T + hull.equations[:, 3] < 0).all(1)
    sides = [_triangle_points(hull.points[each]) for each in hull.simplices]
    # Triangles of a fine mesh have many points in common.
    cell = np.round(np.concatenate([inner[is_in], *sides]) / (_SPACING / 2))
    return np.unique(cell, axis=0) * (_SPACING / 2)


def _triangle_points(corners: np.ndarray) -> np.ndarray:
    """f64[K, 3]: on a triangle f64[3, 3], no farther apart than `_SPACING`."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()
    number = int(np.ceil(longest / _SPACING)) + 1
    a, b = np.meshgrid(np.linspace(0, 1, number), np.linspace(0, 1, number), indexing="ij")
    keep = a + b <= 1 + 1e-9
    weights = np.stack([a[keep], b[keep], 1 - a[keep] - b[keep]], axis=-1)
    return weights @ corners


def draw_grasps(grid: np.ndarray, hand: OpenHand, is_level: bool = False) -> VolumeGrasps:
    """Antipodal grasps in a volume f[N, N, N], the best first; the hand need not be clear at them.

    Args:
      is_level: take normals level. Seen from above, those of a low side lean upwards: voxels are too coarse
        for its edges. The more they lean the less such a grasp is worth.
    """
    points, normals = surface_of(grid)
    if not is_level:
        return draw_hands(
            find_pairs(points, normals, np.ones(len(points)), hand.widest), hand.gripper
        )
    level = np.linalg.norm(normals[:, :2], axis=1)
    is_side = level > _LEAST_LEVEL
    normals = normals[is_side] * np.array([1.0, 1.0, 0.0]) / level[is_side, None]
    return draw_hands(
        find_pairs(points[is_side], normals, level[is_side], hand.widest), hand.gripper
    )


def join_grasps(parts: Sequence[VolumeGrasps]) -> VolumeGrasps:
    """Those of all parts."""
    return VolumeGrasps(*(np.concatenate(each) for each in zip(*parts, strict=True)))
