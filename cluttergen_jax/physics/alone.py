"""What is let go alone on a level top: how it settles is simulated once, in some turns, and known after that.

Where nothing but a level top is within reach every place is like every other, and so is every turn about z:
contacts depend on the object and the top alone. What came to rest alike in all of its trials does so there.
The first part of a scene's last check takes none of this on trust: everything is awake in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import mujoco
import numpy as np

from cluttergen_jax.geometry import conjugate, convex_hull, cross_2d, product, rotate, unit
from cluttergen_jax.physics.convex_outlines import corners_of_geom, corners_of_parts
from cluttergen_jax.physics.host import empty_settling
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.types import Settling, Verdict

if TYPE_CHECKING:
    from cluttergen_jax.physics.native import NativePhysics

ROOM = 0.002
"""Metres that outlines have to be apart in plan, and a base inside of a top."""
RELEASE_GAP = 0.001
"""Metres above a top at which rules let go of what is to stand there; of other heights nothing is known."""
_SAME_GAP = 2e-5

_TRIAL_YAWS = np.radians([0, 67, 131, 194, 259, 318])
_TRIAL_GAPS = RELEASE_GAP * np.array([1, 0.1, 0.5, 1, 2, 3])
"""Radians and metres of an object's trials. The first is what rules do, and the others have to end alike."""
_OTHER_TRIALS = 3
"""Of which the ends are checked with the second detector, too."""

# Metres and sines by which the ends of two trials may differ, and metres that an object may move meanwhile.
_SAME_SHIFT = 1e-4
_SAME_TILT = 2e-3
_MOST_MOVED = 1e-3

# Metres and sines by which what stands on a top may differ from how it came to rest in its trials.
_AT_REST_SHIFT = 2e-5
_AT_REST_TILT = 2e-4

_UPRIGHT = 1e-6
"""Parts x and y of the quaternion of what is turned about z alone, at most."""
_SETTLED = 1e-3
"""Those of what has settled upright: its outline is that of its own frame, to a fraction of `ROOM`."""
_SIDES = 24
"""Of the polygon that stands for an object's outline: around it, so that nothing is nearer than it seems."""
_FLAT = 1e-5
"""Metres by which the corners of a level face may differ in height."""


class LevelTop(NamedTuple):
    """A level face on top of one geom of the support.

    Attributes:
      inwards: f64[E, 2], unit normals of its E sides in plan; offset: f64[E], metres: a point p is inside of
        each by inwards . p + offset.
      height: metres.
      middle: f64[2], of those tried the place with the most room around it.
      lower, upper: f64[B, 2], boxes in plan around all else of the support that reaches above it.
    """

    inwards: np.ndarray
    offset: np.ndarray
    height: float
    middle: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class _Found(NamedTuple):
    """M objects that stand alone over level tops.

    Attributes:
      scene, number, top: i64[M], the scene's row and the numbers of the object and of the top.
      poses: f64[M, 7].
    """

    scene: np.ndarray
    number: np.ndarray
    top: np.ndarray
    poses: np.ndarray

    def only(self, is_kept: np.ndarray) -> _Found:
        """Those of bool[M]."""
        return _Found(*(each[is_kept] for each in self))


class _Rests(NamedTuple):
    """How M objects settle alone on level tops, turned by 0 and let go over the origin.

    Attributes:
      is_known: bool[M], all trials stood and ended alike; without it the others mean nothing.
      stands_otherwise: bool[M], they stand with the second detector, too.
      poses: f64[M, 7], at rest, heights above the top.
      settling: of the first trial, with the least margin of all of them.
    """

    is_known: np.ndarray
    stands_otherwise: np.ndarray
    poses: np.ndarray
    settling: Settling


