"""A bank of hand-made scenes that really stand, for placers: three objects apart on a table."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.spatial import ConvexHull

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.geometry import yaw_quaternion
from cluttergen_jax.learning.methods import Method
from cluttergen_jax.scene.bank import Bank, read_bank
from cluttergen_jax.scene.bank.table import SCHEMA
from tests.helpers import banks
from tests.helpers.problems import trio_problem
from tests.helpers.worlds import TOP, trio

PLACES = np.array([[-0.18, -0.2], [0.0, 0.2], [0.18, -0.1]])


def seen_trio() -> list[ObjectAsset]:
    """The trio with surfaces, which a camera sees, and points on them."""
    return [with_surface(asset) for asset in trio()]


def with_surface(asset: ObjectAsset) -> ObjectAsset:
    vertices = asset.parts[0].vertices
    hull = ConvexHull(vertices)
    outward = np.einsum(
        "ij,ij->i",
        np.cross(*np.diff(vertices[hull.simplices], axis=1).swapaxes(0, 1)),
        hull.equations[:, :3],
    )
    faces = np.where(outward[:, None] > 0, hull.simplices, hull.simplices[:, ::-1])
    points = np.resize(vertices, (1024, 3)).astype(np.float32)
    return replace(asset, pieces=(Piece(Mesh(vertices, faces)),), cloud=points)


def write_bank(
    path: Path, num_scenes: int = 4, seed: int = 0, is_success: bool = True, spread: float = 1.0
) -> Bank:
    """Writes a bank of scenes that stand, of the seed's split, or that are said to have failed.

    Args:
      spread: how far from the middle of the table objects are, 1 as `PLACES` has it.
    """
    recipe = recipe_of(trio_problem(), Method("made by hand"), seed)
    rows = [_row(index, seed, spread) | {"is_success": is_success} for index in range(num_scenes)]
    objects = {asset.name: asset for asset in seen_trio()}
    with banks.writer(path, num_scenes, recipe=recipe, objects=objects) as bank:
        bank.write_block(0, pa.Table.from_pylist(rows, schema=SCHEMA))
    return read_bank(path)


def _row(index: int, seed: int, spread: float) -> dict:
    rng = np.random.default_rng((seed, index))
    order = rng.permutation(3)
    xy = spread * (PLACES + rng.uniform(-0.05, 0.05, (3, 2)))
    height = [TOP + trio()[each].half_extents[2] for each in order]
    poses = [
        [*place, z, *yaw_quaternion(yaw)]
        for place, z, yaw in zip(xy[order], height, rng.uniform(0, 6, 3), strict=True)
    ]
    names = [trio()[each].name for each in order]
    return banks.rows(0, 1).to_pylist()[0] | {
        "index": index,
        "object_index": order.tolist(),
        "objects": names,
        "poses": poses,
    }


if __name__ == "__main__":
    write_bank(Path(sys.argv[1]), int(sys.argv[2]))
