# %% [markdown]
# # Your own placer, grasps, planner and observer
# A simulated arm (extra `robot`) that uses your parts in place of ours: functions or objects that can be
# called, of NumPy, PyTorch or JAX. Rows of different parts are never mixed: another one needs another folder.

# %%
import itertools

import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.downstream.rearrange.observe import SceneEstimate

num_episodes = 5
bank = cg.generate(
    "own/bank", pool="household", num_scenes=num_episodes, num_objects=4, render=False, max_files=0
)

# %% [markdown]
# **A placer** is asked where the object that the arm holds could go, by what its depth cameras have seen
# (`PlacementQuery`: maps of heights, clouds of points, the object's box), in the region's frame. It returns
# up to five poses, the best first. This one takes places that are far from anything higher than 1 cm.


# %%
def widest_gap(rng, query):
    half = query.region_half_extents - query.half_extents[:2].max()
    xy = rng.uniform(-half, half, (256, 2))
    heights = query.heights
    i, j = np.nonzero(heights.height > 0.01)
    seen = heights.corner + heights.cell * (np.stack([i, j], 1) + 0.5)
    away = np.linalg.norm(xy[:, None] - seen, axis=-1).min(1, initial=1.0)
    best = np.argsort(-away)[:5]
    return np.column_stack(
        [xy[best], np.full(5, query.half_extents[2]), rng.uniform(-np.pi, np.pi, 5)]
    )


print(cg.robot.place("own/placer", bank.path, placer=widest_gap, num_episodes=num_episodes))

# %% [markdown]
# **Grasps** are poses of the tool in the object's frame (z is the approach, the fingers close along y), and
# metres between the fingers. These come straight from above, across the narrow side; they are not tested.


# %%
def from_above(asset):
    turns = [[0, 1, 0, 0], [0, np.sqrt(0.5), np.sqrt(0.5), 0]]
    sides = 2 * np.array([asset.half_extents[1], asset.half_extents[0]])
    fits = sides < 0.07
    depth = max(0.0, asset.half_extents[2] - 0.03)
    poses = np.array([[0, 0, depth, *turn] for turn in turns])
    return (poses[fits], sides[fits] + 0.005) if fits.any() else (poses[:1], [0.08])


grasps = {asset.name: from_above(asset) for asset in cg.load_pool("household").objects}
print(
    cg.robot.place("own/grasps", bank.path, placer="none", grasps=grasps, num_episodes=num_episodes)
)

# %% [markdown]
# **A planner** finds the paths between places, in joint space. This one goes straight, or by way of joints at
# which the arm is high above the table.


# %%
def by_way_of_home(query):
    home = np.array([0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.8])
    for via in ([], [home]):
        points = [query.start, *via, query.goal]
        path = np.concatenate([np.linspace(*ends, 40) for ends in itertools.pairwise(points)])
        if all(map(query.is_free, path)):
            return path
    return None


print(
    cg.robot.place(
        "own/planner", bank.path, placer="none", planner=by_way_of_home, num_episodes=num_episodes
    )
)

# %% [markdown]
# **An observer** tells where things are, from what cameras see (`world.picture(camera)`). This one knows the
# truth, but for what is farther than half a metre from the tool: of that it says what was known before.


# %%
class NearSighted:
    name = "near-sighted"
    sees_held = True

    def glance(self, world):
        pass

    def __call__(self, world, names, known):
        true = world.true_poses(names)
        near = np.linalg.norm(true[:, :3] - world.tool[:3, 3], axis=1) < 0.5
        seen = near | np.isnan(known[:, 0])
        return SceneEstimate(
            tuple(names), np.where(seen[:, None], true, known), seen, np.ones(len(names))
        )


print(cg.rearrange("own/observer", observer=NearSighted(), num_episodes=num_episodes))
