"""The orientations in which objects are released, where they are not all released upright."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import cast

import numpy as np

from cluttergen_jax.assets.height_profile import HeightProfile
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.settle import upright_turn
from cluttergen_jax.assets.usual_poses import Way, usual_weights
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, rotation_matrix, yaw_quaternion
from cluttergen_jax.physics import make_physics
from cluttergen_jax.physics.host import BatchEngine
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.placement.arranged import row_quaternions
from cluttergen_jax.placement.types import Orientations
from cluttergen_jax.placement.world import own_margin_of, pad_rows, surface_runs
from cluttergen_jax.types import Verdict

MAX_RESTING = 8
"""Resting poses of an object, at most; those in which it ends least often are left out."""
NUM_SPREAD = 24
"""Directions, evenly spread, of which any may point up where objects are released in any orientation."""
_LEAST_WEIGHT = 0.05
"""Of a resting pose, in which few or none of the random releases ended."""
_TRIALS = 4
_GAP = 0.001
_NEAR, _SAME = np.cos(np.radians([15.0, 3.0])).tolist()
"""Cosines: a recorded pose is rounded, and of other contacts; after it has settled it stays."""


def make_orientations(
    objects: Sequence[ObjectAsset],
    layout: Layout,
    stability: StabilityConfig,
    kind: str,
    cut: Callable[[ObjectAsset], HeightProfile],
    tilted: np.ndarray | None = None,
    is_in_row: Sequence[bool] | None = None,
    free: float = np.inf,
    lies: Sequence[bool] | None = None,
) -> Orientations:
    """The orientations in which objects may be released, upright first; NumPy arrays.

    Args:
      layout: the compiled world of these objects, in their order.
      kind: "resting": the resting poses of each, verified: released so, alone, in four turns, it is stable
        and stays within 3 degrees. One is drawn as often as random releases end in it. "usual": the same
        ones, as often as people leave it so (`assets.usual_poses`). "any": directions spread evenly over
        the sphere, of which any may point up. "upright": as the object frame has it.
      cut: makes columns.
      tilted: bool[K], objects that get those directions, and their resting poses, besides, with no weight.
      is_in_row: of each object, whether it may stand in a row; None where there are no rows. How it does is
        one more orientation, which is not drawn.
      free: metres, below which what stands in a row is.
      lies: of each object, whether people lay such things down, for "usual"; None where nothing is known.

    Raises:
      ConfigError: one of those does not stand so by itself.
    """
    engine = cast(BatchEngine, make_physics(layout, replace(stability, robust_tilt=0.0), "native"))
    recorded = [_resting_poses(asset) for asset in objects]
    if kind == "upright":
        is_tilted = np.zeros(len(objects), bool) if tilted is None else tilted
        recorded = [
            poses if asks else poses[:1] for poses, asks in zip(recorded, is_tilted, strict=True)
        ]
    is_alone = kind == "upright" and tilted is None
    lying = recorded if is_alone else _stable_poses(recorded, objects, layout, engine)
    standing = None
    if is_in_row is not None:
        standing = _poses_in_row(objects, is_in_row, free, layout, engine)
    engine.free()
    number = 1 if is_alone else MAX_RESTING
    if kind == "usual":
        known = [False] * len(objects) if lies is None else lies
        lying = [_left_usually(*each) for each in zip(objects, lying, known, strict=True)]
    if kind == "any" or tilted is not None:
        number += NUM_SPREAD
    spread = [_quaternion_of(upright_turn(up)) for up in _spread()]
    if kind == "any":
        # Resting poses only tell how an object came to lie.
        any_up = [_Pose(each, 1.0) for each in spread]
        lying = [[*(replace(pose, weight=0.0) for pose in poses), *any_up] for poses in lying]
    elif tilted is not None:
        lying = [
            _with_tilted(poses, spread, kind) if asks else poses
            for poses, asks in zip(lying, tilted, strict=True)
        ]
    in_row = None
    if standing is not None:
        in_row = np.array([0 if pose is None else number for pose in standing], np.int32)
        own = [_Pose(poses[0].quaternion, 0.0) for poses in lying]
        # What is missing before it is the object's own frame once more.
        lying = [
            [*poses, *[mine] * (number - len(poses)), mine if pose is None else pose]
            for poses, mine, pose in zip(lying, own, standing, strict=True)
        ]
        number += 1
    bodies = [
        [_Body.of(asset, pose, cut) for pose in poses]
        for asset, poses in zip(objects, lying, strict=True)
    ]
    return _stack(bodies, number).replace(in_row=in_row)


def _poses_in_row(
    objects: Sequence[ObjectAsset],
    is_in_row: Sequence[bool],
    free: float,
    layout: Layout,
    engine: BatchEngine,
) -> list[_Pose | None]:
    """How each object stands in a row, verified as a resting pose is; None for those that never do."""
    tried = [
        [_Pose(each, 0.0) for each in row_quaternions(asset, free)] if asked else []
        for asset, asked in zip(objects, is_in_row, strict=True)
    ]
    settled = _settle(tried, objects, layout, engine, _SAME)
    # As it was turned, not as it came to rest, its thin side is along x.
    found = [
        next((pose for pose, after in zip(before, ended, strict=True) if after.is_stable), None)
        for before, ended in zip(tried, settled, strict=True)
    ]
    fallen = [
        asset.name
        for asset, asked, pose in zip(objects, is_in_row, found, strict=True)
        if asked and pose is None
    ]
    if fallen:
        raise ConfigError(
            f"a row with {', '.join(dict.fromkeys(fallen))}, which does not stand upright by itself there",
            "objects that stand on a narrow side, below what hangs over the surface",
            "other objects, or exclude=" + repr(tuple(dict.fromkeys(fallen))),
        )
    return found


@dataclass(frozen=True, eq=False)
class _Pose:
    """An orientation: wxyz f64[4], from the object frame, and with which weight it is drawn."""

    quaternion: np.ndarray
    weight: float
    is_stable: bool = True

    @property
    def matrix(self) -> np.ndarray:
        return rotation_matrix(self.quaternion)

    @property
    def up(self) -> np.ndarray:
        """f64[3]: which direction of the object points up."""
        return self.matrix[2]


def _with_tilted(poses: list[_Pose], spread: list[np.ndarray], kind: str) -> list[_Pose]:
    """An object's poses, and any directions, which are drawn only where something asks for them."""
    if kind == "upright":
        poses = [poses[0], *(replace(pose, weight=0.0) for pose in poses[1:])]
    return [*poses, *(_Pose(each, 0.0) for each in spread)]


