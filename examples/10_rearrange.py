# %% [markdown]
# # Objects into a new layout
# A simulated arm (extra `robot`) rearranges the objects on a table: the generator draws layouts in another
# part of the table, one is chosen, and one object after another is moved, so that none is in the way.

# %%
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.downstream.rearrange.observe import TrueObserver

num_episodes = 5

# %% [markdown]
# Five objects go to the other half of the table. The same call resumes an interrupted one. The first
# one tests grasps of each object, which are kept for later.

# %%
found = cg.rearrange("rearranged", setting="paper", num_episodes=num_episodes)
print(found)

# %% [markdown]
# Every episode is a row: how it ended, which objects are where they should be, and what it took.

# %%
for row in found.rows:
    print(f"{row.outcome}: {', '.join(row.objects)}")
    print(
        f"  {row.picks} picks ({row.fewest} could do), {row.path:.1f} m of the tool in {row.seconds:.0f} s"
    )

# %% [markdown]
# An observer tells the arm where objects are: a perfect one, or one that looks through cameras
# (`observer="perception"`, extra `perception`; for the household pool a segmenter comes with the package).
# Here is one of your own, which errs by some millimetres. It asks the perfect one; yours would look at
# `world.picture(camera)`.


# %%
class Blurred(TrueObserver):
    """The true places, off by a few millimetres in plan."""

    name = "true poses, 3 mm off"

    def __init__(self, sigma):
        self.sigma = sigma
        self.rng = np.random.default_rng(0)

    def __call__(self, world, names, known):
        found = super().__call__(world, names, known)
        found.pose[:, :2] += self.rng.normal(0, self.sigma, (len(names), 2))
        return found


blurred = cg.rearrange(
    "blurred", choose="similar", num_episodes=num_episodes, observer=Blurred(0.003)
)
print(blurred)

# %% [markdown]
# An episode of the first kind, drawn by `python docs/make_robot.py`:
#
# ![Five objects are brought to the other half of the table](../docs/images/rearrange.png)
