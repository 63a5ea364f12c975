"""Labels of the grasps that geometry finds in the volumes of a dataset: what a network is to choose among.

`robot dataset` draws its candidates on the true shapes. Those of a volume, which is coarse and has noise,
fail in other ways: they are a little too narrow, lean, or hold an edge that is not there. So some of each
scene are looked at and executed in the same way as in `grasp_rounds`, and a file a scene keeps them.
"""

from __future__ import annotations

import io
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping import vgn
from cluttergen_jax.downstream.robot.grasping.clutter import LiftEnd, LiftScene, StillScene
from cluttergen_jax.files import write_atomically
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from studies.benchmarks.grasp_geometry import OpenHand, VolumeGrasps, draw_with_room

# Of a scene: at most.
_NUM_LOOKED_AT = 48
_NUM_LIFTS = 16


def label_volumes(
    bank: Path, dataset: Path, out: Path, robot: str, num_scenes: int, workers: int
) -> None:
    """Makes the missing ones of the files `out/NUMBER.npz` of the first scenes of a bank.

    Args:
      dataset: of `cluttergen robot dataset`, of this bank: its volumes. robot: whose hand it is.
    """
    scenes = list(read_scenes(read_bank(bank)))[:num_scenes]
    missing = [each for each in scenes if not (out / f"{each.origin.index:06d}.npz").is_file()]
    out.mkdir(parents=True, exist_ok=True)
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        with Progress("labels", len(scenes), "scene", len(scenes) - len(missing)) as progress:
            waiting = [pool.submit(_label_scene, scene, dataset, out, robot) for scene in missing]
            for future in as_completed(waiting):
                progress.update(1, future.result())
    finally:
        pool.shutdown(cancel_futures=True)


def _label_scene(scene: Scene, dataset: Path, out: Path, robot: str) -> str:
    """Labels one scene; a note."""
    name = f"{scene.origin.index:06d}.npz"
    with np.load(dataset / "voxels/scenes" / name, allow_pickle=False) as file:
        grid = file["grid"][0]
    rng = np.random.default_rng(scene.origin.index)
    hand = OpenHand(find_robot(robot), scene.support)
    found = draw_with_room(grid, hand, _NUM_LOOKED_AT, rng)
    label = _labels_of(scene, robot, found)
    is_known = label >= 0
    kept = found.take(is_known)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, pose=kept.pose, width=kept.width, label=label[is_known])
    write_atomically(out / name, buffer.getvalue())
    return f"{int((label > 0).sum())} of {int(is_known.sum())} lift something"


def _labels_of(scene: Scene, robot: str, found: VolumeGrasps) -> np.ndarray:
    """i[C]: 1 of grasps that lift something, 0 of those that are blocked or do not, -1 of the others."""
    arm = find_robot(robot)
    T_world_task = vgn.task_frame(scene.support)
    still = StillScene(scene, arm)
    lifts = LiftScene(scene, arm)
    label = np.zeros(len(found.width), int)
    num_lifts = 0
    for row, (pose, width) in enumerate(zip(found.pose, found.width, strict=True)):
        T_world_tool = T_world_task @ pose
        if still.blocker(T_world_tool, float(width)):
            continue
        if num_lifts == _NUM_LIFTS:
            label[row] = -1
            continue
        label[row] = lifts.lift(T_world_tool, float(width)).end is LiftEnd.LIFTED
        num_lifts += 1
    return label
