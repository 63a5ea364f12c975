"""Made-up queries of placers: a box to be placed on a bare top beside another, seen from one side."""

import jax
import numpy as np

from cluttergen_jax.downstream.placer.query import Example, PlacementQuery
from cluttergen_jax.placement.heightmap import VOID, HeightMap
from cluttergen_jax.placement.search import UnderSide
from cluttergen_jax.types import Verdict

CELL = 0.01
HALF = 0.16
TALL = 0.12
"""Metres: half the region's side, and the height of the box that stands there."""
NUM_LABELS = 6


def made_up_query(standing=(0.05, 0.0), half=(0.03, 0.02, 0.04), shadow=0.05, seed=0):
    """A square region with a box of 6 x 6 cm at `standing`; behind it, towards +x, the top is not seen."""
    side = round(2 * HALF / CELL) + 2
    corner = np.full(2, -side / 2 * CELL, np.float32)
    x, y = np.meshgrid(*(corner[k] + CELL * (np.arange(side) + 0.5) for k in (0, 1)), indexing="ij")
    heights = np.zeros((side, side), np.float32)
    heights[(np.abs(x - standing[0]) < 0.03) & (np.abs(y - standing[1]) < 0.03)] = TALL
    behind = x - standing[0] - 0.03
    ceilings = np.where(
        (behind > 0) & (behind < shadow) & (np.abs(y - standing[1]) < 0.03), TALL, heights
    )
    for each in (heights, ceilings):
        each[[0, -1]] = each[:, [0, -1]] = VOID
    line = [np.linspace(-h + 2e-4, h - 2e-4, 9) for h in half[:2]]
    xy = np.stack(np.meshgrid(*line, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    rng = np.random.default_rng(seed)
    box = np.array(half, np.float32)
    cloud = (rng.uniform(-1, 1, (64, 3)) * HALF).astype(np.float32)
    return PlacementQuery(
        heights=HeightMap(heights, corner, (CELL, CELL)),
        ceilings=HeightMap(ceilings.astype(np.float32), corner, (CELL, CELL)),
        under=UnderSide(
            xy,
            np.full(len(xy), -half[2], np.float32),
            np.ones(len(xy), bool),
            np.zeros(2, np.float32),
        ),
        half_extents=box,
        center_of_mass=np.zeros(3, np.float32),
        own_margin=np.float32(min(half[:2])),
        object_cloud=(rng.uniform(-1, 1, (64, 3)) * box).astype(np.float32),
        cloud=cloud,
        cloud_mask=np.arange(64) < 50,
        region_half_extents=np.full(2, HALF, np.float32),
        height_range=np.float32(TALL + 2 * half[2]),
    )


def made_up_example(seed, **query):
    """An example of one such query: poses on the bare top stand unless they meet the box or its shadow."""
    rng = np.random.default_rng(seed)
    standing = rng.uniform(-0.08, 0.08, 2)
    asked = made_up_query(standing, seed=seed, **query)
    xy = rng.uniform(-HALF, HALF, (NUM_LABELS, 2))
    is_near = np.abs(xy - standing).max(1) < 0.07
    pose = np.column_stack([xy, np.full(NUM_LABELS, 0.041), rng.uniform(0, 6.28, NUM_LABELS)])
    target = np.array([*np.clip(-standing, -0.1, 0.1), 0.04, rng.uniform(-3, 3)], np.float32)
    verdict = np.where(is_near, int(Verdict.PENETRATING), int(Verdict.STABLE)).astype(np.uint8)
    return Example(asked, target, pose.astype(np.float32), verdict)


def made_up_examples(number, **query):
    """So many, with a leading axis."""
    return stacked([made_up_example(seed, **query) for seed in range(number)])


def stacked(parts):
    """Pytrees as one, with a leading axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *parts)