def _resting_poses(asset: ObjectAsset) -> list[_Pose]:
    """An object's resting poses as its file has them."""
    upright, *others = asset.resting
    kept = [upright, *sorted(others, key=lambda pose: -pose.likelihood)[: MAX_RESTING - 1]]
    return [_Pose(np.array(pose.quaternion), max(pose.likelihood, _LEAST_WEIGHT)) for pose in kept]


def _left_usually(asset: ObjectAsset, poses: list[_Pose], lies: bool) -> list[_Pose]:
    """The poses with the weights of `usual_weights`."""
    way: Way | None = "lying" if lies else None
    quaternions = np.array([pose.quaternion for pose in poses])
    weights = usual_weights(asset, quaternions, np.array([pose.weight for pose in poses]), way)
    return [replace(pose, weight=weight) for pose, weight in zip(poses, weights, strict=True)]


def _stable_poses(
    recorded: list[list[_Pose]], objects: Sequence[ObjectAsset], layout: Layout, engine: BatchEngine
) -> list[list[_Pose]]:
    """Those resting poses that are stable, each as the object lies after it has settled; upright always."""
    settled = _settle(recorded, objects, layout, engine, _NEAR)
    result = []
    for index, poses in enumerate(_settle(settled, objects, layout, engine, _SAME)):
        kept = [recorded[index][0]]
        for before, pose in list(zip(settled[index], poses, strict=True))[1:]:
            is_new = max(float(pose.up @ other.up) for other in kept) < _SAME
            if before.is_stable and pose.is_stable and is_new:
                kept.append(pose)
        result.append(kept)
    return result


def _settle(
    poses: list[list[_Pose]],
    objects: Sequence[ObjectAsset],
    layout: Layout,
    engine: BatchEngine,
    likeness: float,
) -> list[list[_Pose]]:
    """How each object lies after it has settled alone from each of its poses, without a turn about z.

    Stable are those that stand, by the rule of attempts, in every turn, with an up that is as near as
    `likeness`, a cosine, to what it was.
    """
    which = [(k, p) for k, each in enumerate(poses) for p in range(len(each))]
    focus = np.repeat([k for k, _ in which], _TRIALS)
    rows = np.arange(len(focus))
    start = np.tile(np.eye(7, dtype=np.float32)[3], (len(rows), len(objects), 1))
    for row, (k, p) in enumerate(which):
        pose = poses[k][p]
        height = layout.top + _height(objects[k], pose.matrix) + _GAP
        for trial in range(_TRIALS):
            yaw = 2 * np.pi * (trial + 0.1) / _TRIALS
            turned = product(np.array(yaw_quaternion(yaw)), pose.quaternion)
            start[row * _TRIALS + trial, k] = [0.0, 0.0, height, *turned]
    is_placed = focus[:, None] == np.arange(len(objects))
    settling = engine.settle_batch(start, is_placed, focus, np.ones(len(rows), bool))
    ended = settling.poses[rows, focus, 3:].astype(np.float64).reshape(-1, _TRIALS, 4)
    is_stable = (settling.verdict == int(Verdict.STABLE)).reshape(-1, _TRIALS).all(1)
    result: list[list[_Pose]] = [[] for _ in objects]
    for row, (k, p) in enumerate(which):
        pose = poses[k][p]
        ups = np.array([rotation_matrix(each)[2] for each in ended[row]])
        stays = bool((ups @ pose.up > likeness).all())
        lies = _quaternion_of(upright_turn(ups[0]))
        result[k].append(_Pose(lies, pose.weight, bool(is_stable[row]) and stays))
    return result