class Alone:
    """Tells what is alone on a level top of one compiled world, and how it settles there.

    Args:
      engine: simulates the trials; it is held, and silent, whenever this is asked something.
    """

    def __init__(self, engine: NativePhysics) -> None:
        layout = engine.layout
        self._engine = engine
        self._tops = level_tops(layout)
        self._heights = np.array([top.height for top in self._tops])
        self._row = np.full((layout.num_objects, len(self._tops)), -1)
        self._known: _Rests | None = None
        parts = [corners_of_parts(layout, index) for index in range(layout.num_objects)]
        corners = [np.concatenate(each) for each in parts]
        self._bottom = np.array([-each[:, 2].min() for each in corners])
        self._sphere = np.array([np.linalg.norm(each, axis=1).max() for each in corners])
        self._circle = np.array([np.linalg.norm(each[:, :2], axis=1).max() for each in corners])
        self._outline = np.stack([_outline(each[:, :2]) for each in corners])
        meets = _TRIAL_GAPS.max() + _MOST_MOVED - self._bottom
        bases = [_below(*each) for each in zip(parts, meets, strict=True)]
        self._base = np.stack([_outline(each[:, :2]) for each in bases])

    def settle(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        focus: np.ndarray,
        result: Settling,
        block: np.ndarray,
    ) -> np.ndarray:
        """Which of n attempts need not be simulated, bool[n]; their reports are written into `result`.

        Args:
          poses: f[n, K, 7]; is_placed: bool[n, K]; focus: i[n], placed.
          result: where the attempts' rows are `block`, with the poses of the release.
        """
        rows = np.arange(len(poses))
        gaps = (RELEASE_GAP - _SAME_GAP, RELEASE_GAP + _SAME_GAP)
        found = self._find(poses, is_placed, rows, focus, _UPRIGHT, gaps)
        is_decided = np.zeros(len(poses), bool)
        if not len(found.scene):
            return is_decided
        rests = self._rests(found)
        overlap = self._overlaps(poses, is_placed, found)
        config = self._engine.config
        allowed = min(config.max_added_penetration, config.max_penetration)
        is_known = rests.is_known & (overlap <= allowed)
        found, rests = jax.tree.map(lambda each: each[is_known], (found, rests))
        is_decided[found.scene] = True
        found = found._replace(scene=block[found.scene])
        self._report(found, rests, result)
        result.penetration[found.scene] = np.maximum(rests.settling.penetration, overlap[is_known])
        return is_decided

    def rest(self, poses: np.ndarray, is_placed: np.ndarray) -> np.ndarray:
        """Which objects rest alone on a level top where they stand with the second detector, bool[n, K].

        Args:
          poses: f[n, K, 7]; is_placed: bool[n, K].
        """
        gaps = (-_MOST_MOVED, _MOST_MOVED)
        scene, number = np.nonzero(is_placed)
        found = self._find(poses, is_placed, scene, number, _SETTLED, gaps)
        is_resting = np.zeros(is_placed.shape, bool)
        if len(found.scene):
            rests = self._rests(found)
            above = found.poses[:, 2] - self._heights[found.top] - rests.poses[:, 2]
            is_like = np.abs(above) <= _AT_REST_SHIFT
            is_like &= _tilt(found.poses[:, 3:], rests.poses[:, 3:]) <= _AT_REST_TILT
            is_resting[found.scene, found.number] = rests.stands_otherwise & is_like
        return is_resting

    def _find(
        self,
        poses: np.ndarray,
        is_placed: np.ndarray,
        scene: np.ndarray,
        index: np.ndarray,
        most_tilted: float,
        gaps: tuple[float, float],
    ) -> _Found:
        """Those of the objects `index` of scenes `scene`, i[M], that stand alone over a level top.

        Args:
          most_tilted: of the quaternion's parts x and y; gaps: metres above the top of its lowest point.
        """
        own = poses[scene, index].astype(np.float64)
        found = _Found(scene, index, self._tops_under(own, index, gaps), own)
        found = found.only((found.top >= 0) & _is_upright(own, most_tilted))
        return found.only(self._has_room(poses, is_placed, found))

    def _tops_under(
        self, own: np.ndarray, index: np.ndarray, gaps: tuple[float, float]
    ) -> np.ndarray:
        """The number of the level top that all of each upright object's base is over, i64[M]; -1 for none."""
        number = np.full(len(own), -1)
        base = _in_plan(self._base[index], own)
        reach = self._circle[index] + ROOM
        for place, top in enumerate(self._tops):
            gap = own[:, 2] - self._bottom[index] - top.height
            inside = base @ top.inwards.T + top.offset
            is_over = (gap >= gaps[0]) & (gap <= gaps[1]) & (inside >= ROOM).all((1, 2))
            number[is_over & (_beyond(top, own[:, :2]) >= reach) & (number < 0)] = place
        return number

    def _has_room(self, poses: np.ndarray, is_placed: np.ndarray, found: _Found) -> np.ndarray:
        """Whether nothing that is placed is within reach of them in plan, bool[M]."""
        others = is_placed[found.scene]
        others[np.arange(len(others)), found.number] = False
        row, other = np.nonzero(others)
        is_near = self._are_near(poses, found.scene[row], found.number[row], other)
        has_room = np.ones(len(others), bool)
        has_room[row[is_near]] = False
        return has_room

    def _overlaps(self, poses: np.ndarray, is_placed: np.ndarray, found: _Found) -> np.ndarray:
        """The deepest overlap among the others of each scene, f64[M], metres; infinite where untold."""
        others = is_placed[found.scene]
        others[np.arange(len(others)), found.number] = False
        row, one, other = np.nonzero(np.triu(others[:, :, None] & others[:, None], 1))
        is_near = self._are_near(poses, found.scene[row], one, other)
        deepest = np.zeros(len(others))
        for near in np.unique(row[is_near]):
            depths = self._engine.probe.depths(poses[found.scene[near]], others[near])
            deepest[near] = np.inf if depths is None else depths.max()
        return deepest

    def _are_near(
        self, poses: np.ndarray, scene: np.ndarray, one: np.ndarray, other: np.ndarray
    ) -> np.ndarray:
        """Whether two objects of a scene are within reach of one another in plan, bool[P].

        Args:
          poses: f[n, K, 7]; scene, one, other: i64[P], the scene's row and the numbers of both.
        """
        is_upright = _is_upright(poses, _SETTLED)
        # What is tilted has no outline here, and is near where its sphere is.
        reach = np.where(is_upright, self._circle, self._sphere)
        apart = np.linalg.norm(poses[scene, one, :2] - poses[scene, other, :2], axis=1)
        is_near = apart < reach[scene, one] + reach[scene, other] + ROOM
        near = np.flatnonzero(is_near)
        near = near[is_upright[scene[near], one[near]] & is_upright[scene[near], other[near]]]
        first = _in_plan(self._outline[one[near]], poses[scene[near], one[near]])
        second = _in_plan(self._outline[other[near]], poses[scene[near], other[near]])
        is_near[near] = _widest_gap(first, second) < ROOM
        return is_near

    def _rests(self, found: _Found) -> _Rests:
        """How they settle; what is asked for the first time is simulated now."""
        asked = np.unique(np.stack([found.number, found.top], axis=1), axis=0)
        new = asked[self._row[asked[:, 0], asked[:, 1]] < 0]
        size = max(self._engine.max_simulations // len(_TRIAL_YAWS), 1)
        for first in range(0, len(new), size):
            some = new[first : first + size]
            learned = self._try(some[:, 0], some[:, 1])
            start = 0 if self._known is None else len(self._known.is_known)
            self._row[some[:, 0], some[:, 1]] = start + np.arange(len(some))
            self._known = (
                learned
                if self._known is None
                else jax.tree.map(lambda *each: np.concatenate(each), self._known, learned)
            )
        rows = self._row[found.number, found.top]
        return jax.tree.map(lambda each: each[rows], self._known)

    def _try(self, objects: np.ndarray, tops: np.ndarray) -> _Rests:
        """Simulates the trials of objects on tops, i64[M] each."""
        engine = self._engine
        num_trials = len(_TRIAL_YAWS)
        rows = np.arange(num_trials * len(objects))
        index = np.repeat(objects, num_trials)
        yaw = np.tile(_TRIAL_YAWS, len(objects))
        base = np.zeros((len(rows), 3))
        base[:, :2] = np.stack([top.middle for top in self._tops])[np.repeat(tops, num_trials)]
        base[:, 2] = self._heights[np.repeat(tops, num_trials)]
        poses = np.tile(engine.layout.parked, (len(rows), 1, 1))
        poses[rows, index, :3] = base
        poses[rows, index, 2] += self._bottom[index] + np.tile(_TRIAL_GAPS, len(objects))
        poses[rows, index, 3:] = _about_z(yaw)
        is_placed = np.zeros(poses.shape[:2], bool)
        is_placed[rows, index] = True
        settling = empty_settling(np, (len(rows),), poses.shape[1], engine.config)
        settling.poses[:] = poses
        engine.settle_block(poses, is_placed, index, settling, rows)
        ends = settling.poses[rows, index].astype(np.float64)
        ends[:, :3] -= base
        turned_back = _turn(-yaw, ends)
        first = rows - rows % num_trials
        shift = np.linalg.norm(turned_back[:, :3] - turned_back[first, :3], axis=1)
        is_like = (settling.verdict == int(Verdict.STABLE)) & (shift <= _SAME_SHIFT)
        is_like &= _tilt(turned_back[:, 3:], turned_back[first, 3:]) <= _SAME_TILT
        is_like &= np.linalg.norm(ends[:, :2], axis=1) <= _MOST_MOVED
        is_known = is_like.reshape(-1, num_trials).all(1)
        is_asked = (rows % num_trials < _OTHER_TRIALS) & np.repeat(is_known, num_trials)
        stands = np.ones(len(rows), bool)
        stands[is_asked] = engine.stands_otherwise(settling.poses[is_asked], is_placed[is_asked])
        settling.trajectory[..., :3] -= base[:, None]
        # Where its base hardly touches at one corner, trials differ in that.
        margin = settling.margin[rows, index].reshape(-1, num_trials).min(1)
        settling.margin[rows, index] = np.repeat(margin, num_trials)
        return _Rests(
            is_known,
            is_known & stands.reshape(-1, num_trials).all(1),
            turned_back[::num_trials],
            jax.tree.map(lambda each: each[::num_trials], settling),
        )

    def _report(self, found: _Found, rests: _Rests, result: Settling) -> None:
        """Writes what is known of their attempts into `result`."""
        settling = rests.settling
        scene = found.scene
        release = found.poses
        yaw = 2 * np.arctan2(release[:, 6], release[:, 3])
        base = np.concatenate([release[:, :2], self._heights[found.top][:, None]], axis=1)
        for into, each in zip(jax.tree.leaves(result), jax.tree.leaves(settling), strict=True):
            if into is not result.poses:
                into[scene] = each
        ends = _turn(yaw, rests.poses)
        ends[:, :3] += base
        result.poses[scene, found.number] = ends
        path = settling.trajectory.astype(np.float64)
        path[..., :7] = _turn(yaw[:, None], path[..., :7])
        for part in (slice(7, 10), slice(10, 13)):
            path[..., part] = rotate(np, _about_z(yaw)[:, None], path[..., part])
        path[..., :3] += base[:, None]
        path[:, 0, :7] = release
        path[np.arange(path.shape[1]) > settling.num_steps[:, None]] = 0.0
        result.trajectory[scene] = path


def level_tops(layout: Layout) -> list[LevelTop]:
    """The level faces on which objects could stand alone."""
    model = layout.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(layout.geom_object == layout.num_objects)
    corners = [
        corners_of_geom(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        for geom in geoms.tolist()
    ]
    tops = []
    for place, own in enumerate(corners):
        height = float(own[:, 2].max())
        face = own[own[:, 2] > height - _FLAT, :2]
        is_round = model.geom_type[geoms[place]] not in _WITH_CORNERS
        if is_round or np.linalg.matrix_rank(face - face[0], _FLAT) < 2:
            continue
        hull = np.array(convex_hull(face))
        side = np.roll(hull, -1, axis=0) - hull
        inwards = unit(np.stack([-side[:, 1], side[:, 0]], axis=1))
        above = [each for at, each in enumerate(corners) if at != place]
        above = [each[:, :2] for each in above if each[:, 2].max() > height + _FLAT]
        top = LevelTop(
            inwards=inwards,
            offset=-(inwards * hull).sum(1),
            height=height,
            middle=hull.mean(0),
            lower=np.array([each.min(0) for each in above]).reshape(-1, 2),
            upper=np.array([each.max(0) for each in above]).reshape(-1, 2),
        )
        shares = np.stack(np.meshgrid(*[np.linspace(0, 1, _PLACES)] * 2), axis=-1).reshape(-1, 2)
        low = face.min(0)
        places = np.concatenate([top.middle[None], low + shares * (face.max(0) - low)])
        room = np.minimum((places @ top.inwards.T + top.offset).min(1), _beyond(top, places))
        tops.append(top._replace(middle=places[room.argmax()]))
    return tops


def _beyond(top: LevelTop, places: np.ndarray) -> np.ndarray:
    """f64[M]: how far places f64[M, 2] are, in x or y, from all that reaches above a top."""
    at = places[:, None]
    beyond = np.maximum(top.lower - at, at - top.upper).max(2, initial=-np.inf)
    return beyond.min(1, initial=np.inf)


_PLACES = 15
"""Along each side of a face, of which the one with the most room is taken for trials."""
_WITH_CORNERS = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH))


