"""Makes the picture of docs/guide/placer.md: python docs/make_proposals.py (two minutes on two cores)."""

import tempfile
from pathlib import Path

import jax
import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge, world_pose
from cluttergen_jax.downstream.placer.proposers import find_placer
from cluttergen_jax.rendering.assets import close_points
from cluttergen_jax.rendering.scene_renderer import PictureConfig, RenderStyle, open_scene_renderer
from cluttergen_jax.rendering.sheet import contact_sheet, save_png
from cluttergen_jax.sensing.camera import REALSENSE_SIZE, SIZE, Camera
from cluttergen_jax.sensing.rays import RaySensor, sensed_model
from cluttergen_jax.types import Verdict

HERE = Path(__file__).parent / "images"
GREEN = (0.1, 0.7, 0.25)
RED = (0.86, 0.1, 0.12)
SUPPORT = "table-0.40x0.50"


def looking(middle: np.ndarray, size: tuple[int, int]) -> Camera:
    """The camera of both images: one place, as many pixels as asked for."""
    eye = middle + np.array([-0.30, -0.62, 0.50])
    return Camera.looking(eye, middle, *size, focal=0.8 * size[0])


def main() -> None:
    """Four tables, the five proposals for the last object drawn into the picture: green ones would stand."""
    with tempfile.TemporaryDirectory() as folder:
        bank = cg.generate(
            Path(folder) / "bank",
            pool="household",
            support=SUPPORT,
            num_scenes=4,
            seed=2_000_000,
            max_files=0,
        )
        scenes = PartialScenes(bank)
    world = scenes.problem.world
    rng = np.random.default_rng(0)
    slot = scenes.object_index.shape[1] - 1
    episodes = scenes.episodes(np.array([[row, slot] for row in range(len(scenes.number))]))
    sensor = RaySensor(sensed_model(world.objects, world.support))
    maker = QueryMaker(scenes.problem)
    data = sensor.make_data()
    placer = jax.jit(find_placer("scored"))
    middle = np.array([*world.support.region.center, world.support.top])
    views = []
    captions = []
    for row, number in enumerate(scenes.number):
        poses = np.asarray(episodes.poses[row])
        is_placed = np.asarray(episodes.is_placed[row])
        focus = int(scenes.object_index[row, slot])
        sensor.pose(data, poses, is_placed)
        camera = looking(middle, SIZE)
        sight = maker.see(sensor.sense(data, camera).depth, camera, REALSENSE, rng)
        proposals = jax.device_get(placer(jax.random.key(row), maker.query(sight, focus)))
        judged = ProposalJudge(scenes.rules).settle(
            episodes, np.full(len(proposals.pose), row), proposals.pose
        )
        stands = judged.verdict == int(Verdict.STABLE)
        standing = np.flatnonzero(is_placed)
        ghosts = [np.asarray(world_pose(scenes.rules.region, pose)) for pose in proposals.pose]
        objects = [world.objects[k] for k in standing] + [world.objects[focus]] * len(ghosts)
        styles = [RenderStyle(poses[k]) for k in standing]
        styles += [
            RenderStyle(pose, 0.9 if rank == 0 else 0.45, GREEN if good else RED, 0.6)
            for rank, (pose, good) in enumerate(zip(ghosts, stands, strict=True))
        ]
        every = np.array([style.pose for style in styles])
        picture = PictureConfig(width=REALSENSE_SIZE[0], height=REALSENSE_SIZE[1])
        points = close_points(objects, every, world.support)
        with open_scene_renderer(objects, world.support, points, picture) as renderer:
            renderer.camera = looking(middle, REALSENSE_SIZE)
            views.append(renderer.picture(styles))
        chance = ", ".join(f"{score:.2f}" for score in proposals.score)
        captions.append(f"scene {number}, {world.names[focus]}: chances {chance}")
    sheet = Image.fromarray(contact_sheet(views, captions, columns=2))
    sheet.thumbnail((1200, 1200), Image.Resampling.LANCZOS)
    save_png(np.asarray(sheet), HERE / "proposals.png")


if __name__ == "__main__":
    main()
