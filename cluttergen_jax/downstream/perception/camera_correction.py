"""Corrects where a camera is said to be: most objects still stand where they were known to stand.

A stated orientation that is wrong by a degree moves a far corner of the table by a centimetre. The table
itself tells tilt and height (`finder.upright_at_its_place`); what stands on it tells the rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cluttergen_jax.downstream.perception.pose.compare import Comparer
from cluttergen_jax.downstream.perception.pose.models import ObjectModel
from cluttergen_jax.downstream.perception.pose.registration import FEWEST_PIXELS, SURE
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.views import View

FEWEST_KNOWN = 3
"""Objects that must be seen near where they are known to be; with fewer nothing is corrected."""
_STEPS = (0.008, 0.004, 0.002, 0.001)
"""Metres by which an object is sought about its place, one after another."""
# Metres and radians that a camera may well be wrong by in plan.
_SHIFT = 0.01
_TURN = np.radians(1)

_PLACED = 0.002
"""Metres that an object is usually seen beside its place; one much farther off counts for little."""
_ROUNDS = 10


def correct_camera(
    look: View, known: dict[int, tuple[ObjectModel, np.ndarray]], share: float = 1.0
) -> View:
    """The look with its camera moved in plan and turned about the vertical: objects are where they were.

    Args:
      look: with masks of the objects.
      known: by number, the object and its pose f64[4, 4], T_world_object; what has moved since is outvoted
        by the others.
      share: of the way that the camera is brought there.
    """
    found = {
        number: _seen_beside(look, number, model, pose) for number, (model, pose) in known.items()
    }
    found = {number: shift for number, shift in found.items() if shift is not None}
    if len(found) < FEWEST_KNOWN:
        return look
    places = np.array([known[number][1][:2, 3] for number in found])
    middle = places.mean(0)
    shift, turn = _motion(places - middle, -np.array(list(found.values())))
    T = look.camera.T_world_camera.copy()
    R = yaw_matrix(share * turn)
    T[:3, :3] = R @ T[:3, :3]
    T[:2, 3] = middle + R[:2, :2] @ (T[:2, 3] - middle) + share * shift
    return replace(look, camera=replace(look.camera, T_world_camera=T))


def _seen_beside(
    look: View, number: int, model: ObjectModel, pose: np.ndarray
) -> np.ndarray | None:
    """f64[2], metres: how far from its pose an object agrees best with a look; None if it agrees nowhere."""
    if look.mask(number).sum() < FEWEST_PIXELS:
        return None
    compare = Comparer(model, number, [look])
    shift = np.zeros(2)

    def score(shift: np.ndarray) -> float:
        moved = pose.copy()
        moved[:2, 3] += shift
        return compare(moved).score

    best = score(shift)
    for step in _STEPS:
        for move in step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
            if (tried := score(shift + move)) > best:
                best = tried
                shift = shift + move
    return shift if best >= SURE else None


def _motion(places: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, float]:
    """f64[2], metres, and radians: the motion in plan, about the origin, on which most of n points agree.

    Args:
      places, moves: f64[n, 2], of each point.
    """
    rows = np.zeros((len(places), 2, 3))
    rows[:, :, :2] = np.eye(2)
    rows[:, :, 2] = np.column_stack([-places[:, 1], places[:, 0]])
    usual = np.diag([_SHIFT, _SHIFT, _TURN])
    motion = np.zeros(3)
    for _ in range(_ROUNDS):
        off = np.linalg.norm(moves - rows @ motion, axis=1)
        weight = 1 / (_PLACED**2 + off**2)
        matrix = np.einsum("n,nij,nik->jk", weight, rows, rows) + np.linalg.inv(usual) ** 2
        motion = np.linalg.solve(matrix, np.einsum("n,nij,ni->j", weight, rows, moves))
    return motion[:2], float(motion[2])