def _outline(points: np.ndarray) -> np.ndarray:
    """f64[D, 2]: corners of a polygon around points f64[V, 2], whose D sides are at equal angles."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    reach = (points @ across.T).max(0)
    turn = 2 * np.pi / _SIDES
    # Each side ends where the next one begins.
    end = (np.roll(reach, -1) - reach * np.cos(turn)) / np.sin(turn)
    return reach[:, None] * across + end[:, None] * along


def _below(parts: list[np.ndarray], height: float) -> np.ndarray:
    """f64[V, 3]: corners of what of convex parts, f64[v, 3] each, is below a height: no more meets a top."""
    found = []
    for points in parts:
        is_below = points[:, 2] <= height
        low = points[is_below]
        high = points[~is_below]
        share = (height - low[:, None, 2:]) / (high[:, 2:] - low[:, None, 2:])
        # Where what connects a lower and a higher corner passes through that height.
        cut = low[:, None] + share * (high - low[:, None])
        found.extend([low, cut.reshape(-1, 3)])
    return np.concatenate(found)


def _is_upright(poses: np.ndarray, most: float) -> np.ndarray:
    """bool[...]: whether parts x and y of the quaternions of f[..., 7] are so small."""
    return (np.abs(poses[..., 4:6]) <= most).all(-1)


def _about_z(yaw: np.ndarray) -> np.ndarray:
    """f64[..., 4]: the quaternions of turns about z."""
    nothing = np.zeros_like(yaw)
    return np.stack([np.cos(yaw / 2), nothing, nothing, np.sin(yaw / 2)], axis=-1)


def _turn(yaw: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """f64[..., 7]: poses turned about the world's z."""
    turn = np.broadcast_to(_about_z(yaw), (*poses.shape[:-1], 4))
    return np.concatenate(
        [rotate(np, turn, poses[..., :3]), product(turn, poses[..., 3:])], axis=-1
    )


