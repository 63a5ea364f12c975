"""Makes the pictures of the README and the gallery: python docs/make_images.py (minutes on two cores)."""

from pathlib import Path

import jax
import numpy as np

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support, list_supports
from cluttergen_jax.placement.baselines import make_proposer
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.rollout import BlockSampler
from cluttergen_jax.rendering.assets import object_sheet, render_scene
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

HERE = Path(__file__).parent / "images"
POOLS = ("dining", "study", "office", "kitchen", "household")
SCENES = (
    ("dining", "table", 10, "drop"),
    ("study", "drawer_desk", 10, "clear"),
    ("kitchen", "trestle_table", 10, "clear"),
    ("office", "l_desk", 10, "clear"),
    ("household", "round_table", 10, "drop"),
    ("all", "table-0.60x0.70", 20, "drop"),
)


def draw(pool: str, support: str, num_objects: int, method: str) -> np.ndarray:
    """The first success of seed 0, drawn close."""
    placement = PlacementConfig(num_objects=num_objects, history_stride=0)
    problem = make_problem(ProblemConfig(pool=pool, support=support, placement=placement))
    sampler = BlockSampler(problem.rules, make_proposer(method, problem.rules))
    scenes = jax.device_get(jax.jit(sampler.sample)(jax.random.key(0), np.arange(8), np.ones(8, bool)))
    place = int(np.flatnonzero(scenes.is_success)[0])
    objects = [problem.world.objects[index] for index in scenes.object_index[place]]
    return render_scene(
        objects,
        scenes.poses[place],
        problem.world.support,
        close=True,
        width=720,
        height=540,
        samples=64,
    )


def draw_support(name: str) -> np.ndarray:
    """A support alone."""
    return render_scene([], np.zeros((0, 7)), find_support(name), width=480, height=360, samples=16)


def main() -> None:
    """Draws every picture."""
    captions = [f"{pool}: {n} objects on {support}, {method}" for pool, support, n, method in SCENES]
    save_png(contact_sheet([draw(*scene) for scene in SCENES], captions, columns=3), HERE / "scenes.png")
    for pool in POOLS:
        save_png(object_sheet(find_pool(pool).objects, columns=5), HERE / f"{pool}.png")
    supports = sorted(list_supports())
    drawn = [draw_support(name) for name in supports]
    save_png(contact_sheet(drawn, supports, columns=4), HERE / "supports.png")


if __name__ == "__main__":
    main()
