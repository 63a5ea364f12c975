# %% [markdown]
# # Cluttered scenes in five lines
# `sample(key)` is a pure JAX function: compile it, map it, scan it, shard it.

# %%
import jax
import numpy as np

import cluttergen_jax as cg

num_scenes = 256
num_objects = 10

# %%
sample = cg.make_sampler(pool="dining", support="table", num_objects=num_objects, max_retries=2)
scenes = jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), num_scenes))

# %%
num_good = int(scenes.is_success.sum())
num_draws = int(scenes.num_draws.sum())
print(f"{num_good} of {num_scenes} scenes succeed, after {num_draws} draws")
print("objects of the first:", [sample.names[index] for index in scenes.object_index[0]])
print(
    "where they are (metres):",
    np.asarray(scenes.T_world_object.translation()[0]).round(3),
    sep="\n",
)

# %% [markdown]
# It prints:
#
#     256 of 256 scenes succeed, after 256 draws
#     objects of the first: ['dinner_plate', 'bowl', 'cereal_box', 'water_glass', 'mug', 'wine_glass', ...]
#     where they are (metres):
#     [[-0.011  0.124  0.711]
#      [-0.054 -0.152  0.732]
#      [ 0.189 -0.136  0.812]
#      ...
#
# One of them on the host, as a MuJoCo specification to build upon. Files for MuJoCo and others: 06.

# %%
scene = sample.scene(scenes, 0)
model = scene.to_mjspec().compile()
scene.picture(size="640x480").save("scene.png")
print(f"as a MuJoCo model: {model.nbody - 2} free objects, {model.ngeom} geoms")

# %% [markdown]
# It draws `scene.png` and prints `as a MuJoCo model: 10 free objects, 112 geoms`:
#
# ![The first scene](../docs/images/tutorials/five_lines.png)
