# %% [markdown]
# # From a bank to a placed object
# A table with clutter, one noisy depth image of it, and one more object: where would it be stable? A placer
# that comes with the package answers from the image and the object's shape alone; the simulator judges.

# %%
import jax
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes, ProposalJudge
from cluttergen_jax.downstream.placer.proposers import find_placer
from cluttergen_jax.sensing.camera import free
from cluttergen_jax.sensing.rays import RaySensor, sensed_model
from cluttergen_jax.types import Verdict

num_scenes = 16
num_objects = 10

# %% [markdown]
# Successful scenes; of each, all objects but the last are there already.

# %%
bank = cg.generate(
    "cluttered", pool="household", num_scenes=num_scenes, num_objects=num_objects, max_files=0
)
scenes = PartialScenes(bank)
last = np.array([[row, num_objects - 1] for row in range(len(scenes.number))])
episodes = scenes.episodes(last)

# %% [markdown]
# A camera somewhere around each table: a depth image by rays, with the noise of a real sensor. What it shows
# becomes a query: the heights that were seen, what may be hidden behind them, and the object's own shape.

# %%
world = scenes.problem.world
rng = np.random.default_rng(0)
sensor = RaySensor(sensed_model(world.objects, world.support))
maker = QueryMaker(scenes.problem)
data = sensor.make_data()
queries = []
for row, slot in last:
    sensor.pose(data, episodes.poses[row], episodes.is_placed[row])
    camera = free(world.support, rng)
    sight = maker.see(sensor.sense(data, camera).depth, camera, REALSENSE, rng)
    queries.append(maker.query(sight, scenes.object_index[row, slot]))
    print(f"scene {row}: {sight.unseen:.0%} of the region is hidden from the camera")

# %% [markdown]
# Five proposals for each, best first, with the probability that each is stable. `placer` is a JAX function.

# %%
placer = find_placer("scored")
batch = jax.tree.map(lambda *leaves: np.stack(leaves), *queries)
proposals = jax.jit(jax.vmap(placer))(jax.random.split(jax.random.key(0), len(queries)), batch)

# %% [markdown]
# The first proposals are tried: the object is let go there, must come to rest and disturb nothing, and then
# the whole scene must be stable.

# %%
judge = ProposalJudge(scenes.rules)
rows = np.arange(len(queries))
judged = judge.settle(episodes, rows, np.asarray(proposals.pose[:, 0]))
stands = judge.stand(judged)
for row, (x, y, z, yaw) in enumerate(np.asarray(proposals.pose[:, 0])):
    name = world.names[scenes.object_index[row, num_objects - 1]]
    word = "stable" if stands[row] else Verdict(int(judged.verdict[row])).label
    chance = float(proposals.score[row, 0])
    where = f"x {x:+.3f} y {y:+.3f} z {z:.3f} m, turned by {yaw:.2f} rad"
    print(f"scene {row}: {name} at {where} (chance {chance:.2f}): {word}")
print(f"{stands.sum()} of {len(stands)} objects placed from one noisy image each")

# %% [markdown]
# It prints, a line for each scene:
#
#     scene 0: 65% of the region is hidden from the camera
#     ...
#     scene 0: remote_control at x +0.012 y -0.238 z 0.013 m, turned by 2.08 rad (chance 1.00): stable
#     scene 1: remote_control at x -0.221 y +0.164 z 0.013 m, turned by 6.32 rad (chance 1.00): stable
#     ...
#     16 of 16 objects placed from one noisy image each
#
# Proposals of the same placer on four tables, by `python docs/make_proposals.py`; green ones are stable:
#
# ![Five proposals for one object on each of four tables](../docs/images/proposals.png)
