"""Small scenes with a known right answer: a stack, a heavy box on a light one, a bowl, a book, a slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import add_object, add_support, new_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from studies.benchmarks.bodies import apple, box

_TOP = 0.5
_SETTLE_SECONDS = 1.0
_WATCH_SECONDS = 10.0
_SLOPE_DEGREES = 10.0
_SLOPE_SECONDS = 5.0
_SLID = 0.01

Placed = Sequence[tuple[ObjectAsset, float]]
"""Objects over the origin, each with the height of its own origin above the top, metres."""


@dataclass(frozen=True)
class Rest:
    """How a small scene stood for ten seconds after one of settling: metres, all of it."""

    creep: float
    penetration: float


@dataclass(frozen=True)
class SmallScenes:
    """What the hand-built scenes show about one contact configuration.

    Attributes:
      stack: five equal boxes (200 g) on one another.
      heavy: 2 kg on 30 g.
      bowl: an apple in a bowl; None if the pools hold no bowl.
      book: a mug on a book; None if the pools hold no such pair.
      slope_speed: m/s at which a box creeps down a slope of 10 degrees.
      slides_at: degrees at which it slides, straight down its sides and across its corner.
    """

    stack: Rest
    heavy: Rest
    bowl: Rest | None
    book: Rest | None
    slope_speed: float
    slides_at: tuple[float, float]


def small_scenes(contact: ContactConfig, known: dict[str, ObjectAsset]) -> SmallScenes:
    """Runs them all; `known` are the pools' objects by name."""
    brick = [box(f"brick-{index}", (0.04, 0.04, 0.025), 0.2) for index in range(5)]
    light = box("light", (0.04, 0.04, 0.02), 0.03)
    heavy = box("heavy", (0.04, 0.04, 0.05), 2.0)
    bowl = known.get("bowl")
    book = known.get("hardback_book")
    mug = known.get("mug")
    fruit = apple("apple", 0.035, 0.15)
    return SmallScenes(
        stack=_rest(contact, _piled(brick)),
        heavy=_rest(contact, _piled([light, heavy])),
        bowl=_rest(contact, [(bowl, float(bowl.half_extents[2])), (fruit, 0.06)], 6.0)
        if bowl
        else None,
        book=_rest(contact, _piled([book, mug])) if book and mug else None,
        slope_speed=_slope_speed(contact),
        slides_at=(_slides_at(contact, 0.0), _slides_at(contact, math.pi / 4)),
    )


def _piled(objects: Sequence[ObjectAsset]) -> Placed:
    """Each object on top of the one before, touching."""
    height = 0.0
    placed = []
    for asset in objects:
        half = float(asset.half_extents[2])
        placed.append((asset, height + half))
        height += 2 * half
    return placed


def _simulation(contact: ContactConfig, placed: Placed) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = new_spec(StabilityConfig().timestep, contact)
    add_support(spec, cuboid_table(2.0, 2.0, _TOP))
    for asset, height in placed:
        add_object(spec, asset, asset.name).pos = (0.0, 0.0, _TOP + height)
    model = spec.compile()
    return model, mujoco.MjData(model)


def _run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))


def _positions(data: mujoco.MjData) -> np.ndarray:
    return data.qpos.reshape(-1, 7)[:, :3].copy()


def _rest(contact: ContactConfig, placed: Placed, settle_seconds: float = _SETTLE_SECONDS) -> Rest:
    model, data = _simulation(contact, placed)
    _run(model, data, settle_seconds)
    start = _positions(data)
    creep = 0.0
    for _ in range(20):
        _run(model, data, _WATCH_SECONDS / 20)
        creep = max(creep, float(np.linalg.norm(_positions(data) - start, axis=1).max()))
    mujoco.mj_forward(model, data)
    return Rest(creep, float(max(-data.contact.dist.min(), 0.0)) if data.ncon else 0.0)


def _on_slope(
    contact: ContactConfig, degrees: float, across: float
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A flat box at rest on a table, gravity tilted as if the table were; `across` turns it about z."""
    model, data = _simulation(contact, _piled([box("brick", (0.04, 0.04, 0.01), 0.2)]))
    _run(model, data, _SETTLE_SECONDS)
    tilt = math.radians(degrees)
    side = np.array([math.cos(across), math.sin(across)]) * math.sin(tilt)
    model.opt.gravity = contact.gravity * np.array([*side, -math.cos(tilt)])
    return model, data


def _slope_speed(contact: ContactConfig) -> float:
    model, data = _on_slope(contact, _SLOPE_DEGREES, 0.0)
    _run(model, data, _SETTLE_SECONDS)
    start = _positions(data)
    _run(model, data, _SLOPE_SECONDS)
    return float(np.linalg.norm(_positions(data) - start)) / _SLOPE_SECONDS


def _slides_at(contact: ContactConfig, across: float) -> float:
    """The smallest tilt, to half a degree, at which the box is 10 mm away after a second."""
    right = math.degrees(math.atan(contact.friction[0]))
    for degrees in np.arange(max(math.floor(right) - 12.0, 1.0), right + 8.0, 0.5):
        model, data = _on_slope(contact, float(degrees), across)
        start = _positions(data)
        _run(model, data, 1.0)
        if np.linalg.norm(_positions(data) - start) > _SLID:
            return float(degrees)
    return math.inf