def _tilt(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[M]: how far apart gravity is in the frames of two orientations, f64[M, 4] each."""
    up = np.array([0.0, 0.0, 1.0])
    return np.linalg.norm(rotate(np, conjugate(one), up) - rotate(np, conjugate(other), up), axis=1)


def _in_plan(outline: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """f64[M, C, 2]: outlines f64[M, C, 2] of upright objects where they stand, at f64[M, 7]."""
    yaw = 2 * np.arctan2(poses[:, 6], poses[:, 3])
    cos = np.cos(yaw)[:, None]
    sin = np.sin(yaw)[:, None]
    x = cos * outline[..., 0] - sin * outline[..., 1]
    y = sin * outline[..., 0] + cos * outline[..., 1]
    return np.stack([x, y], axis=-1) + poses[:, None, :2]


def _widest_gap(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[P]: the widest gap between two convex outlines, f64[P, C, 2] each, across a side of either.

    Metres; negative where they overlap. Between two corners it is less than their distance.
    """
    return np.maximum(_gap_across(one, other), _gap_across(other, one))


def _gap_across(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[P]: the widest gap across a side of `one`, whose corners go round counter-clockwise."""
    side = np.roll(one, -1, axis=1) - one
    length = np.linalg.norm(side, axis=-1)
    beyond = cross_2d(other[:, None] - one[:, :, None], side[:, :, None]).min(2)
    # Sides that have shrunk to a corner tell nothing.
    return np.where(length > _FLAT, beyond / np.maximum(length, _FLAT), -np.inf).max(1)
