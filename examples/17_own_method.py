# %% [markdown]
# # Your own method in twenty lines
# A method says where the next object is let go; physics says whether it stays. Yours is a function that is
# given like a built-in name: sampled, pickled, generated and compared in the same way.

# %%
import jax
import jax.numpy as jnp

import cluttergen_jax as cg
from cluttergen_jax.placement.region import action_of_pose

num_scenes = 8
num_objects = 10


def ring(rules):
    """Objects in a ring about the middle of the region, 1 mm above their resting height."""

    def propose(key, episode):
        turn, reach = jax.random.uniform(key, (2,))
        angle = 2 * jnp.pi * turn
        radius = 0.7 + 0.15 * reach
        xy = radius * episode.region.half_extents * jnp.array([jnp.cos(angle), jnp.sin(angle)])
        position = jnp.append(xy, rules.body(episode).height + 0.001)
        return action_of_pose(position, angle, episode.region, rules.height_range(episode))

    return propose


bank = cg.generate(
    "ring/bank",
    method=ring,
    num_scenes=num_scenes,
    num_objects=num_objects,
    overwrite=True,
    render=False,
)
print(bank)
cg.render(bank.path, "ring/pictures", scenes="0-5", picture=False, sheet=True, columns=3)

# %% [markdown]
# ![Scenes of the method](../docs/images/tutorials/own_method.png)
#
# `propose` gets a key and the episode so far, and returns an action: f32[4], x, y, z and turn from 0 to 1
# (docs/contract.md, "Region and action"), in operations of JAX. Where it needs nothing of the world's rules
# (objects, heights, geometry), the function of key and episode is itself the method.
#
# The recipe has its name and a digest: of an attribute `digest` if there is one, else of its source. The same
# call resumes the bank; after a change of the code it is refused as another recipe. The bank itself can be
# read, verified, exported and certified where the method is not at hand.

# %%
print(bank.recipe["method"], bank.recipe["method_digest"])
sample = cg.make_sampler(method=ring, num_objects=num_objects)
scenes = jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), num_scenes))
print(f"{float(scenes.is_success.mean()):.0%} of {num_scenes} scenes succeed")

# %% [markdown]
# Beside others, by other limits of "stable" than the paper's: nothing that stands may move by more than
# 1 mm or 1 degree.

# %%
found = cg.evaluate(
    (ring, "random"), num_objects=num_objects, trials=num_scenes, stability="shift=1mm,turn=1deg"
)
print(found.table.markdown())

# %% [markdown]
# From the command line, with the function in a file of yours:
#
#     cluttergen generate --method my_methods.py:ring --out bank
#     cluttergen evaluate --methods my_methods.py:ring random --stability shift=1mm,turn=1deg
