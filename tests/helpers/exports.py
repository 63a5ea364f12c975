"""Scenes to export, a bank of them, and what an export of them has to say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.geometry import rotate
from cluttergen_jax.scene import Origin, Scene
from cluttergen_jax.scene.bank import BankWriter
from cluttergen_jax.scene.bank.table import SCHEMA
from cluttergen_jax.scene.export import FORMATS, Format, export_scenes
from cluttergen_jax.scene.export.mjcf import scene_xml
from tests.helpers.worlds import trio

NAMES = ("mug", "fork", "soup_can", "mug#2")
CLOSE = 1e-5
PLAIN_FORMATS = sorted(set(FORMATS) - {"rerun", "usd"})
"""Those that need no extra."""


def spread(objects, support, names=None, index=0, turn=0.7):
    """A scene of objects that stand apart on a support, each turned by another angle."""
    names = names or tuple(asset.name for asset in objects)
    poses = np.zeros((len(objects), 7))
    x, y = support.region.center
    for place, asset in enumerate(objects):
        angle = turn * (place + 1) / 2
        poses[place] = (
            x + 0.14 * (place % 2 - 0.5) * 2,
            y + 0.15 * (place // 2 - 0.5) * 2,
            support.top + asset.resting[0].height,
            np.cos(angle),
            0,
            0,
            np.sin(angle),
        )
    origin = Origin(
        bank="bank", index=index, method="clear", seed=3, verdict="stable", is_success=True
    )
    return Scene(names, tuple(objects), poses, support, origin=origin)


def dining_scene() -> Scene:
    """Four objects, one of them twice, on a table with surfaces of its own."""
    pool = find_pool("dining")
    objects = [pool[name.split("#")[0]] for name in NAMES]
    return spread(objects, find_support("round_table"), NAMES)


def exporter(scene, tmp_path_factory, **options) -> Callable[[str | Format], Path]:
    """From a format to the folder of the scene in it, each made once."""
    made = {}

    def make(format):
        if format not in made:
            made[format] = export_scenes(
                [scene],
                tmp_path_factory.mktemp("out") / f"in_{getattr(format, 'name', format)}",
                format,
                **options,
            )
        return made[format]

    return make


def matrix(pose):
    """f64[4, 4]: T_world_object of a pose."""
    result = np.eye(4)
    result[:3, :3] = rotate(np, pose[3:], np.eye(3)).T
    result[:3, 3] = pose[:3]
    return result


def assert_same_pose(position, quaternion, pose):
    """Equal position and equal turn; the quaternion's sign is nobody's business."""
    np.testing.assert_allclose(position, pose[:3], atol=CLOSE)
    sign = np.sign(np.dot(quaternion, pose[3:]))
    np.testing.assert_allclose(sign * np.asarray(quaternion), pose[3:], atol=CLOSE)


def row_of(scene, index, is_success):
    """A bank's row of a scene."""
    num = len(scene.names)
    # What an export does not look at is filled so that the row is complete.
    rest = {field.name: [0] * num if pa.types.is_list(field.type) else 0 for field in SCHEMA}
    return rest | {
        "index": index,
        "is_success": is_success,
        "is_filled": True,
        "verdict": "stable" if is_success else "crept",
        "drift": 0.0001 if is_success else 0.02,
        "num_placed": num,
        "object_index": list(range(num)),
        "objects": list(scene.names),
        "is_placed": [True] * num,
        "poses": scene.poses.tolist(),
        "attempts": [1] * num,
        "steps": [30] * num,
        "rest_steps": [30] * num,
        "simulated_steps": 90,
    }


def fourteen_scenes(
    path: Path, objects_of: Callable[[int], Sequence[ObjectAsset]] = lambda index: trio()
) -> Path:
    """A bank of which every fifth scene failed; what made them is made up, the scenes stand."""
    scenes = [spread(objects_of(index), cuboid_table(), turn=0.2 * index) for index in range(14)]
    recipe = {
        "pool": "somewhere/trio",
        "method": "random",
        "seed": 5,
        "checkpoint": None,
        "stability": asdict(StabilityConfig()),
        "contact": asdict(ContactConfig()),
        "versions": {"mujoco": mujoco.__version__},
    }
    rows = [row_of(scene, index, index % 5 != 4) for index, scene in enumerate(scenes)]
    assets = {asset.name: asset for scene in scenes for asset in scene.objects}
    with BankWriter(path, recipe, len(rows), assets, cuboid_table()) as writer:
        writer.write_block(0, pa.Table.from_pylist(rows, schema=SCHEMA))
    (path / "scenes").mkdir(exist_ok=True)
    for index, scene in enumerate(scenes):
        text = scene_xml(scene.objects, scene.poses, scene.support, scene.stability, scene.contact)
        (path / "scenes" / f"{index:06d}.xml").write_bytes(text)
    return path
