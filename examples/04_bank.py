# %% [markdown]
# # A bank: thousands of scenes on disk, verified
# The same as `cluttergen generate`, `verify` and `stats`, from Python. If it is interrupted, run it again:
# it resumes.

# %%
import numpy as np

import cluttergen_jax as cg

num_scenes = 200
num_objects = 10

# %%
bank = cg.generate(
    "bank", pool="dining", num_scenes=num_scenes, num_objects=num_objects, method="clear",
    max_files=20,
)  # fmt: skip
print(bank)

# %% [markdown]
# Each saved file (at most `max_files`) is reloaded in plain MuJoCo and simulated for ten seconds with
# sleeping disabled.

# %%
report = cg.verify("bank")
print(report)
assert report.is_sound

# %%
print(cg.stats(bank))

# %% [markdown]
# A row per scene, failures included, in Parquet: pandas, Polars, DuckDB read it too. `bank/README.md`
# explains every column.

# %%
table = bank.table.select(["is_success", "num_placed", "simulated_steps"])
print(table.schema)
print(f"median steps simulated for a scene: {np.median(table['simulated_steps']):.0f}")

# %%
scene = next(scene for scene in bank.scenes() if scene.is_success)
for name, pose in zip(scene.objects, scene.poses, strict=True):
    print(f"{name:14} at {np.round(pose[:3], 3)} m, turned {np.round(pose[3:], 3)}")

# %% [markdown]
# It prints, among other lines:
#
#     attempts   2002, 1.00 per placed object
#     rejected   2 unsettled (0.1%): did not come to rest in time
#     movement of 200 objects: median 1.32 um, 99th percentile 5.29 um, most 9.59 um and 0.00 deg
#     missing    nothing of the 200 scenes asked for
#     median steps simulated for a scene: 330
#     bottle         at [ 0.183 -0.     0.847] m, turned [0.114 0.    0.    0.993]
#
# A picture of six scenes, `pictures/bank-sheet.png`:

# %%
cg.render("bank", "pictures", scenes="0-5", picture=False, sheet=True, columns=3)

# %% [markdown]
# ![Six scenes of the bank](../docs/images/tutorials/bank-sheet.png)