def _quaternion_of(matrix: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_quat(scalar_first=True))


def _height(asset: ObjectAsset, matrix: np.ndarray) -> float:
    """Metres from the lowest point up to the origin, after a turn."""
    return -min(float((part.vertices @ matrix[2]).min()) for part in asset.parts)


def _spread() -> np.ndarray:
    """f64[N, 3]: unit vectors spread evenly over the sphere (Fibonacci's lattice)."""
    place = np.arange(NUM_SPREAD) + 0.5
    z = 1 - 2 * place / NUM_SPREAD
    angle = np.pi * (1 + 5**0.5) * place
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


@dataclass(frozen=True, eq=False)
class _Body:
    """An object in one orientation; `Orientations` says what its arrays are."""

    weight: float
    quaternion: np.ndarray
    half_extents: np.ndarray
    height: float
    center_of_mass: np.ndarray
    own_margin: float
    column_xy: np.ndarray
    column_bottom: np.ndarray
    surface: np.ndarray

    @staticmethod
    def of(asset: ObjectAsset, pose: _Pose, cut: Callable[[ObjectAsset], HeightProfile]) -> _Body:
        matrix = pose.matrix
        vertices = asset.vertices @ matrix.T
        middle = (vertices.min(0) + vertices.max(0)) / 2
        center_of_mass = matrix @ asset.center_of_mass
        # Columns are cut of what is centred on its origin.
        parts = tuple(part.transform(matrix, -middle) for part in asset.parts)
        turned = replace(asset, parts=parts, center_of_mass=center_of_mass - middle)
        columns = cut(turned)
        return _Body(
            weight=pose.weight,
            quaternion=pose.quaternion,
            half_extents=turned.half_extents,
            height=-float(vertices[:, 2].min()),
            center_of_mass=center_of_mass,
            own_margin=own_margin_of(turned),
            column_xy=columns.xy[columns.sample] + middle[:2],
            column_bottom=columns.bottom[columns.sample] + middle[2],
            surface=surface_runs((columns.surface + middle) @ matrix),
        )


_PLAIN = ("quaternion", "half_extents", "height", "center_of_mass", "own_margin")
"""What is of one size for all objects."""


def _stack(bodies: list[list[_Body]], number: int) -> Orientations:
    """Arrays of the orientations of K objects, `number` of each: the first one again for those missing."""
    full = [[*each, *[each[0]] * (number - len(each))] for each in bodies]

    def stack(of_body: Callable[[_Body], np.ndarray | float]) -> np.ndarray:
        return np.array([[of_body(body) for body in each] for each in full])

    num_columns = stack(lambda body: len(body.column_bottom))
    most = int(num_columns.max())
    runs = [max(len(body.surface) for body in each) for each in bodies]
    surfaces = []
    for each, rows in zip(full, runs, strict=True):
        # A shorter surface shows its last run again.
        longer = [body.surface[np.minimum(np.arange(rows), len(body.surface) - 1)] for body in each]
        surfaces.append(np.stack(longer, axis=1))
    is_one = np.arange(number) < np.array([len(each) for each in bodies])[:, None]
    with np.errstate(divide="ignore"):
        log_weight = np.log(np.where(is_one, stack(lambda body: body.weight), 0.0))
    return Orientations(
        is_one=is_one,
        log_weight=log_weight,
        column_xy=stack(lambda body: pad_rows(body.column_xy, most)),
        column_bottom=stack(lambda body: pad_rows(body.column_bottom, most)),
        is_column=np.arange(most) < num_columns[..., None],
        surface=np.concatenate(surfaces),
        surface_owner=np.repeat(np.arange(len(full), dtype=np.int32), runs),
        **{name: stack(attrgetter(name)) for name in _PLAIN},
    )
